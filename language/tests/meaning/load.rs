//! The estimated traffic on links.

use super::whole;
use crate::support::source;
use imrs_language::{format, load};

/// Three nodes in a row. `{camera}` is an option of the camera's port, `{link}` one of the first link.
fn row(camera: &str, link: &str) -> String {
    format!(
        "cell row;\ntick 1 msec;\nnode n1; node n2; node n3;\nlink n1 -- n2 delay 1 msec{link};\nlink n2 -- n3 delay 1 msec;\n\
         type Pose is record a: int32; b: int32; c: int32; d: int32; end;\n\
         task camera on n1\n  port pose(p: Pose) usage = send message_format = Pose user_list = {{planner}} time_out = 100 msec class = 1{camera};\n\
         var p: Pose;\nbegin\n  loop run see -> p.a; send pose(p); delay 20 msec; end;\nend camera;\n\
         task planner on n3\n  use_port pose(p: Pose) usage = receive;\n  port plan(n: int16) usage = send user_list = {{arm}} time_out = 200 msec class = 2;\n  var p: Pose;\n\
         begin\n  loop receive pose(p); send plan(1) on time_out do skip; end on refused do skip; end; end;\nend planner;\n\
         task arm on n3\n  use_port plan(n: int16) usage = receive;\n  var n: int16;\nbegin\n  loop receive plan(n); run go takes 1..2 msec; reply(); end;\nend arm;\n"
    )
}

#[test]
fn rates_and_time_outs_add_up_on_the_links_of_the_route() {
    // A message of 16 bytes takes two packets.
    let links = load::of_links(&whole(&row(" rate = 50/1 sec", "")).hir.expect("a cell"));
    let sums: Vec<_> = links.iter().map(|link| (link.declared, link.estimated)).collect();
    assert_eq!(sums, [(100.0, 0.0); 2], "on both links of the route, and nothing within a node");
    assert!(links.iter().all(|link| !link.is_congested() && link.capacity > 90_000.0));
    // Without a rate, the estimate is one message in each time_out of 100 ms.
    let links = load::of_links(&whole(&row("", "")).hir.expect("a cell"));
    assert_eq!((links[1].declared, links[1].estimated), (0.0, 20.0));
}

#[test]
fn a_task_without_actions_is_advised_to_run_where_the_links_carry_less() {
    let hir = whole(&row(" rate = 50/1 sec", "")).hir.expect("a cell");
    let moves = load::moves(&hir);
    // If the planner moves, its 5 commands per second and their answers take 10 packets per second over two links. The
    // poses, which took 100 there, stay within a node.
    let [only] = moves[..] else { panic!("{moves:?}") };
    assert_eq!(
        (hir.tasks[only.task.index()].name.as_str(), hir.nodes[only.to.index()].name.as_str()),
        ("planner", "n1")
    );
    assert!((only.saves - 180.0).abs() < 1e-6, "{only:?}");
    // If most of the traffic is between planner and arm, the planner stays on its node.
    let stays =
        row("", "").replace("time_out = 200 msec class = 2", "rate = 40/1 sec time_out = 200 msec class = 2");
    assert!(load::moves(&whole(&stays).hir.expect("a cell")).is_empty());
}

#[test]
fn a_link_that_gets_more_than_its_capacity_is_warned_of() {
    let codes = |text: &str| -> Vec<_> { whole(text).diagnostics.iter().map(|found| found.code).collect() };
    let w315 = "W315";
    assert!(codes(&row(" rate = 50/1 sec", " capacity = 99/1 sec")).contains(&w315));
    assert!(!codes(&row(" rate = 50/1 sec", " capacity = 100/1 sec")).contains(&w315));
    assert!(
        codes(&row("", " capacity = 19/1 sec")).contains(&w315),
        "an estimate counts against a declared capacity"
    );
    assert!(!codes(&row("", "")).contains(&w315));
}

#[test]
fn a_capacity_is_formatted_as_a_rate() {
    let text = "cell c;\ntick 1 msec;\nnode a;\nnode b;\nlink a -- b delay 1 msec CAPACITY=500 / 1 sec;\n";
    let formatted = format(&source(text)).expect("a cell");
    assert!(formatted.contains("link a -- b delay 1 msec capacity = 500/1 sec;"), "{formatted}");
}
