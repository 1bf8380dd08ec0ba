//! Sets up the kernel's real-time scheduling: SCHED_FIFO, locked memory, and one core per node. If the kernel refuses one of
//! these, the nodes run without it; the launcher says so once, and every node shows it to monitors.

use imrs_wire::obs::RealTime;
use rustix::io::Errno;
use rustix::mm::{MlockAllFlags, mlockall, munlockall};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use std::sync::OnceLock;
use std::thread;
use thread_priority::unix::{set_thread_priority_and_policy, thread_native_id};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
};

/// The cores that the process was allowed to use before it was bound to one core.
static CORES: OnceLock<CpuSet> = OnceLock::new();

/// The priority of the tasks on a scale of 100: above all ordinary threads, below the kernel's own real-time threads.
const PRIORITY: u8 = 20;
/// The lowest priority under SCHED_FIFO.
const LAST: u8 = 1;

/// Why real-time scheduling is refused.
#[derive(Debug, thiserror::Error)]
pub enum RtError {
    /// The kernel does not let this user lock memory.
    #[error(
        "the kernel does not let this user lock memory ({0}): raise `memlock` to unlimited in /etc/security/limits.conf, or give the program the right with `setcap cap_ipc_lock,cap_sys_nice+ep`"
    )]
    Memory(Errno),
    /// The kernel does not let this user choose SCHED_FIFO.
    #[error(
        "the kernel does not let this user choose SCHED_FIFO ({0}): set `rtprio` to 50 in /etc/security/limits.conf, or give the program the right with `setcap cap_ipc_lock,cap_sys_nice+ep`"
    )]
    Scheduler(String),
    /// The kernel does not let this process be bound to a core.
    #[error("the kernel does not let this user choose a core ({0})")]
    Core(Errno),
}

/// Puts this thread, and every thread that it starts from now on, under SCHED_FIFO on one core, and locks the memory of the
/// process. Nodes take the allowed cores in turn, by their `place` in the cell.
pub fn begin(place: usize) -> RealTime {
    let refused = [lock().is_err(), choose(PRIORITY).is_err(), pin(place).is_err()];
    match refused {
        [false, false, false] => RealTime::Had,
        [memory, scheduler, core] => RealTime::Refused { memory, scheduler, core },
    }
}

/// Runs `what` on a thread with the lowest real-time priority, on any allowed core; threads that this thread starts
/// inherit both. An observer must never preempt a task. Yet no ordinary program may preempt an observer that holds the
/// lock of a communication task, because the task would wait for that lock. A task of another node on the same core can
/// still preempt the observer.
pub fn behind<T: Send>(what: impl FnOnce() -> T + Send) -> T {
    // Without `--rt` all threads are ordinary ones.
    let Some(cores) = CORES.get() else { return what() };
    thread::scope(|scope| {
        let likeness = scope.spawn(|| {
            // If the kernel refuses this, the tasks run as ordinary threads, and so does this thread.
            let _ = choose(LAST);
            let _ = sched_setaffinity(None, cores);
            what()
        });
        likeness.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

/// The cores that the process was allowed to use before it was bound to one core; empty if it was not bound.
pub fn cores() -> Vec<usize> {
    let cores = CORES.get().into_iter();
    cores.flat_map(|cores| (0..CpuSet::MAX_CPU).filter(|&core| cores.is_set(core))).collect()
}

/// What the kernel would refuse to [`begin`]. The check has no lasting effect.
pub fn refused() -> Vec<RtError> {
    let memory = lock();
    // The check runs on a thread of its own, because the settings of a thread end with the thread.
    let tried = thread::spawn(|| [choose(PRIORITY), pin(0)]).join();
    let all = tried.unwrap_or_else(|_| [Err(RtError::Scheduler("no thread".into())), Ok(())]);
    // If the kernel refused to lock memory, there is nothing to unlock.
    let _ = munlockall();
    std::iter::once(memory).chain(all).filter_map(Result::err).collect()
}

fn lock() -> Result<(), RtError> {
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).map_err(RtError::Memory)
}

fn pin(place: usize) -> Result<(), RtError> {
    let allowed = sched_getaffinity(None).map_err(RtError::Core)?;
    let allowed = CORES.get_or_init(|| allowed);
    let cores: Vec<usize> = (0..CpuSet::MAX_CPU).filter(|&core| allowed.is_set(core)).collect();
    let Some(&core) = cores.get(place % cores.len().max(1)) else { return Err(RtError::Core(Errno::INVAL)) };
    let mut one = CpuSet::new();
    one.set(core);
    sched_setaffinity(None, &one).map_err(RtError::Core)
}

fn choose(priority: u8) -> Result<(), RtError> {
    let refused = |error: &dyn std::fmt::Debug| RtError::Scheduler(format!("{error:?}"));
    let priority = ThreadPriorityValue::try_from(priority).map_err(|error| refused(&error))?;
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(priority), policy)
        .map_err(|error| refused(&error))
}
