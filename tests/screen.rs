//! The monitor in a real terminal: tmux is the terminal, its screen is what a person sees.

mod support;

use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use support::{Demo, PATIENCE, signal};

/// Whether there is a tmux. Without one these tests say so; where everything is required they fail.
fn tmux_is_here() -> bool {
    let here = Command::new("tmux").arg("-V").output().is_ok_and(|output| output.status.success());
    if !here {
        let required = std::env::var_os("IMRS_REQUIRE_ALL").is_some_and(|value| value == "1");
        assert!(!required, "tmux is missing, and IMRS_REQUIRE_ALL=1 requires it");
        eprintln!(
            "\n*** SKIPPED: tmux is missing, so the monitor was NOT tested in a terminal. Install tmux. ***\n"
        );
    }
    here
}

/// A terminal with a shell in it.
struct Terminal {
    server: String,
    folder: PathBuf,
}

static TERMINALS: AtomicU32 = AtomicU32::new(0);

impl Terminal {
    fn open(folder: &Path) -> Self {
        let number = TERMINALS.fetch_add(1, Ordering::Relaxed);
        let server = format!("imrs-test-{}-{number}", std::process::id());
        let terminal = Self { server, folder: folder.to_owned() };
        terminal.tmux(&["new-session", "-d", "-x", "120", "-y", "40", "env", "PS1=ready> ", "sh"]);
        terminal.wait_for("the shell", |screen| screen.contains("ready>"));
        terminal
    }

    fn try_tmux(&self, args: &[&str]) -> Output {
        let mut command = Command::new("tmux");
        command.args(["-L", &self.server, "-f", "/dev/null"]).args(args);
        command.env_remove("TMUX").env("LC_ALL", "C.UTF-8").output().expect("tmux")
    }

