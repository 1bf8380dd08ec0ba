//! The real-time scheduler of the kernel, where it was asked for (`--rt`): SCHED_FIFO, memory that stays, one core for each
//! node. What the kernel refuses is said once by the launcher and shown by every node; the nodes run without it.

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

/// The cores that the process had before it took one.
static CORES: OnceLock<CpuSet> = OnceLock::new();

/// Of a hundred: above all ordinary threads, below what the kernel itself runs in real time.
const PRIORITY: u8 = 20;
/// The least of a thread under SCHED_FIFO.
const LAST: u8 = 1;

/// Why there is no real time.
#[derive(Debug, thiserror::Error)]
pub enum RtError {
    /// The memory may not be locked.
    #[error(
        "--rt: the kernel does not let this user lock memory ({0}): raise `memlock` to unlimited in /etc/security/limits.conf, or give the program the right with `setcap cap_ipc_lock,cap_sys_nice+ep`"
    )]
    Memory(Errno),
    /// The scheduler may not be chosen.
    #[error(
        "--rt: the kernel does not let this user choose SCHED_FIFO ({0}): set `rtprio` to 50 in /etc/security/limits.conf, or give the program the right with `setcap cap_ipc_lock,cap_sys_nice+ep`"
    )]
    Scheduler(String),
    /// The core may not be chosen.
    #[error("--rt: the kernel does not let this user choose a core ({0})")]
    Core(Errno),
}

/// From here on this thread, and every thread that it starts, runs under SCHED_FIFO on one core; the memory of the process
/// stays in its place. Nodes take the cores that the process may use in turns, by their `place` in the cell.
pub fn begin(place: usize) -> RealTime {
    let refused = [lock().is_err(), choose(PRIORITY).is_err(), pin(place).is_err()];
    match refused {
        [false, false, false] => RealTime::Had,
        [memory, scheduler, core] => RealTime::Refused { memory, scheduler, core },
    }
}

/// Starts `what` in the likeness of a thread that comes after all tasks and before ordinary programs, on any core that the
/// process may use. Who looks must never come before who works; and no ordinary program may hold it up while it holds the
/// lock of a communication task, which a task would wait for. A task of another node on the same core still may.
pub fn behind<T: Send>(what: impl FnOnce() -> T + Send) -> T {
    // Nobody asked for `--rt`: all threads are ordinary ones.
    let Some(cores) = CORES.get() else { return what() };
    thread::scope(|scope| {
        let likeness = scope.spawn(|| {
            // Without the right to it the tasks are ordinary threads, too, and this stays one.
            let _ = choose(LAST);
            let _ = sched_setaffinity(None, cores);
            what()
        });
        likeness.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

/// The cores that the process had before it took one; none where it never took one.
pub fn cores() -> Vec<usize> {
    let cores = CORES.get().into_iter();
    cores.flat_map(|cores| (0..CpuSet::MAX_CPU).filter(|&core| cores.is_set(core))).collect()
}

/// What [`begin`] would be refused, without doing it.
pub fn refused() -> Vec<RtError> {
    let memory = lock();
    // On a thread that ends right away.
    let tried = thread::spawn(|| [choose(PRIORITY), pin(0)]).join();
    let all = tried.unwrap_or_else(|_| [Err(RtError::Scheduler("no thread".into())), Ok(())]);
    // Nothing was locked where that was refused.
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
