//! Tests how much memory ten minutes of a cell with ten thousand ports take (goal M7). The test runs in a process of its own.

use imrs_monitor::app::{App, Msg};
use imrs_monitor::clock::Moment;
use imrs_monitor::history::BUDGET;
use imrs_monitor::source::{Arrival, Feed, SourceId};
use imrs_monitor::specimen::Specimen;
use imrs_monitor::theme::Theme;
use imrs_protocol::Incarnation;
use imrs_wire::obs::{Delta, NodeIdentity, ServerFrame};
use std::time::Duration;

/// A run of the test: its length in seconds, and the limits for the history and for the process, in bytes.
struct Run {
    seconds: u64,
    history: usize,
    process: usize,
}

/// The goal is 64 MiB. Of these, 4 MiB are reserved for file pages of the program. The kernel may drop such pages, and
/// their number depends on the build.
const TEN_MINUTES: Run = Run { seconds: 600, history: BUDGET, process: 60 << 20 };
/// The default run: a tenth of the history with a tenth of its budget, and the memory that the process takes without
/// the history.
const ONE_MINUTE: Run = Run { seconds: 60, history: BUDGET / 10, process: 20 << 20 };

/// One of this many ports changes in each period: 5 %.
const APART: usize = 20;

/// The resident anonymous memory of this process, in bytes.
fn resident() -> usize {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
    line.split_whitespace().next().unwrap().parse::<usize>().unwrap() * 1024
}

/// Runs one minute or, if `IMRS_HISTORY` is set, the ten minutes of the goal.
#[test]
fn ten_minutes_of_ten_thousand_ports_fit_the_budget() {
    let run = if std::env::var_os("IMRS_HISTORY").is_some() { TEN_MINUTES } else { ONE_MINUTE };
    let mut app = App::new(Theme::MONO, None);
    let identity = NodeIdentity {
        cell: "specimen".into(),
        digest: 1,
        node: "node0".into(),
        id: 0,
        incarnation: Incarnation(1),
        tick_us: 1,
    };
    let feed = Feed::Attached { identity, pid: 1, build: "imrs".into() };
    app.update(Msg::Feed(Arrival { at: Moment::ZERO, source: SourceId(0), feed }), Moment::ZERO);
    let mut say = |at: Moment, delta: Delta| {
        app.update(Msg::Feed(Specimen::said(0, at, ServerFrame::Delta(delta))), at);
    };
    let mut state = Specimen::NODE.snapshot(0);
    // Every port has a queued message, so that the deltas are as large as possible.
    for port in state.tasks.iter_mut().flat_map(|task| &mut task.view.ports) {
        (port.len, port.min_slack) = (1, Some(imrs_protocol::Ticks(100_000 + u64::from(port.port.0))));
    }
    say(Duration::from_millis(1), Delta::whole(&state));
    let periods = 10 * run.seconds;
    for period in 1..=periods {
        let before = state.clone();
        Specimen::go_on(&mut state, period, APART);
        say(Duration::from_millis(100 * period), Delta::between(&before, &state));
    }
    let memory = resident();
    let film = app.history().film().unwrap();
    let kept = Duration::from_millis(100 * periods) - film.stops()[0].at;
    let weight = app.history().weight();
    println!(
        "10,000 ports, 5 % dirty at 10 Hz: {kept:?} kept in {weight} bytes; the process has {memory} bytes"
    );
    assert!(weight <= run.history, "{weight} of {} bytes", run.history);
    assert!(memory <= run.process, "{memory} of {} bytes", run.process);
}
