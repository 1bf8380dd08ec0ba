//! Pins threads to cores, and counts their sleeps.

use rustix::process::Pid;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::sync::OnceLock;

/// A core for a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Core {
    /// The first core that this process may use.
    First,
    /// The second core that this process may use; the first if there is only one.
    Second,
}

/// The cores on which the process was started.
fn allowed() -> &'static [usize] {
    static ALLOWED: OnceLock<Vec<usize>> = OnceLock::new();
    ALLOWED.get_or_init(|| {
        let set = sched_getaffinity(None).unwrap_or_else(|_| CpuSet::new());
        let found: Vec<usize> = (0..CpuSet::MAX_CPU).filter(|&core| set.is_set(core)).collect();
        if found.is_empty() { vec![0] } else { found }
    })
}

/// How many cores this process may use.
#[must_use]
pub fn count() -> usize {
    allowed().len()
}

/// How many processors the machine has, whether this process may use them or not.
#[must_use]
pub fn processors() -> usize {
    static ALL: OnceLock<usize> = OnceLock::new();
    *ALL.get_or_init(|| {
        let stat = std::fs::read_to_string("/proc/stat").unwrap_or_default();
        stat.lines().skip(1).take_while(|line| line.starts_with("cpu")).count().max(1)
    })
}

/// Pins the calling thread, and the threads that it starts, to one core. Returns whether the kernel allowed it.
pub fn pin(core: Core) -> bool {
    let allowed = allowed();
    let at = match core {
        Core::First => allowed.first(),
        Core::Second => allowed.get(1).or(allowed.first()),
    };
    at.is_some_and(|&at| set([at]))
}

/// Lets the calling thread run on every core of the process. Returns whether the kernel allowed it.
pub fn unpin() -> bool {
    set(allowed().iter().copied())
}

/// Pins every present thread of the process to the first or the last allowed core. This is for libraries that start
/// threads of their own.
pub fn pin_all(core: Core) {
    let allowed = allowed();
    let at = if core == Core::First { allowed.first() } else { allowed.last() };
    set_all(at.map_or(&[], std::slice::from_ref));
}

/// Lets every present thread of the process run on every core of the process.
pub fn unpin_all() {
    set_all(allowed());
}

fn set_all(cores: &[usize]) {
    let threads = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    for thread in threads {
        let id = thread.file_name().to_str().and_then(|name| name.parse().ok()).and_then(Pid::from_raw);
        // A thread that has ended since it was listed needs no core.
        let _ = id.map(|id| sched_setaffinity(Some(id), &of(cores.iter().copied())));
    }
}

fn set(cores: impl IntoIterator<Item = usize>) -> bool {
    sched_setaffinity(None, &of(cores)).is_ok()
}

fn of(cores: impl IntoIterator<Item = usize>) -> CpuSet {
    let mut set = CpuSet::new();
    for core in cores {
        set.set(core);
    }
    set
}

/// Sets this thread's timer slack to 1 ns, as the runtime's threads do, so that its sleeps end on time.
pub fn sleep_exactly() {
    // This fails only on a kernel without this call.
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
}

/// How often each thread of this process has slept so far: its voluntary context switches.
#[derive(Debug)]
pub struct Sleeps(BTreeMap<OsString, u64>);

impl Sleeps {
    /// How often each thread has slept up to now.
    #[must_use]
    pub fn now() -> Self {
        let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
        let of = |status: String| {
            let line = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"))?;
            line.trim().parse::<u64>().ok()
        };
        let all = tasks.filter_map(|task| {
            let status = std::fs::read_to_string(task.path().join("status")).ok()?;
            Some((task.file_name(), of(status)?))
        });
        Self(all.collect())
    }

    /// How often the threads have slept since this was counted. Threads that have ended since then do not count.
    #[must_use]
    pub fn since(&self) -> u64 {
        let before = |thread| self.0.get(thread).copied().unwrap_or_default();
        Self::now().0.iter().map(|(thread, now)| now.saturating_sub(before(thread))).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_is_pinned_may_use_one_core_and_then_all_again() {
        std::thread::spawn(|| {
            let all = count();
            assert!(pin(Core::Second));
            let set = sched_getaffinity(None).expect("a set");
            assert_eq!(set.count(), 1);
            assert!(unpin());
            assert_eq!(sched_getaffinity(None).expect("a set").count() as usize, all);
        })
        .join()
        .expect("no panic");
    }

    #[test]
    fn sleeps_are_counted() {
        let before = Sleeps::now();
        for _ in 0..20 {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        assert!(before.since() >= 20);
    }
}
