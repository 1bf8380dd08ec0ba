//! Tests of the monitor with nodes that are slow, stopped or dead, with foreign servers, and on limited terminals.

use super::terminal::{Terminal, tmux_is_here, watched};
use crate::support::live::Live;
use crate::support::{excused, is_quiet, run_in, runtime_dir, side_by_side, signal, wait_until};
use rustix::process::Signal;
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::thread;
use std::time::Duration;

/// Opens a socket at the place where a monitor looks for nodes. Threads serve it by calling `each`, and end with the
/// test's process.
fn listen(dir: &Path, node: &str, each: fn(UnixStream)) -> String {
    let folder = imrs_wire::obs::place::prepare_in(&dir.join("imrs"), "beam_lift", node, std::process::id());
    let path = folder.expect("a place for the socket");
    let listener = UnixListener::bind(&path).expect("a socket");
    thread::spawn(move || {
        listener.incoming().flatten().for_each(|stream| drop(thread::spawn(move || each(stream))));
    });
    path.display().to_string()
}

/// A server that speaks another protocol.
fn garbage(mut stream: UnixStream) {
    let _ = stream.write_all(&[0x5a; 4096]);
    let _ = stream.read(&mut [0; 64]);
}

/// Sends a frame that never ends, one byte at a time.
fn drip(mut stream: UnixStream) {
    let _ = stream.write_all(&[0xff, 0xff, 0, 0]);
    while stream.write_all(&[0]).is_ok() {
        thread::sleep(Duration::from_millis(200));
    }
}

/// Sends the length of a frame that is longer than allowed.
fn endless(mut stream: UnixStream) {
    let _ = stream.write_all(&[0xff; 4]);
    while stream.write_all(&[0xff; 65536]).is_ok() {}
}

/// A server that sends nothing.
fn mute(mut stream: UnixStream) {
    let _ = stream.read_to_end(&mut Vec::new());
}

/// The name of a foreign server, and the function that serves a monitor.
type Stranger = (&'static str, fn(UnixStream));

const STRANGERS: [Stranger; 4] = [("garbage", garbage), ("drip", drip), ("endless", endless), ("mute", mute)];

#[test]
fn hostile_and_slow_servers_neither_hang_the_monitor_nor_hide_the_nodes() {
    let dir = runtime_dir();
    side_by_side(STRANGERS, |(name, each)| {
        let path = listen(dir.path(), name, each);
        let said = run_in(dir.path(), &["monitor", "--connect", &format!("unix:{path}"), "--once"]);
        assert_eq!(said.code, Some(3), "{name}: {said:?}");
        assert!(said.err.contains("no running node found"), "{name}: {said:?}");
    });
    if !tmux_is_here() {
        return;
    }
    let demo = Live::steady();
    for (name, each) in STRANGERS {
        listen(demo.dir(), name, each);
    }
    let terminal = Terminal::open(demo.dir());
    terminal.start_monitor("");
    terminal.press(&["3"], "lift");
    terminal.press(&["1"], "NODE/TASK/PORT");
    terminal.leave();
}

#[test]
fn a_stopped_node_is_silent_and_never_shown_as_up() {
    let Some((demo, terminal)) = watched("") else { return };
    let row = |screen: &str, state: &str| {
        screen.lines().any(|line| line.contains("nh (pid") && line.to_lowercase().contains(state))
    };
    signal(demo.pid("nh"), Signal::STOP);
    terminal.wait_for("its silence", |screen| row(screen, "silent") && !row(screen, " up "));
    signal(demo.pid("nh"), Signal::CONT);
    terminal.wait_for("its return", |screen| row(screen, " up ") && !row(screen, "silent"));
    terminal.leave();
}

#[test]
fn a_restarted_node_has_a_new_incarnation() {
    if !tmux_is_here() {
        return;
    }
    // The restarted node is held back for the longest TTL of a command. Both arms wait meanwhile.
    let demo = Live::steady_with(&["--kill", "nh@2s", "--restart", "nh@4s"]);
    let terminal = Terminal::open(demo.dir());
    terminal.start_monitor("");
    let before = format!("nh (pid {})", demo.pid("nh"));
    let is_dead = |screen: &str| screen.lines().any(|l| l.contains(&before) && l.contains("DEAD"));
    let is_up = |line: &str| line.contains(" up ") || line.contains("held back");
    let lives_again = |screen: &str| {
        screen.lines().any(|line| line.contains("nh (pid") && !line.contains(&before) && is_up(line))
    };
    // A monitor that starts later does not see the node die.
    let in_time = terminal.screen().contains(&before);
    if !in_time {
        excused("the monitor came after the death");
    }
    terminal.wait_for("its death", |screen| is_dead(screen) || !in_time && lives_again(screen));
    terminal.wait_for("its next life", lives_again);
    terminal.leave();
}

#[test]
fn ascii_is_all_that_is_drawn_where_no_more_is_wanted() {
    if !tmux_is_here() {
        return;
    }
    let demo = Live::steady();
    let terminal = Terminal::open(demo.dir());
    for flags in ["--ascii", "--theme ascii"] {
        terminal.type_monitor("", flags);
        let screen = terminal.wait_for("the overview", |s| s.contains("armL") && s.contains("hoist"));
        assert!(screen.is_ascii(), "{flags}:\n{screen}");
        terminal.leave();
    }
}

#[test]
fn nothing_there_gives_the_terminal_back_and_says_what_to_do() {
    if !tmux_is_here() {
        return;
    }
    let dir = runtime_dir();
    let terminal = Terminal::open(dir.path());
    terminal.type_monitor("", "");
    let screen = terminal.wait_for("the end", |screen| screen.contains("ended: 3"));
    assert!(screen.contains("imrs monitor --demo"), "{screen}");
    terminal.assert_restored();
}

/// Goal M17: a first-time user can say for which robot all others wait. No file or process is left behind afterwards.
#[test]
fn the_demonstration_names_who_is_awaited_and_leaves_nothing_behind() {
    if !tmux_is_here() {
        return;
    }
    let dir = runtime_dir();
    let terminal = Terminal::open(dir.path());
    let start = std::time::Instant::now();
    terminal.type_monitor("", "--demo");
    // Each screen has its part of the demo to show: a death and what it blocks, a flood, rejected questions.
    let death = |s: &str| s.contains("BLOCKED BY hoist@nh - DEAD") && figure(s, "nh (pid", "DEAD").is_some();
    let flood = |s: &str| counter(s, "part", "receive", 1) > 0 && counter(s, "grab", "response", 2) > 0;
    terminal.wait_for("a death, a flood and rejections", |screen| death(screen) && flood(screen));
    println!("the awaited robot named after {:?}; goal 10 s", start.elapsed());
    for (key, shown) in [
        ("3", "GATHERING"),
        ("4", "part#"),
        ("5", "its handler begins"),
        ("6", "refused"),
        ("7", "transition kinds seen"),
        ("8", "next deadline"),
    ] {
        terminal.keys(&[key]);
        terminal.wait_for(shown, |screen| screen.contains(shown));
    }
    terminal.keys(&["2"]);
    // While a frame is written, lines of the screen before are below it, and they name messages, too.
    let queue = terminal.wait_for("a queue", |screen| {
        screen.contains("part at press") && !screen.contains("next deadline") && remaining(screen).len() > 2
    });
    assert!(remaining(&queue).is_sorted(), "not in the order of the deadlines:\n{queue}");
    println!("each screen had something to show after {:?}; goal 10 s", start.elapsed());
    assert!(!is_quiet() || start.elapsed() <= Duration::from_secs(10), "{:?}", start.elapsed());
    let monitor = terminal.monitor_pid();
    let folder = std::env::temp_dir().join(format!("imrs-demo-{monitor}"));
    assert!(folder.is_dir(), "{}", folder.display());
    wait_until("parts that were sent and never arrived", || lost_parts(&folder) >= 3);
    let launcher = std::fs::read_to_string(format!("/proc/{monitor}/task/{monitor}/children"));
    let launcher = launcher.expect("the monitor's children");
    let nodes: Vec<String> = (launcher.split_whitespace())
        .flat_map(|pid| std::fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")))
        .flat_map(|children| children.split_whitespace().map(str::to_owned).collect::<Vec<_>>())
        .collect();
    assert!(!nodes.is_empty(), "{launcher}");
    terminal.leave();
    wait_until("the demonstration's folder is gone", || !folder.exists());
    for pid in launcher.split_whitespace().chain(nodes.iter().map(String::as_str)) {
        wait_until("the demonstration's processes are gone", || !Path::new("/proc").join(pid).exists());
    }
}

/// The word of the first line with `within` that is `figure`.
fn figure<'a>(screen: &'a str, within: &str, figure: &str) -> Option<&'a str> {
    let mut words = screen.lines().find(|line| line.contains(within))?.split_whitespace();
    words.find(|word| *word == figure)
}

