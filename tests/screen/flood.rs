//! Goal M2: keys must take effect at once, and events must appear soon after they happen, however many events a node reports.

use super::terminal::{Terminal, tmux_is_here};
use crate::support::stub::{Stub, Tells};
use crate::support::{PATIENCE, is_quiet, runtime_dir, wait_until};
use imrs_protocol::{
    Cell, CellTable, Event, Incarnation, Observation, PortDecl, PortId, TaskId, TaskState, TaskView, Ticks,
    Usage,
};
use imrs_wire::obs::{Liveness, NodeIdentity, Snapshot, Table, TaskSnapshot, TimedEvent};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// How many events the node reports in each interval `EVERY`. This makes 50,000 events a second.
const EACH: u32 = 500;
const EVERY: Duration = Duration::from_millis(10);
/// The promised delay on a quiet machine; asserted if `IMRS_QUIET=1` says that this machine is quiet.
const GOAL: Duration = Duration::from_millis(50);
/// The greatest number of events that wait for a monitor that reads too slowly.
const MOST_WAITING: usize = 20_000;
/// How many events are reported before the first key and after the last.
const FLOOD: u32 = 10_000;

fn node() -> (NodeIdentity, Table, Tells) {
    let mut cell = Cell::new("flood", Ticks(1_000));
    let node = cell.node("na");
    let (left, right) = (cell.task("armL", node), cell.task("armR", node));
    cell.port(PortDecl::new("news", left, Usage::Send, &[right], Ticks(2_000_000)).bounded_buffer(8));
    let identity = NodeIdentity {
        cell: "flood".into(),
        digest: 1,
        node: "na".into(),
        id: 0,
        incarnation: Incarnation(1),
        tick_us: 1,
    };
    let task = |task| {
        let view = TaskView { task, state: TaskState::Running, ports: Vec::new(), meetings: Vec::new() };
        TaskSnapshot { liveness: Liveness::Alive, age_us: 0, view }
    };
    let snapshot = Snapshot { tasks: [left, right].map(task).into(), ..Snapshot::default() };
    let table = Table::of(&CellTable::new(cell).expect("a cell"));
    (identity, table, Tells { snapshot, ..Tells::default() })
}

fn sent(mono_us: u64, number: u32) -> TimedEvent {
    let what =
        Observation { event: Event::Sent, port: PortId(0), peer: TaskId(1), number, remaining: Ticks(1_000) };
    TimedEvent { mono_us, task: Some(TaskId(0)), what }
}

#[test]
fn keys_are_seen_at_once_while_a_node_tells_fifty_thousand_events_a_second() {
    if !tmux_is_here() {
        return;
    }
    let dir = runtime_dir();
    let (identity, table, tells) = node();
    let stub = Arc::new(Stub::start(dir.path(), identity, table, tells));
    let terminal = Terminal::open(dir.path());
    terminal.type_monitor("", "");
    terminal.wait_for("the overview", |screen| screen.contains("armL"));
    let alone = pressed(&terminal);

    let (ends, number) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU32::new(0)));
    let flood = {
        let (stub, ends, number) = (Arc::clone(&stub), Arc::clone(&ends), Arc::clone(&number));
        thread::spawn(move || {
            let begins = Instant::now();
            for round in 1_u32.. {
                if ends.load(Ordering::Relaxed) {
                    return begins.elapsed();
                }
                let now = stub.mono_us();
                stub.change(|tells| {
                    // A real node keeps no more events either while no monitor reads them: as many as fit into one
                    // frame.
                    if tells.events.len() < MOST_WAITING {
                        let first = number.fetch_add(EACH, Ordering::Relaxed);
                        tells.events.extend((first..first + EACH).map(|n| sent(now, n)));
                    }
                });
                thread::sleep((begins + EVERY * round).saturating_duration_since(Instant::now()));
            }
            Duration::ZERO
        })
    };
    let more = |events: u32| {
        let least = number.load(Ordering::Relaxed) + events;
        wait_until("more events are told", || number.load(Ordering::Relaxed) >= least);
    };
    // Each key must take effect during the flood of events, so the flood goes on until the key has taken effect.
    more(FLOOD);
    let flooded = pressed(&terminal);
    terminal.press(&["4"], "[4 Time]");
    more(FLOOD);
    ends.store(true, Ordering::Relaxed);
    let lasted = flood.join().expect("the flood");
    // The next screen must show the very last event.
    let told = Instant::now();
    let last = 9_000_000;
    let now = stub.mono_us();
    stub.change(|tells| tells.events.push(sent(now, last)));
    terminal.wait_for("the last event", |screen| screen.contains(&format!("news#{last}")));
    let behind = told.elapsed();
    let rate = f64::from(number.load(Ordering::Relaxed)) / lasted.as_secs_f64();
    let line = |name: &str, times: &[Duration]| {
        let (half, most) = (times[times.len() / 2], times[times.len() * 99 / 100]);
        println!("{name}: p50 {half:?}, p99 {most:?} from key to screen, tmux included; goal {GOAL:?}");
    };
    line("alone", &alone);
    line(&format!("with {rate:.0} events a second"), &flooded);
    println!(
        "the last event was on the screen {behind:?} after it, of which up to 50 ms are the node's period"
    );
    assert!(!is_quiet() || flooded[flooded.len() * 99 / 100] <= GOAL, "{flooded:?}");
    terminal.leave();
}

