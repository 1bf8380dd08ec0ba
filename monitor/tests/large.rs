//! Tests of the cost of large cells: a frame costs only what is visible.

use crate::allocations;
use crate::common::{Stage, ms};
use imrs_monitor::app::Msg;
use imrs_monitor::specimen::Specimen;
use imrs_monitor::theme::Theme;
use imrs_wire::obs::ServerFrame;
use rustix::time::{ClockId, clock_gettime};
use std::time::Duration;

/// The processor time of this thread, which other threads do not affect.
fn own_time() -> Duration {
    Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).expect("it counts from the thread's begin")
}

/// Whether the user declares that the machine is quiet. Only then the tests assert times, too.
fn is_quiet() -> bool {
    std::env::var_os("IMRS_QUIET").is_some_and(|value| value == "1")
}

/// The greatest number of allocations for a frame: twice the measured number. Making ten thousand rows allocates far
/// more often.
const MOST: u64 = 5_000;
/// The greatest number of allocations for a frame of the screen that lists the kinds of transitions.
const MOST_OF_MODEL: u64 = 20_000;

fn stage(cell: Specimen) -> Stage {
    let mut stage = Stage::new(Theme::COLOUR);
    for arrival in cell.arrivals(ms(1_000)) {
        stage.app.update(Msg::Feed(arrival), ms(1_000));
    }
    stage.draw(ms(1_000), 200, 60);
    stage
}

#[test]
fn a_keyframe_of_ten_thousand_ports_fits_a_frame() {
    let bytes = postcard::to_allocvec(&ServerFrame::Snapshot(Specimen::NODE.snapshot(0))).unwrap();
    println!("a keyframe of 10,000 ports has {} bytes", bytes.len());
    assert!(bytes.len() < imrs_wire::obs::MAX_FRAME / 2);
}

/// The number of allocations does not depend on the machine. The time is asserted only with `IMRS_QUIET=1`, with some
/// fifty times the usual value as the limit.
#[test]
fn only_rows_in_sight_are_made() {
    let mut stage = stage(Specimen::NODE);
    stage.keys(ms(1_000), "G");
    let text = stage.text(ms(1_050), 200, 60);
    assert!(text.contains("port9999") && !text.contains("port9900 "), "the end is in sight");
    let took = |i: u64| {
        let start = own_time();
        let _ = stage.buffer(ms(1_050 + i), 200, 60);
        own_time() - start
    };
    let fastest = (0..20).map(took).min().unwrap();
    let before = allocations();
    let _ = stage.buffer(ms(1_100), 200, 60);
    let allocated = allocations() - before;
    println!("a frame of 10,000 ports at 200x60 takes {fastest:?} and {allocated} allocations");
    assert!(allocated < MOST, "{allocated} allocations");
    assert!(!is_quiet() || fastest < ms(50), "{fastest:?}");
}

/// Goal M1: 100 nodes with 100 ports each, at 200x60. `imrs bench screen` measures it. This test only detects a screen
/// that makes every row, and works on a busy machine, too.
#[test]
fn every_screen_of_a_hundred_nodes_is_built_from_what_is_in_sight() {
    let attached = stage(Specimen::CELL);
    for keys in ["1", "1G", "2", "3", "4", "5", "6", "7", "8"] {
        let mut stage = Stage { app: attached.app.clone() };
        stage.keys(ms(1_000), keys);
        let mut before = stage.buffer(ms(1_050), 200, 60);
        let allocated = allocations();
        let mut taken: Vec<Duration> = (0..30)
            .map(|i| {
                let start = own_time();
                let after = stage.buffer(ms(1_051 + i), 200, 60);
                let changed = before.diff(&after).len();
                before = after;
                assert!(changed < 200 * 60);
                own_time() - start
            })
            .collect();
        let allocated = (allocations() - allocated) / 30;
        taken.sort();
        println!("{keys}: median {:?}, worst {:?}, {allocated} allocations", taken[15], taken[29]);
        let most = if keys == "7" { MOST_OF_MODEL } else { MOST };
        assert!(allocated < most, "{keys}: {allocated} allocations");
        assert!(!is_quiet() || taken[0] < ms(100), "{keys}: {taken:?}");
    }
}