/// A counter in the row of a port's receiving end: the number that stands `after` columns behind the expired messages.
fn counter(screen: &str, port: &str, usage: &str, after: usize) -> u64 {
    let row = screen.lines().find(|line| line.contains(port) && line.contains(usage)).unwrap_or("");
    // The cells are the port, class, usage, `4 parties`, the queue and its bar, slack, rate, and then the counters.
    let cell = row.split_whitespace().nth(9 + after).unwrap_or("");
    cell.trim_start_matches('+').parse().unwrap_or(0)
}

/// The remaining times of the messages on the screen of a port, in microseconds, in the order of the rows.
fn remaining(screen: &str) -> Vec<u64> {
    let of_row = |line: &str| {
        let mut words = line.split_whitespace().skip_while(|word| !word.starts_with("#0."));
        let left = words.nth(2)?.trim_start_matches('~');
        let digits = left.trim_end_matches(char::is_alphabetic);
        let unit = match &left[digits.len()..] {
            "us" => 1.0,
            "ms" => 1e3,
            "s" => 1e6,
            _ => return Some(0),
        };
        digits.parse::<f64>().ok().map(|number| (number * unit) as u64)
    };
    screen.lines().filter_map(of_row).collect()
}

/// How many parts the nodes of the demonstration have sent that neither entered the press's queue nor were refused.
fn lost_parts(folder: &Path) -> i64 {
    let said = run_in(folder, &["monitor", "--once", "--format", "json"]);
    let Ok(state) = serde_json::from_str::<serde_json::Value>(&said.out) else { return 0 };
    let all = |list: &serde_json::Value| list.as_array().cloned().unwrap_or_default();
    let tasks = all(&state["nodes"]).into_iter().flat_map(|node| all(&node["tasks"]));
    let ports = tasks.flat_map(|task| all(&task["ports"])).filter(|port| port["name"] == "part");
    let count = |port: &serde_json::Value, name: &str| port[name].as_i64().unwrap_or(0);
    ports.map(|port| count(&port, "sent") - count(&port, "enqueued") - count(&port, "refused")).sum()
}
