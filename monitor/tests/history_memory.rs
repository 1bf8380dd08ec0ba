//! M7: ten minutes of ten thousand ports in the memory of one process of its own.

mod common;

use common::{Stage, identity, ms};
use imrs_monitor::history::BUDGET;
use imrs_monitor::source::Feed;
use imrs_monitor::specimen::Specimen;
use imrs_monitor::theme::Theme;
use imrs_wire::obs::{Delta, ServerFrame};

/// Ten minutes of ten periods a second.
const PERIODS: u64 = 6_000;
/// One port in so many did something in each of them: 5 %.
const APART: usize = 20;

/// The resident memory of this process, in bytes.
fn resident() -> usize {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.split_whitespace().next().unwrap().parse::<usize>().unwrap() * 1024
}

#[test]
fn ten_minutes_of_ten_thousand_ports_fit_the_budget() {
    let mut stage = Stage::new(Theme::MONO);
    let build = "imrs".to_owned();
    stage.feed(ms(0), 0, Feed::Attached { identity: identity(0, 1), pid: 1, build });
    let mut state = Specimen::NODE.snapshot(0);
    // Something waits at every port: the most that there is to tell.
    for port in state.tasks.iter_mut().flat_map(|task| &mut task.view.ports) {
        (port.len, port.min_slack) = (1, Some(imrs_protocol::Ticks(100_000 + u64::from(port.port.0))));
    }
    stage.frame(ms(1), 0, ServerFrame::Delta(Delta::whole(&state)));
    for period in 1..=PERIODS {
        let before = state.clone();
        Specimen::go_on(&mut state, period, APART);
        let frame = ServerFrame::Delta(Delta::between(&before, &state));
        stage.frame(ms(100 * period), 0, frame);
    }
    let memory = resident();
    let film = stage.app.history().film().unwrap();
    let kept = ms(100 * PERIODS) - film.stops()[0].at;
    let weight = stage.app.history().weight();
    println!(
        "10,000 ports, 5 % dirty at 10 Hz: {kept:?} kept in {weight} bytes; the process has {memory} bytes"
    );
    assert!(weight <= BUDGET, "{weight} bytes");
    assert!(memory <= 64 << 20, "{memory} bytes");
}
