//! Tests of the monitor in a real terminal, which tmux provides: its screen is what a person sees.

mod flood;
mod keys;
mod servers;
mod terminal;

use crate::support::live::Live;
use crate::support::program::Program;
use crate::support::tape::frames;
use crate::support::{imrs, is_well, look_until, run, signal, wait_until};
use rustix::process::Signal;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use terminal::{Terminal, tmux_is_here, watched};

#[test]
fn the_screen_shows_who_waits_for_whom_and_a_death_and_gives_the_terminal_back() {
    let Some((demo, terminal)) = watched("") else { return };
    let names = ["nl", "nr", "nh", "armR", "beat", "halt", "lift"];
    terminal.wait_for("all names", |screen| names.iter().all(|name| screen.contains(name)));
    terminal.keys(&["3"]);
    terminal.wait_for("the rendezvous", |s| s.contains("lift") && s.contains("armL") && s.contains("hoist"));
    terminal.keys(&["2"]);
    terminal.wait_for("a port", |screen| screen.contains("lift") || screen.contains("beat"));
    terminal.keys(&["?"]);
    terminal.wait_for("the help", |screen| screen.contains("quit"));

    terminal.keys(&["Escape"]);
    terminal.keys(&["1"]);
    terminal.wait_for("the overview", |screen| screen.contains("armL"));
    let killed = Instant::now();
    signal(demo.pid("nh"), Signal::KILL);
    terminal.wait_for("the death of the hoist's node", |screen| {
        screen.lines().any(|line| line.contains("nh") && line.contains("DEAD"))
    });
    println!("death shown after {:?}", killed.elapsed());
    terminal.keys(&["3"]);
    terminal.wait_for("who is missing", |screen| screen.contains("MISSING") && screen.contains("DEAD"));

    terminal.keys(&["q"]);
    terminal.assert_restored();
    assert!(terminal.screen().contains("ended: 0"));
    signal(demo.launcher(), Signal::INT);
    let (summary, code, errors) = demo.finish();
    assert_eq!(code, Some(1), "somebody else ended a node: {summary} {errors}");
}

#[test]
fn signals_a_resize_to_nothing_and_a_stop_leave_the_terminal_as_it_was() {
    if !tmux_is_here() {
        return;
    }
    let demo = Live::steady();
    let terminal = Terminal::open(demo.dir());
    for by in [Signal::TERM, Signal::INT, Signal::HUP] {
        terminal.start_monitor("");
        terminal.end_by(by);
    }
    terminal.start_monitor("");
    for (width, height) in [("1", "1"), ("40", "12"), ("200", "60"), ("120", "40")] {
        terminal.tmux(&["resize-window", "-x", width, "-y", height]);
        thread::sleep(Duration::from_millis(200));
    }
    terminal.wait_for("the overview", |screen| screen.contains("armL"));
    terminal.keys(&["C-z"]);
    terminal.wait_for("the shell while the monitor is stopped", |_| !terminal.on_alternate_screen());
    terminal.keys(&["fg", "Enter"]);
    terminal
        .wait_for("the overview again", |screen| screen.contains("armL") && terminal.on_alternate_screen());
    // In raw mode Ctrl-C is a key, not a signal.
    terminal.keys(&["C-c"]);
    terminal.assert_restored();
}

#[test]
fn a_key_that_comes_together_with_a_resize_is_taken() {
    let Some((_demo, terminal)) = watched("") else { return };
    // On a busy machine the monitor reads its terminal so late that the resize and the key are both there.
    let busy = Busy::new(6);
    for round in 0..40 {
        let (width, key, shows) = [("100", "3", "[3 Rdv]"), ("120", "1", "[1 Over]")][round % 2];
        terminal.tmux(&["resize-window", "-x", width, "-y", "40", ";", "send-keys", key]);
        terminal.wait_for(shows, |screen| screen.contains(shows));
    }
    drop(busy);
    terminal.keys(&["q"]);
    terminal.assert_restored();
}

/// Threads that keep cores busy until this is dropped.
struct Busy(Arc<AtomicBool>);

