//! The right arm of the beam lift, written by hand as the compiler would write it:
//!
//! ```text
//! order halt > beat > self;                  // the silence of a port ranks just below the port (D86)
//! on query beat(b)   do response(me); end;
//! on receive halt(s) do run stop_now takes 1..8 msec; me.moving := false; end;
//! on silence beat 10 msec when me.moving do run stop_now takes 1..8 msec; me.moving := false; end;
//! loop
//!   run grip takes 300..500 msec;
//!   waitfor lift() on time_out do run open_grip; abort "partner missing"; end;
//!   run start_lift takes 1..2 msec;  me.moving := true;
//!   while me.moving do run read_height -> me.height; delay 20 msec; end;
//! end;
//! ```

use super::fake::*;
use imrs_protocol::script::*;
use imrs_protocol::*;

/// The ports of the beam lift.
#[derive(Clone, Copy)]
pub struct Ports {
    pub lift: PortId,
    pub heartbeat: PortId,
    pub halt: PortId,
}

/// The fields of the record `Beat`: `height`, `moving`.
pub const HEARTBEAT: [(&str, Type); 2] = [("b.height", Type::Int16), ("b.moving", Type::Bool)];
pub const HEIGHT: u16 = 0;
pub const MOVING: u16 = 1;

pub fn right(ports: Ports) -> Program {
    let Ports { lift, heartbeat, halt } = ports;
    let mut b = ProgramBuilder::new("armR");
    let height = b.variable("me.height", Type::Int16);
    let moving = b.variable("me.moving", Type::Bool);
    let me = [(Type::Int16, height), (Type::Bool, moving)];
    let silence = b.timer("silence of beat");

    b.order(&[Ranked::Port(halt), Ranked::Port(heartbeat), Ranked::Timer(silence), Ranked::Own]);
    b.start(silence, Ticks(10));
    b.forever(|b| {
        b.run("grip", Ticks(300), Ticks(500));
        b.waitfor(lift).when(Outcomes::TIME_OUT, |b| {
            b.run("open_grip", Ticks(0), Ticks(0)).abort("partner missing");
        });
        // Because of `when me.moving`, the silence counts from the instant at which `me.moving` becomes true.
        b.run("start_lift", Ticks(1), Ticks(2)).set(moving, 1).start(silence, Ticks(10));
        b.while_true(moving, |b| {
            b.run("read_height", Ticks(0), Ticks(0)).op(Op::Value).store(height);
            b.delay(Ticks(20));
        });
    });
    b.on_message(heartbeat, &HEARTBEAT, |b, _| {
        b.start(silence, Ticks(10)).reply(&me);
    });
    b.on_message(halt, &[("s.reason", Type::Int8)], |b, _| {
        b.run("stop_now", Ticks(1), Ticks(8)).set(moving, 0);
    });
    b.handler(Trigger::Timer(silence), |b| {
        b.statement().load(moving).then(|b| {
            b.run("stop_now", Ticks(1), Ticks(8)).set(moving, 0);
        });
        b.start(silence, Ticks(10));
    });
    b.finish().expect("a checked program")
}

const PORTS: Ports = Ports { lift: LIFT, heartbeat: ASK, halt: TELL };
const SILENCE: Signal = Signal::Interrupt(Call::Timer(TimeId(0)));

/// A rig of the arm's script in mid lift, while the script waits in its delay of 20 ms.
fn lifting() -> Rig {
    let mut rig = Rig::of(right(PORTS));
    let mut said = rig.begin();
    for expected in [
        vec!["handle P0 true"],
        vec!["handle P1 true"],
        vec!["boundary"],
        vec!["order [Port(PortId(1)), Port(PortId(0)), Timer(TimeId(0)), Own]"],
        vec!["boundary"],
        vec!["start 0 10"],
        vec!["boundary"],
    ] {
        assert_eq!(said, expected);
        said = rig.accept();
    }
    assert_eq!(said, ["work", "run 0 [] at 0 takes 300..500"]);
    assert_eq!(rig.acted(0, true, 0), ["done"]);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["arrive P2 [0, 0, 0, 0, 0, 0, 0, 0]"]);
    let released = Signal::Released { port: LIFT, round: Round(1), by: ReleasedBy::AllArrived };
    assert_eq!(rig.tell(released), ["boundary"]);
    assert_eq!(rig.accept(), ["work", "run 2 [] at 0 takes 1..2"]);
    rig.acted(0, true, 0);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["start 0 10"]);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["work", "run 3 [] at 0 takes 0..0"]);
    rig.acted(0, true, 42);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["delay 1 20"]);
    assert_eq!([rig.script.var(HEIGHT), rig.script.var(MOVING)], [Some(42), Some(1)]);
    rig
}

#[test]
fn a_heartbeat_is_answered_with_the_arms_own_height() {
    let mut rig = lifting();
    assert_eq!(rig.tell(call(ASK, 1, &[7, 0, 1])), ["start 0 10"]);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["reply P0 T7 [42, 0, 1]"]);
    assert_eq!(rig.accept(), ["return"]);
    assert_eq!(rig.tell(Signal::TimeOut(TimeId(1))), ["boundary"]);
}

#[test]
fn a_halt_stops_the_arm_though_a_heartbeat_is_being_answered() {
    let mut rig = lifting();
    rig.tell(call(ASK, 1, &[7, 0, 1]));
    rig.accept();
    assert_eq!(rig.tell(call(TELL, 2, &[1])), ["work", "run 4 [] at 2 takes 1..8"]);
    rig.acted(2, true, 0);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["unanswered T7", "return"], "the beat's boundary goes on");
    assert_eq!(rig.accept(), ["reply P0 T7 [42, 0, 0]"], "and tells that the arm stands");
}

#[test]
fn silence_stops_the_arm_while_it_moves() {
    let mut rig = lifting();
    assert_eq!(rig.tell(SILENCE), ["work", "run 4 [] at 1 takes 1..8"]);
    rig.acted(1, true, 0);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["start 0 10"]);
    assert_eq!(rig.accept(), ["return"], "no boundary: the handler's last statement has been");
    assert_eq!(rig.script.var(MOVING), Some(0));
    assert_eq!(rig.tell(SILENCE), ["start 0 10"], "it stands already");
}

#[test]
fn a_state_in_mid_lift_takes_a_few_bytes() {
    let mut rig = lifting();
    assert_eq!(same_when_packed(&rig.program, &rig.script).len(), 6);
    rig.tell(call(ASK, 1, &[7, 0, 1]));
    // The packed handler added its own number, its position and its wait (3 bytes), the message to answer (4), and its
    // record (3).
    assert_eq!(same_when_packed(&rig.program, &rig.script).len(), 6 + 3 + 4 + 3);
}
