//! Tests that the Rust programs of the process classes (D24), and the program with tasks as futures (D113), run and end as
//! they should.

#[path = "../examples/futures.rs"]
mod futures;
#[path = "../examples/independent.rs"]
mod independent;
#[path = "../examples/loose.rs"]
mod loose;
#[path = "../examples/serial.rs"]
mod serial;
#[path = "../examples/tight.rs"]
mod tight;
#[path = "../examples/work.rs"]
mod work;

#[test]
fn independent_robots_share_the_speed_of_a_belt() {
    independent::main();
}

#[test]
fn loosely_coupled_welders_share_a_tool() {
    loose::main();
}

#[test]
fn tightly_coupled_arms_lift_a_beam() {
    tight::main();
}

#[test]
fn serialized_robots_hand_over_parts() {
    serial::main();
}

#[test]
fn a_work_coupled_robot_goes_on_where_the_other_crashed() {
    work::main();
}

#[test]
fn a_gripper_waits_for_its_sensor_or_a_message() {
    futures::main();
}