    fn tmux(&self, args: &[&str]) -> String {
        let output = self.try_tmux(args);
        assert!(output.status.success(), "tmux {args:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    fn screen(&self) -> String {
        self.tmux(&["capture-pane", "-p"])
    }

    fn keys(&self, keys: &[&str]) {
        self.tmux(&[&["send-keys"], keys].concat());
    }

    /// Runs the monitor; when it has ended, the shell says with which code.
    fn start_monitor(&self, environment: &str) {
        self.type_monitor(environment, "");
        self.wait_for("the overview", |screen| screen.contains("armL") && screen.contains("hoist"));
        assert!(self.on_alternate_screen());
    }

    fn type_monitor(&self, environment: &str, flags: &str) {
        let folder = self.folder.display();
        let program = env!("CARGO_BIN_EXE_imrs");
        let line =
            format!("XDG_RUNTIME_DIR={folder} {environment} {program} monitor {flags}; echo \"ended: $?\"");
        self.keys(&[&line, "Enter"]);
    }

    fn wait_for(&self, what: &str, is_there: impl Fn(&str) -> bool) -> String {
        let end = Instant::now() + PATIENCE;
        loop {
            let screen = self.screen();
            if is_there(&screen) {
                return screen;
            }
            assert!(Instant::now() < end, "waited in vain for {what}:\n{screen}");
            thread::sleep(Duration::from_millis(30));
        }
    }

    fn on_alternate_screen(&self) -> bool {
        self.tmux(&["display-message", "-p", "#{alternate_on}"]).trim() == "1"
    }

    /// The terminal is the shell's again, and what is typed is seen.
    fn assert_restored(&self) {
        self.wait_for("the shell after the monitor", |screen| screen.contains("ended: "));
        assert!(!self.on_alternate_screen(), "the alternate screen was left on");
        assert_eq!(
            self.tmux(&["display-message", "-p", "#{cursor_flag}"]).trim(),
            "1",
            "the cursor was left hidden"
        );
        self.keys(&["echo all-well-$((40+2))", "Enter"]);
        let screen = self.wait_for("an echo", |screen| screen.contains("all-well-42"));
        assert!(screen.contains("echo all-well-$((40+2))"), "what is typed is not seen:\n{screen}");
    }

    /// The process of the monitor: the only child of the shell.
    fn monitor_pid(&self) -> u32 {
        let shell = self.tmux(&["display-message", "-p", "#{pane_pid}"]);
        let children = std::fs::read_to_string(format!("/proc/{0}/task/{0}/children", shell.trim()));
        let children = children.expect("the shell's children");
        children.split_whitespace().next().and_then(|pid| pid.parse().ok()).expect("a monitor")
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = self.try_tmux(&["kill-server"]);
    }
}

#[test]
fn the_screen_shows_who_waits_for_whom_and_a_death_and_gives_the_terminal_back() {
    if !tmux_is_here() {
        return;
    }
    let demo = Demo::start(&["--for", "10m"]);
    let terminal = Terminal::open(demo.dir.path());
    terminal.start_monitor("");
    let overview = terminal.screen();
    for name in ["nl", "nr", "nh", "armR", "beat", "halt", "lift"] {
        assert!(overview.contains(name), "`{name}` is missing:\n{overview}");
    }
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
    let demo = Demo::start(&["--for", "10m"]);
    let terminal = Terminal::open(demo.dir.path());
    for by in [Signal::TERM, Signal::INT] {
        terminal.start_monitor("");
        signal(terminal.monitor_pid(), by);
        terminal.assert_restored();
        terminal.keys(&["clear", "Enter"]);
        terminal.wait_for("an empty screen", |screen| !screen.contains("ended: "));
    }
    terminal.start_monitor("");
    for (width, height) in [("1", "1"), ("40", "12"), ("120", "40")] {
        terminal.tmux(&["resize-window", "-x", width, "-y", height]);
        thread::sleep(Duration::from_millis(200));
    }
    terminal.wait_for("the overview", |screen| screen.contains("armL"));
    terminal.keys(&["C-z"]);
    terminal.wait_for("the shell while the monitor is stopped", |_| !terminal.on_alternate_screen());
    terminal.keys(&["fg", "Enter"]);
    terminal
        .wait_for("the overview again", |screen| screen.contains("armL") && terminal.on_alternate_screen());
    // What the terminal does on Ctrl-C when nobody asked for raw keys is a signal; here it is a key.
    terminal.keys(&["C-c"]);
    terminal.assert_restored();
}

#[test]
fn without_colour_the_selection_is_still_seen() {
    if !tmux_is_here() {
        return;
    }
    let demo = Demo::start(&["--for", "10m"]);
    let terminal = Terminal::open(demo.dir.path());
    terminal.start_monitor("NO_COLOR=1");
    let plain = terminal.screen();
    assert!(plain.lines().any(|line| line.trim_start().starts_with('>')), "no selection:\n{plain}");
    let styled = terminal.tmux(&["capture-pane", "-p", "-e"]);
    for colour in ["\u{1b}[31m", "\u{1b}[32m", "\u{1b}[33m", "[38;"] {
        assert!(!styled.contains(colour), "a colour in spite of NO_COLOR:\n{styled}");
    }
    terminal.keys(&["q"]);
    terminal.assert_restored();
}

#[test]
fn a_node_that_appears_later_is_found() {
    if !tmux_is_here() {
        return;
    }
    let demo = Demo::start(&["--for", "10m"]);
    let terminal = Terminal::open(demo.dir.path());
    terminal.start_monitor("");
    // A second run of the same cell in the same folder: nodes of its own, with other processes.
    let again = support::finish(support::imrs(demo.dir.path(), &["demo", "beam-lift", "--for", "3s"]));
    assert_eq!(again.code, Some(0), "{again:?}");
    let of_hoist = |screen: &str, states: &[&str]| {
        let rows = screen.lines().filter(|line| line.contains("nh (pid"));
        rows.filter(|row| states.iter().any(|state| row.contains(state))).count()
    };
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
    let demo = Demo::start(&["--for", "10m"]);
    let terminal = Terminal::open(demo.dir.path());
    let file = demo.dir.path().join("seen.imrs");
    let shown = file.display();
    terminal.start_monitor("");
    terminal.keys(&["q"]);
    terminal.assert_restored();
    terminal.keys(&["clear", "Enter"]);
    terminal.type_monitor("", &format!("--record {shown}"));
    terminal.wait_for("a recording", |screen| {
        screen.contains(" REC ") && screen.contains("3/3 nodes") && screen.contains("hoist")
    });
    // Long enough to have an end that is not its beginning.
    thread::sleep(Duration::from_secs(1));
    terminal.keys(&["r"]);
    terminal.wait_for("the end of the recording", |screen| !screen.contains(" REC "));
    terminal.keys(&["q"]);
    terminal.assert_restored();
    terminal.keys(&["clear", "Enter"]);
    terminal.type_monitor("", &format!("--replay {shown}"));
    // Where it stands, and how long it is.
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

    let headless = demo.dir.path().join("headless.imrs");
    let name = headless.to_str().expect("text");
    let recorded = support::run_in(demo.dir.path(), &["monitor", "--record", name, "--for", "1s"]);
    assert!(recorded.code == Some(0) && recorded.out.contains("monitor --replay"), "{recorded:?}");
    let replayed = support::run(&["monitor", "--replay", name]);
    assert!(replayed.code == Some(0) && replayed.out.contains("node nh: up"), "{replayed:?}");
}
