//! Runs the example cells in virtual time.

use super::{BEAM_LIFT, WELD, virtual_cell};

/// The entries of a log that contain one of these words, without their times.
fn only(log: &[String], words: &[&str]) -> Vec<String> {
    let named = log.iter().filter(|line| words.iter().any(|word| line.contains(word)));
    named.map(|line| line.split_once(' ').expect("a time").1.to_owned()).collect()
}

#[test]
fn the_beam_is_lifted_and_both_arms_stop_at_the_top() {
    let mut virtual_cell = virtual_cell(BEAM_LIFT);
    virtual_cell.results = |name, now| match name {
        "read_height" if now > 400 => 901,
        "read_height" => 100,
        _ => 0,
    };
    virtual_cell.run(390);
    let log = virtual_cell.log();
    let mut released = only(&log, &["start_lift", "wind"]);
    released.sort();
    assert_eq!(released, ["armL: start_lift", "armR: start_lift", "hoist: wind"]);
    assert_eq!((virtual_cell.var("armL", "me.moving"), virtual_cell.var("armR", "me.moving")), (1, 1));
    virtual_cell.run(60);
    let log = virtual_cell.log();
    let stops = only(&log, &["stop"]);
    assert!(
        stops.contains(&"armL: stop_now".into()) && stops.contains(&"armR: stop_now at 1".into()),
        "{log:?}"
    );
    assert_eq!((virtual_cell.var("armL", "me.moving"), virtual_cell.var("armR", "me.moving")), (0, 0));
}

#[test]
fn both_arms_stop_when_the_link_between_them_is_cut() {
    let mut virtual_cell = virtual_cell(BEAM_LIFT);
    virtual_cell.run(400);
    virtual_cell.log();
    virtual_cell.cut(virtual_cell.node("nl"), virtual_cell.node("nr"));
    let cut = virtual_cell.now();
    virtual_cell.run(25);
    let log = virtual_cell.log();
    let stops = only(&log, &["stop_now"]);
    assert!(stops.len() == 2 && stops.contains(&"armR: stop_now at 1".into()), "{log:?}");
    let time = |line: &String| line.split_once(' ').expect("a time").0.parse::<u64>().expect("a number");
    let last = log.iter().filter(|line| line.contains("stop_now")).map(time).max().expect("two stops");
    assert!(last <= cut + 12, "stopped by the silence of 10 ticks: {log:?}");
}

#[test]
fn a_crashed_hoist_leaves_both_arms_on_the_ground() {
    let mut virtual_cell = virtual_cell(&BEAM_LIFT.replace("ready takes 0", "ready takes 500"));
    virtual_cell.crash(virtual_cell.node("nh"));
    virtual_cell.run(2_310);
    let log = virtual_cell.log();
    assert_eq!(only(&log, &["start_lift", "open_grip"]), ["armL: open_grip", "armR: open_grip"]);
    assert_eq!(only(&log, &["ended"]).len(), 2, "{log:?}");
}

#[test]
fn the_tool_is_granted_and_freed_and_the_work_is_done() {
    let mut virtual_cell = virtual_cell(WELD);
    virtual_cell.run(12 * 4_000);
    let log = virtual_cell.log();
    let welds = only(&log, &["r1: weld"]);
    let expected: Vec<String> = (0..12).map(|spot| format!("r1: weld {spot}")).collect();
    assert_eq!(welds, expected, "{log:?}");
    assert_eq!(only(&log, &["dress"]).len(), 12, "the tool was free each time: {log:?}");
    assert_eq!(virtual_cell.var("dresser", "busy"), 0);
}

#[test]
fn the_standby_goes_on_where_a_crashed_primary_stopped() {
    let mut virtual_cell = virtual_cell(WELD);
    virtual_cell.run(5_000);
    virtual_cell.crash(virtual_cell.node("n1"));
    let crashed = virtual_cell.now();
    virtual_cell.run(40_000);
    let log = virtual_cell.log();
    let recheck =
        log.iter().find(|line| line.contains("recheck")).expect("the spot in progress is looked at");
    let at: u64 = recheck.split_once(' ').expect("a time").0.parse().expect("a number");
    assert!((crashed + 300..=crashed + 450).contains(&at), "{recheck}, crashed at {crashed}");
    let welds = only(&log, &["weld"]);
    assert_eq!(welds.last().map(String::as_str), Some("r2: weld 11"), "{welds:?}");
}

#[test]
fn a_standby_can_read_what_its_partner_published() {
    let text = WELD.replace("takeover  ", "takeover p.spot := 0; p := alive; ");
    let mut virtual_cell = virtual_cell(&text);
    virtual_cell.run(5_000);
    virtual_cell.crash(virtual_cell.node("n1"));
    virtual_cell.run(1_000);
    let log = virtual_cell.log();
    let last = only(&log, &["r1: weld"]).pop().expect("a weld");
    let recheck = only(&log, &["recheck"]).pop().expect("the spot in progress is looked at");
    assert_eq!(recheck.rsplit(' ').next(), last.rsplit(' ').next());
}