/// The promised load of an idle screen on a quiet machine, in percent of a core; asserted if `IMRS_QUIET=1` says that
/// this machine is quiet.
const IDLE_GOAL: f64 = 3.0;
/// The limit of the load of an idle screen on any machine, in percent of a core. It is higher, because the cost of a
/// frame depends on the machine. A loop without sleep takes several times as much.
const IDLE_MOST: f64 = 25.0;
/// The least time between two frames.
const FRAME: Duration = Duration::from_millis(33);

/// Goal M7: an idle screen takes next to no processor time. On any machine it draws at most thirty frames a second: one
/// for each state that a node reports.
#[test]
fn an_idle_screen_costs_next_to_nothing() {
    if !tmux_is_here() {
        return;
    }
    let dir = runtime_dir();
    let (identity, table, tells) = node();
    let _stub = Stub::start(dir.path(), identity, table, tells);
    let terminal = Terminal::open(dir.path());
    terminal.type_monitor("", "");
    terminal.wait_for("the overview", |screen| screen.contains("armL"));
    let pid = terminal.monitor_pid();
    // The clock is read before the first and after the last of these values, so that the measured time covers all frames.
    let (begins, before, drawn) = (Instant::now(), worked(pid), writes(pid));
    thread::sleep(Duration::from_secs(3));
    let (worked, drawn) = (worked(pid) - before, writes(pid) - drawn);
    let took = begins.elapsed();
    let part = worked.as_secs_f64() / took.as_secs_f64() * 100.0;
    println!(
        "an idle screen takes {part:.1} % of a core and writes {drawn} times in {took:?}; goal {IDLE_GOAL} %"
    );
    let goal = if is_quiet() { IDLE_GOAL } else { IDLE_MOST };
    assert!(part <= goal, "{part} % of a core");
    // Each frame is one write. Credit for the node, clock requests and wake-ups of threads take at most the same number
    // of writes.
    let most = 2 * (1 + took.as_millis() / FRAME.as_millis());
    assert!(u128::from(drawn) <= most, "{drawn} writes in {took:?}");
    terminal.leave();
}

/// The number of write syscalls of a process so far.
fn writes(pid: u32) -> u64 {
    let counts = std::fs::read_to_string(format!("/proc/{pid}/io")).expect("the process");
    let count = counts.lines().find_map(|line| line.strip_prefix("syscw: ")).expect("counted");
    count.parse().expect("a number")
}

/// The processor time of a process; the kernel counts it in hundredths of a second.
fn worked(pid: u32) -> Duration {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).expect("the process");
    let (_, fields) = stat.rsplit_once(')').expect("its name");
    let times = fields.split_whitespace().skip(11).take(2).map(|n| n.parse::<u64>().expect("a number"));
    Duration::from_millis(10 * times.sum::<u64>())
}

/// The delays from a key to its effect on the screen, sorted.
fn pressed(terminal: &Terminal) -> Vec<Duration> {
    // If times are asserted, the test takes enough samples for a 99th percentile.
    let mut times: Vec<Duration> = (0..if is_quiet() { 100 } else { 30 })
        .map(|turn| {
            let (key, title) = if turn % 2 == 0 { ("5", "[5 Timers]") } else { ("6", "[6 Events]") };
            let begins = Instant::now();
            terminal.keys(&[key]);
            while !terminal.screen().contains(title) {
                assert!(begins.elapsed() < PATIENCE, "{title} never came");
            }
            begins.elapsed()
        })
        .collect();
    times.sort();
    times
}