impl Busy {
    fn new(threads: usize) -> Self {
        let on = Arc::new(AtomicBool::new(true));
        for _ in 0..threads {
            let on = Arc::clone(&on);
            thread::spawn(move || while on.load(Ordering::Relaxed) {});
        }
        Self(on)
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

#[test]
fn without_colour_the_selection_is_still_seen() {
    let Some((_demo, terminal)) = watched("NO_COLOR=1") else { return };
    let plain = terminal.screen();
    assert!(plain.lines().any(|line| line.trim_start().starts_with('>')), "no selection:\n{plain}");
    assert!(!terminal.has_colour(), "a colour in spite of NO_COLOR:\n{plain}");
    terminal.keys(&["q"]);
    terminal.assert_restored();
}

#[test]
fn a_node_that_appears_later_is_found() {
    let Some((demo, terminal)) = watched("") else { return };
    // In a second run of the same cell in the same folder, the nodes are other processes.
    let record = demo.dir().join("again.imrs");
    let again = Live::steady_in(demo.dir(), &["--record", record.to_str().expect("UTF-8")]);
    let of_hoist = |screen: &str, states: &[&str]| {
        let rows = screen.lines().filter(|line| line.contains("nh (pid"));
        rows.filter(|row| states.iter().any(|state| row.contains(state))).count()
    };
    terminal.wait_for("nodes that came", |screen| of_hoist(screen, &[" up "]) == 2);
    again.interrupt();
    let (_, code, errors) = again.finish();
    assert!(is_well(code, &errors), "{code:?} {errors}");
    terminal.wait_for("nodes that came and went", |screen| {
        of_hoist(screen, &[" stopped ", " DEAD "]) == 1 && of_hoist(screen, &[" up "]) == 1
    });
    terminal.keys(&["q"]);
    terminal.assert_restored();
}

#[test]
fn what_the_screen_records_is_replayed_in_the_terminal() {
    if !tmux_is_here() {
        return;
    }
    let demo = Live::steady();
    let terminal = Terminal::open(demo.dir());
    let file = demo.dir().join("seen.imrs");
    let shown = file.display();
    terminal.start_monitor("");
    terminal.keys(&["q"]);
    terminal.assert_restored();
    terminal.keys(&["clear", "Enter"]);
    terminal.type_monitor("", &format!("--record {shown}"));
    terminal.wait_for("a recording", |screen| {
        screen.contains(" REC ") && screen.contains("3/3 nodes") && screen.contains("hoist")
    });
    // The recording must be so long that its end differs from its beginning.
    wait_until("a second is recorded", || recorded_length(&file) >= Duration::from_secs(1));
    terminal.keys(&["r"]);
    terminal.wait_for("the end of the recording", |screen| !screen.contains(" REC "));
    terminal.keys(&["q"]);
    terminal.assert_restored();
    terminal.keys(&["clear", "Enter"]);
    terminal.type_monitor("", &format!("--replay {shown}"));
    // Reads from the screen the position in the replay, and the length of the recording.
    let position = |screen: &str| {
        let (_, rest) = screen.split_once("REPLAY ")?;
        let mut words = rest.split_whitespace();
        Some((words.next()?.to_owned(), words.nth(1)?.to_owned()))
    };
    terminal.wait_for("its end, when it has played", |screen| {
        screen.contains("armL") && position(screen).is_some_and(|(at, length)| at == length)
    });
    terminal.keys(&["Home"]);
    terminal.wait_for("its beginning", |screen| position(screen).is_some_and(|(at, length)| at != length));
    terminal.keys(&["q"]);
    terminal.assert_restored();

    let headless = demo.dir().join("headless.imrs");
    let name = headless.to_str().expect("text");
    let recording = ["monitor", "--record", name];
    look_until(demo.dir(), &[&recording[..], &["--for", "1s"]].concat(), "a node is seen", |said| {
        said.code == Some(0) && said.out.contains("monitor --replay")
    });
    // Without `--for` the monitor records until it is interrupted. The test interrupts it once the recording shows the
    // hoist's node.
    std::fs::remove_file(&headless).expect("a recording");
    let recorder = Program::start(imrs(demo.dir(), &recording));
    wait_until("the hoist is up in it", || run(&["monitor", "--replay", name]).out.contains("node nh: up"));
    recorder.interrupt();
    let recorded = recorder.finish();
    assert!(recorded.code == Some(0) && recorded.out.contains("monitor --replay"), "{recorded:?}");
    let replayed = run(&["monitor", "--replay", name]);
    assert!(replayed.out.contains("node nh: "), "{replayed:?}");
}

/// The time between the first and the last frame in a recording that may still grow.
fn recorded_length(file: &Path) -> Duration {
    let all = frames(file);
    let at = |frame: Option<&(u16, u64, _)>| frame.map_or(0, |(_, at, _)| *at);
    Duration::from_micros(at(all.last()) - at(all.first()))
}
