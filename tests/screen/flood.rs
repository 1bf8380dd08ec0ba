//! M2: what is pressed is seen at once, and what happened soon after, however much a node tells.

use super::terminal::{Terminal, tmux_is_here};
use crate::support::stub::{Stub, Tells};
use crate::support::{is_quiet, runtime_dir};
use imrs_protocol::{
    Cell, CellTable, Event, Incarnation, Observation, PortDecl, PortId, TaskId, TaskState, TaskView, Ticks,
    Usage,
};
use imrs_wire::obs::{Liveness, NodeIdentity, Snapshot, Table, TaskSnapshot, TimedEvent};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// So many every so often: 50,000 a second.
const EACH: u32 = 500;
const EVERY: Duration = Duration::from_millis(10);
/// What is promised of a machine that is quiet; asserted where `IMRS_QUIET=1` says that this one is.
const GOAL: Duration = Duration::from_millis(50);
/// However busy the machine is.
const LONG: Duration = Duration::from_secs(5);

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
                let first = number.fetch_add(EACH, Ordering::Relaxed);
                stub.change(|tells| tells.events.extend((first..first + EACH).map(|n| sent(now, n))));
                thread::sleep((begins + EVERY * round).saturating_duration_since(Instant::now()));
            }
            Duration::ZERO
        })
    };
    let flooded = pressed(&terminal);
    terminal.press(&["4"], "[4 Time]");
    ends.store(true, Ordering::Relaxed);
    let lasted = flood.join().expect("the flood");
    // The last one of them is on the screen that follows.
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
    assert!(flooded[flooded.len() / 2] < LONG && behind < LONG, "{flooded:?}, {behind:?}");
    terminal.leave();
}

/// M7: a screen that nothing happens on takes next to nothing of the processor.
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
    let (before, begins) = (worked(pid), Instant::now());
    thread::sleep(Duration::from_secs(3));
    let part = (worked(pid) - before).as_secs_f64() / begins.elapsed().as_secs_f64() * 100.0;
    println!("an idle screen takes {part:.1} % of a core; goal 3 %");
    assert!(part <= 3.0, "{part} %");
    terminal.leave();
}

/// The processor time that a process has had: a hundredth of a second is the least that the kernel tells.
fn worked(pid: u32) -> Duration {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).expect("the process");
    let (_, fields) = stat.rsplit_once(')').expect("its name");
    let times = fields.split_whitespace().skip(11).take(2).map(|n| n.parse::<u64>().expect("a number"));
    Duration::from_millis(10 * times.sum::<u64>())
}

/// How long it takes until a key is seen, sorted.
fn pressed(terminal: &Terminal) -> Vec<Duration> {
    // Where times are asserted, as many as a hundredth can be told from.
    let mut times: Vec<Duration> = (0..if is_quiet() { 100 } else { 30 })
        .map(|turn| {
            let (key, title) = if turn % 2 == 0 { ("5", "[5 Timers]") } else { ("6", "[6 Events]") };
            let begins = Instant::now();
            terminal.keys(&[key]);
            while !terminal.screen().contains(title) {
                assert!(begins.elapsed() < LONG, "{title} never came");
            }
            begins.elapsed()
        })
        .collect();
    times.sort();
    times
}
