//! A terminal into which a test can type, and whose screen it can read.

use crate::support::live::Live;
use crate::support::{PATIENCE, is_here, signal};
use rustix::process::Signal;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Whether tmux is installed. Without it these tests print that they were skipped; with `IMRS_REQUIRE_ALL=1` they fail.
pub fn tmux_is_here() -> bool {
    let here = Command::new("tmux").arg("-V").output().is_ok_and(|output| output.status.success());
    is_here((!here).then_some("tmux"), "the monitor was NOT tested in a terminal")
}

/// Starts the steady cell, and a monitor of it in a terminal; `None` without tmux.
pub fn watched(environment: &str) -> Option<(Live, Terminal)> {
    tmux_is_here().then(|| {
        let demo = Live::steady();
        let terminal = Terminal::open(demo.dir());
        terminal.start_monitor(environment);
        (demo, terminal)
    })
}

/// A terminal with a shell in it.
pub struct Terminal {
    /// The socket of the tmux server. It lies in the folder, and goes with it.
    socket: PathBuf,
    folder: PathBuf,
}

/// How often a test looks at the screen while it waits.
const LOOK_EVERY: Duration = Duration::from_millis(30);
/// How long a click may take to show an effect, before the test clicks again. A second click on a row opens it.
const BETWEEN_CLICKS: Duration = Duration::from_secs(10);

static TERMINALS: AtomicU32 = AtomicU32::new(0);

impl Terminal {
    pub fn open(folder: &Path) -> Self {
        let number = TERMINALS.fetch_add(1, Ordering::Relaxed);
        let terminal = Self { socket: folder.join(format!("tmux-{number}")), folder: folder.to_owned() };
        terminal.tmux(&["new-session", "-d", "-x", "120", "-y", "40", "env", "PS1=ready> ", "sh"]);
        terminal.wait_for("the shell", |screen| screen.contains("ready>"));
        terminal
    }

    pub fn try_tmux(&self, args: &[&str]) -> Output {
        let mut command = Command::new("tmux");
        command.arg("-S").arg(&self.socket).args(["-f", "/dev/null"]).args(args);
        command.env_remove("TMUX").env("LC_ALL", "C.UTF-8").output().expect("tmux")
    }

    pub fn tmux(&self, args: &[&str]) -> String {
        let output = self.try_tmux(args);
        assert!(output.status.success(), "tmux {args:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    pub fn screen(&self) -> String {
        self.tmux(&["capture-pane", "-p"])
    }

    /// Whether anything on the screen has a colour.
    pub fn has_colour(&self) -> bool {
        let styled = self.tmux(&["capture-pane", "-p", "-e"]);
        ["\u{1b}[31m", "\u{1b}[32m", "\u{1b}[33m", "[38;"].iter().any(|colour| styled.contains(colour))
    }

    pub fn keys(&self, keys: &[&str]) {
        self.tmux(&[&["send-keys"], keys].concat());
    }

    /// Starts the monitor. After its end the shell prints its exit code.
    pub fn start_monitor(&self, environment: &str) {
        self.type_monitor(environment, "");
        let tasks = ["armL", "armR", "hoist"];
        self.wait_for("the overview", |screen| tasks.iter().all(|task| screen.contains(task)));
        assert!(self.on_alternate_screen());
    }

    pub fn type_monitor(&self, environment: &str, flags: &str) {
        let folder = self.folder.display();
        let program = env!("CARGO_BIN_EXE_imrs");
        let line = format!(
            "XDG_RUNTIME_DIR={folder} XDG_STATE_HOME={folder}/state {environment} {program} monitor {flags}; echo \"ended: $?\""
        );
        self.keys(&[&line, "Enter"]);
    }

    pub fn wait_for(&self, what: &str, is_there: impl Fn(&str) -> bool) -> String {
        self.look(PATIENCE, is_there).unwrap_or_else(|screen| panic!("waited in vain for {what}:\n{screen}"))
    }

    /// Looks at the screen until it is as wanted, for at most this time. The error is the last screen.
    fn look(&self, within: Duration, is_there: impl Fn(&str) -> bool) -> Result<String, String> {
        let end = Instant::now() + within;
        loop {
            let screen = self.screen();
            if is_there(&screen) {
                return Ok(screen);
            }
            if Instant::now() >= end {
                return Err(screen);
            }
            thread::sleep(LOOK_EVERY);
        }
    }

    pub fn on_alternate_screen(&self) -> bool {
        self.tmux(&["display-message", "-p", "#{alternate_on}"]).trim() == "1"
    }

    /// Asserts that the shell has the terminal again: the shell echoes and executes typed text, even if the monitor
    /// still has processes to stop.
    pub fn assert_restored(&self) {
        self.wait_for("the shell after the monitor", |_| !self.on_alternate_screen());
        assert_eq!(
            self.tmux(&["display-message", "-p", "#{cursor_flag}"]).trim(),
            "1",
            "the cursor was left hidden"
        );
        self.keys(&["echo all-well-$((40+2))", "Enter"]);
        let screen = self.wait_for("an echo", |screen| screen.contains("all-well-42"));
        assert!(screen.contains("echo all-well-$((40+2))"), "what is typed is not seen:\n{screen}");
        let code = |rest: &str| rest.starts_with(|c: char| c.is_ascii_digit());
        assert!(screen.split("ended: ").skip(1).any(code), "it has not ended:\n{screen}");
    }

    /// Quits the monitor, and clears the screen for the next one.
    pub fn leave(&self) {
        self.keys(&["q"]);
        self.assert_restored();
        self.keys(&["clear", "Enter"]);
        self.wait_for("an empty screen", |screen| !screen.contains("ended: "));
    }

    /// Ends the monitor's process by a signal.
    pub fn end_by(&self, by: Signal) {
        signal(self.monitor_pid(), by);
        self.assert_restored();
        self.keys(&["clear", "Enter"]);
        self.wait_for("an empty screen", |screen| !screen.contains("ended: "));
    }

    /// Presses keys, and waits until the screen shows `shows`.
    pub fn press(&self, keys: &[&str], shows: &str) -> String {
        self.keys(keys);
        self.wait_for(shows, |screen| screen.contains(shows))
    }

    /// Clicks on this word until the screen is as wanted. The word may move between the look at the screen and the click:
    /// on a late machine, warnings come and go in the lines above it.
    pub fn click(&self, word: &str, what: &str, is_there: impl Fn(&str) -> bool) {
        let end = Instant::now() + PATIENCE;
        loop {
            let screen = self.screen();
            let at = (screen.lines().enumerate())
                .find_map(|(y, line)| line.split_once(word).map(|(before, _)| (y, before.chars().count())));
            if let Some((y, x)) = at {
                // A press of the left button, in the form in which terminals report it; rows and columns count from one.
                self.keys(&["-l", &format!("\u{1b}[<0;{};{}M", x + 1, y + 1)]);
            }
            let Err(screen) = self.look(BETWEEN_CLICKS, &is_there) else { return };
            assert!(Instant::now() < end, "clicks on `{word}` never showed {what}:\n{screen}");
        }
    }

    /// The process id of the monitor, which is the only child of the shell.
    pub fn monitor_pid(&self) -> u32 {
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
