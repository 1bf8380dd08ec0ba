//! Tests how much memory ten minutes of a cell with ten thousand ports take (goal M7). The test runs in a process of its own.

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use imrs_monitor::app::{App, Msg};
use imrs_monitor::clock::Moment;
use imrs_monitor::history::BUDGET;
use imrs_monitor::source::{Arrival, Feed, SourceId};
use imrs_monitor::specimen::Specimen;
use imrs_monitor::theme::Theme;
use imrs_protocol::Incarnation;
use imrs_wire::obs::{Delta, NodeIdentity, ServerFrame};
use std::time::{Duration, Instant};

/// A run of the test: its length in seconds, and the limits for the history and for the process, in bytes.
struct Run {
    seconds: u64,
    history: usize,
    process: usize,
    /// The greatest memory of the process while the user moves back in the history.
    moving_back: usize,
}

/// The memory that may stay after a pause and after moving back, in bytes: that of the copy of the state during a pause.
/// Moving back itself takes more than twice as much.
const STAYS: usize = 12 << 20;

/// The goal is 64 MiB. Of these, 4 MiB are reserved for file pages of the program. The kernel may drop such pages, and
/// their number depends on the build.
const TEN_MINUTES: Run = Run { seconds: 600, history: BUDGET, process: 60 << 20, moving_back: 60 << 20 };
/// The default run: a tenth of the history with a tenth of its budget, and the memory that the process takes without
/// the history.
const ONE_MINUTE: Run = Run { seconds: 60, history: BUDGET / 10, process: 20 << 20, moving_back: 50 << 20 };

/// Moving back to a state replays the states before it. Each of them may take this share of the time that it took when it
/// arrived, when it was also made and encoded: six tenths.
const REPLAYED: (u32, u32) = (6, 10);

/// One of this many ports changes in each period: 5 %.
const APART: usize = 20;

/// The resident anonymous memory of this process, in bytes.
fn resident() -> usize {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
    line.split_whitespace().next().unwrap().parse::<usize>().unwrap() * 1024
}

/// The processor time that this process has used.
fn worked() -> Duration {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<_> = text.rsplit_once(')').unwrap().1.split_whitespace().collect();
    // User and system time, in hundredths of a second.
    let ticks = fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap();
    Duration::from_millis(10 * ticks)
}

fn press(app: &mut App, key: KeyCode, now: Moment) {
    app.update(Msg::Key(KeyEvent::new(key, KeyModifiers::NONE)), now);
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
    let say = |app: &mut App, at: Moment, delta: Delta| {
        app.update(Msg::Feed(Specimen::said(0, at, ServerFrame::Delta(delta))), at);
    };
    let mut state = Specimen::NODE.snapshot(0);
    // Every port has a queued message, so that the deltas are as large as possible.
    for port in state.tasks.iter_mut().flat_map(|task| &mut task.view.ports) {
        (port.len, port.min_slack) = (1, Some(imrs_protocol::Ticks(100_000 + u64::from(port.port.0))));
    }
    say(&mut app, Duration::from_millis(1), Delta::whole(&state));
    let periods = 10 * run.seconds;
    let mut go_on = |app: &mut App, period: u64| {
        let before = state.clone();
        Specimen::go_on(&mut state, period, APART);
        say(app, Duration::from_millis(100 * period), Delta::between(&before, &state));
    };
    (1..=periods).for_each(|period| go_on(&mut app, period));
    let arriving = worked();
    let memory = resident();
    let kept = Duration::from_millis(100 * periods) - app.history().film().unwrap().stops()[0].at;
    let weight = app.history().weight();
    println!(
        "10,000 ports, 5 % dirty at 10 Hz: {kept:?} kept in {weight} bytes; the process has {memory} bytes"
    );
    assert!(weight <= run.history, "{weight} of {} bytes", run.history);
    assert!(memory <= run.process, "{memory} of {} bytes", run.process);
    let now = Duration::from_millis(100 * periods);
    press(&mut app, KeyCode::Char(' '), now);
    let mut most = resident();
    // The nodes go on during the pause.
    (1..=10).for_each(|period| go_on(&mut app, periods + period));
    for key in [KeyCode::Char('['), KeyCode::Char('['), KeyCode::Home, KeyCode::Char(']'), KeyCode::Char('[')]
    {
        let (began, before) = (Instant::now(), worked());
        press(&mut app, key, now);
        most = most.max(resident());
        let took = worked().saturating_sub(before);
        println!("{key:?}: {:?}, of it {took:?} of a processor, {} bytes", began.elapsed(), resident());
        let replayed = u32::try_from(app.history().film().unwrap().stops().len()).unwrap();
        let most = arriving * REPLAYED.0 / REPLAYED.1 * replayed / u32::try_from(periods).unwrap();
        assert!(took <= most, "{key:?} took {took:?} of {most:?}");
    }
    press(&mut app, KeyCode::Char(' '), now);
    let after = resident();
    println!("at most {most} bytes while moving back, {after} after it");
    assert!(most <= run.moving_back, "{most} of {} bytes", run.moving_back);
    assert!(after.saturating_sub(memory) <= STAYS, "{memory} bytes before, {after} after moving back");
}
