//! The real-time scheduler of the kernel, where it was asked for (`--rt`).

use rustix::io::Errno;
use rustix::mm::{MlockAllFlags, mlockall, munlockall};
use std::thread;
use thread_priority::unix::{set_thread_priority_and_policy, thread_native_id};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
};

/// Of a hundred: above all ordinary threads, below what the kernel itself runs in real time.
const PRIORITY: u8 = 20;

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
}

/// From here on this thread, and every thread that it starts, runs under SCHED_FIFO; the memory of the process stays in
/// its place.
///
/// # Errors
/// [`RtError`].
pub fn begin() -> Result<(), RtError> {
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).map_err(RtError::Memory)?;
    choose()
}

/// Whether [`begin`] would do, without doing it.
///
/// # Errors
/// [`RtError`].
pub fn check() -> Result<(), RtError> {
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).map_err(RtError::Memory)?;
    // On a thread that ends right away.
    let chosen = thread::spawn(choose).join();
    munlockall().map_err(RtError::Memory)?;
    chosen.unwrap_or_else(|_| Err(RtError::Scheduler("no thread".into())))
}

fn choose() -> Result<(), RtError> {
    let refused = |error: &dyn std::fmt::Debug| RtError::Scheduler(format!("{error:?}"));
    let priority = ThreadPriorityValue::try_from(PRIORITY).map_err(|error| refused(&error))?;
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(priority), policy)
        .map_err(|error| refused(&error))
}
