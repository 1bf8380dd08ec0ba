//! A running guard (the process that ends a command with its node), from the point of view of the node.

use super::kin::parent_of;
use super::words::{Lines, Outcome, lease, read_began};
use crate::clock;
use crate::lock::lock;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;
use rustix::process::{Pid, PidfdFlags, Signal, kill_process_group, pidfd_open, pidfd_send_signal};
use std::io::{self, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A running guard: the process that ends a command with its node.
pub struct Running {
    state: Mutex<State>,
    over: Condvar,
}

struct State {
    /// The process of the guard, and its output; `None` once a thread follows the guard.
    guard: Option<(Child, ChildStdout)>,
    /// The guard's standard input. The command may run as long as this pipe is open.
    orders: Option<ChildStdin>,
    /// The end of the lease that the guard was told last.
    until: u64,
    is_over: bool,
}

impl Running {
    /// Wraps a guard whose standard input and output are pipes.
    pub fn new(mut guard: Child) -> io::Result<Self> {
        let pipes = guard.stdin.take().zip(guard.stdout.take());
        let (orders, words) = pipes.ok_or(io::ErrorKind::BrokenPipe)?;
        // A guard that does not read must not block its node.
        never_wait(&orders)?;
        let state = State { guard: Some((guard, words)), orders: Some(orders), until: 0, is_over: false };
        Ok(Self { state: Mutex::new(state), over: Condvar::new() })
    }

    /// Follows the guard until it has ended. Returns how its command ended; `None` if the guard did not report it.
    /// Calls `renew` repeatedly; `renew` returns after how many microseconds to call it again.
    pub fn follow(&self, renew: impl Fn() -> Option<u64>) -> Option<Outcome> {
        let (mut guard, mut words) = self.lock().guard.take()?;
        let (mut lines, mut group, mut outcome) = (Lines::default(), None, None);
        while listen(&mut words, &mut lines, &renew) {
            while let Some(line) = lines.next() {
                group = read_began(&line).and_then(|pid| Group::of(pid, &guard)).or(group);
                outcome = Outcome::read(&line).or(outcome);
            }
        }
        // The guard has written its last line, or was killed.
        let _ = guard.wait();
        if outcome.is_none()
            && let Some(group) = group
        {
            // The command died with its guard. The processes that the command started are in its process group, or
            // cannot be reached.
            group.kill();
        }
        outcome
    }

    /// Tells the guard a later end of the lease. An earlier end changes nothing.
    pub fn renew(&self, until: u64) {
        let mut state = self.lock();
        if until <= state.until {
            return;
        }
        // If the guard does not read this line, the command ends at the end of the lease that the guard knows.
        let told =
            state.orders.as_mut().is_some_and(|orders| orders.write_all(lease(until).as_bytes()).is_ok());
        if told {
            state.until = until;
        }
    }

    /// Tells the guard to end the command.
    pub fn let_go(&self) {
        self.lock().orders = None;
    }

    /// Waits until the command and everything that it started have ended, at most for `patience`. Returns whether they
    /// have ended.
    pub fn wait(&self, patience: Duration) -> bool {
        let waited = self.over.wait_timeout_while(self.lock(), patience, |state| !state.is_over);
        waited.unwrap_or_else(PoisonError::into_inner).0.is_over
    }

    /// Notes that the command has ended.
    pub fn set_over(&self) {
        self.lock().is_over = true;
        self.over.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

/// The process group of a command. The group's number is the process id of the command.
struct Group {
    number: Pid,
    /// A handle on the command; `None` if the guard died before it was certain that the group's number still belonged
    /// to the command.
    command: Option<OwnedFd>,
}

impl Group {
    fn of(pid: i32, guard: &Child) -> Option<Self> {
        let number = Pid::from_raw(pid)?;
        let command = pidfd_open(number, PidfdFlags::empty()).ok();
        // The guard's child with this number is the command, as long as the guard has not reaped it.
        let guard = Pid::from_child(guard).as_raw_nonzero().get();
        Some(Self { number, command: command.filter(|_| parent_of(pid) == Some(guard)) })
    }

    /// Kills the command's whole process group, unless the group's number belongs to another process by now.
    fn kill(&self) {
        // A command that is not reaped keeps its process id, and so does each member of its group. So if another
        // process has the id, the group is empty.
        let is_reaped = self
            .command
            .as_ref()
            .is_none_or(|command| matches!(pidfd_send_signal(command, Signal::KILL), Err(Errno::SRCH)));
        if is_reaped && Path::new("/proc").join(self.number.as_raw_nonzero().to_string()).exists() {
            return;
        }
        let _ = kill_process_group(self.number, Signal::KILL);
    }
}

/// Waits for a line of the guard; returns `false` once the guard will write no more.
fn listen(words: &mut ChildStdout, lines: &mut Lines, renew: impl Fn() -> Option<u64>) -> bool {
    let after = renew().and_then(|after| after.checked_mul(1_000)).map(clock::timespec);
    match poll(&mut [PollFd::new(words, PollFlags::IN)], after.as_ref()) {
        Ok(0) | Err(Errno::INTR) => return true,
        Ok(_) => {}
        Err(_) => return false,
    }
    let mut bytes = [0; 256];
    match rustix::io::read(words, &mut bytes) {
        Ok(0) => false,
        Ok(read) => {
            lines.add(&bytes[..read]);
            true
        }
        Err(Errno::INTR) => true,
        Err(_) => false,
    }
}

/// Makes writes and reads of this pipe fail in place of blocking.
pub fn never_wait(pipe: impl AsFd) -> io::Result<()> {
    let flags = fcntl_getfl(&pipe)?;
    Ok(fcntl_setfl(&pipe, flags | OFlags::NONBLOCK)?)
}
