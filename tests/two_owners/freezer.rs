//! The freezer of the kernel, which stops processes without a signal.

use std::fs;
use std::io;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// How control groups of version 1 or 2 freeze processes.
struct Version {
    root: &'static str,
    file: &'static str,
    frozen: &'static str,
    thawed: &'static str,
    /// The file and the text in it by which the kernel reports that the whole group is frozen.
    says: (&'static str, &'static str),
}

const VERSIONS: [Version; 2] = [
    Version {
        root: "/sys/fs/cgroup/freezer",
        file: "freezer.state",
        frozen: "FROZEN",
        thawed: "THAWED",
        says: ("freezer.state", "FROZEN"),
    },
    Version {
        root: "/sys/fs/cgroup",
        file: "cgroup.freeze",
        frozen: "1",
        thawed: "0",
        says: ("cgroup.events", "frozen 1"),
    },
];

/// How long an ending process may remain in its control group.
const EMPTY_WITHIN: Duration = Duration::from_secs(1);

/// Frozen processes. They resume when this value is dropped, or at the latest when this program ends. No signal ends a
/// frozen process, so without this the process would exist until the machine reboots.
pub struct Freezer {
    group: PathBuf,
    version: &'static Version,
    /// A shell that resumes the group when its standard input ends.
    keeper: Child,
}

impl Version {
    fn keeper(&self, group: &Path) -> io::Result<Child> {
        let mut shell = Command::new("sh");
        shell.args(["-c", "cat > /dev/null; { echo \"$1\" > \"$0\"; } 2> /dev/null"]);
        shell.arg(group.join(self.file)).arg(self.thawed);
        // The shell has its own process group, so that a Ctrl-C for this program does not end it.
        shell.stdin(Stdio::piped()).process_group(0).spawn()
    }
}

impl Freezer {
    /// Freezes these processes. Returns once they are frozen.
    ///
    /// # Errors
    /// The kernel may not let this program freeze processes.
    pub fn of(pids: impl Iterator<Item = u32>) -> io::Result<Self> {
        static MADE: AtomicU32 = AtomicU32::new(0);
        let there = |version: &&Version| {
            let first = version.file == "freezer.state";
            first && Path::new(version.root).join("tasks").exists()
                || Path::new(version.root).join("cgroup.controllers").exists()
        };
        let version = VERSIONS.iter().find(there).ok_or(io::ErrorKind::Unsupported)?;
        let name = format!("imrs-{}-{}", std::process::id(), MADE.fetch_add(1, Ordering::Relaxed));
        let group = Path::new(version.root).join(name);
        fs::create_dir(&group)?;
        let keeper = version.keeper(&group)?;
        let freezer = Self { group, version, keeper };
        for pid in pids {
            // A process that has already ended cannot be frozen.
            match fs::write(freezer.group.join("cgroup.procs"), pid.to_string()) {
                Err(error) if error.raw_os_error() != Some(3) => return Err(error),
                _ => {}
            }
        }
        fs::write(freezer.group.join(version.file), version.frozen)?;
        let (file, word) = version.says;
        let end = Instant::now() + Duration::from_secs(20);
        while !fs::read_to_string(freezer.group.join(file))?.contains(word) {
            if Instant::now() > end {
                return Err(io::ErrorKind::TimedOut.into());
            }
            thread::sleep(Duration::from_millis(1));
        }
        Ok(freezer)
    }

    /// Resumes the processes, by dropping the freezer.
    pub fn thaw(self) {}
}

impl Drop for Freezer {
    fn drop(&mut self) {
        let _ = fs::write(self.group.join(self.version.file), self.version.thawed);
        let pids = fs::read_to_string(self.group.join("cgroup.procs")).unwrap_or_default();
        for pid in pids.lines() {
            let _ = fs::write(Path::new(self.version.root).join("cgroup.procs"), pid);
        }
        drop(self.keeper.stdin.take());
        let _ = self.keeper.wait();
        // An ending process remains in the group for a moment. An empty group that cannot be removed does no harm.
        let end = Instant::now() + EMPTY_WITHIN;
        while fs::remove_dir(&self.group).is_err() && Instant::now() < end {
            thread::sleep(Duration::from_millis(1));
        }
    }
}
