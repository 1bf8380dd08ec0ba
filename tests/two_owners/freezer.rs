//! The kernel's freezer: processes that stand still without having been told.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// A control group of the first or of the second version.
struct Version {
    root: &'static str,
    file: &'static str,
    frozen: &'static str,
    thawed: &'static str,
    /// Where the kernel says that all of it stands still, and what it says then.
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

/// Processes that are frozen. They go on at the latest when this is dropped.
pub struct Freezer {
    group: PathBuf,
    version: &'static Version,
}

impl Freezer {
    /// Freezes these processes, and returns when they stand still.
    ///
    /// # Errors
    /// The kernel lets this program freeze nothing.
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
        let freezer = Self { group, version };
        for pid in pids {
            // One that has ended meanwhile needs no freezing.
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

    /// Lets them go on.
    pub fn thaw(self) {}
}

impl Drop for Freezer {
    fn drop(&mut self) {
        let _ = fs::write(self.group.join(self.version.file), self.version.thawed);
        let pids = fs::read_to_string(self.group.join("cgroup.procs")).unwrap_or_default();
        for pid in pids.lines() {
            let _ = fs::write(Path::new(self.version.root).join("cgroup.procs"), pid);
        }
        // A process that is just ending keeps it for a moment; an empty group harms nobody.
        let _ = fs::remove_dir(&self.group);
    }
}
