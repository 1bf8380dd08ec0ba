//! A guard as its node sees it.

use super::words::{Lines, Outcome, lease, read_began};
use crate::clock;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;
use rustix::process::{Pid, Signal, kill_process_group};
use std::io::{self, Write};
use std::os::fd::AsFd;
use std::process::{Child, ChildStdin, ChildStdout};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A guard that runs.
pub struct Running {
    state: Mutex<State>,
    over: Condvar,
}

struct State {
    /// Here until somebody follows it.
    guard: Option<(Child, ChildStdout)>,
    /// The command may run as long as this is open.
    orders: Option<ChildStdin>,
    /// The end of the lease that the guard knows.
    until: u64,
    is_over: bool,
}

impl Running {
    /// Of a guard whose standard input and output are pipes.
    pub fn new(mut guard: Child) -> io::Result<Self> {
        let pipes = guard.stdin.take().zip(guard.stdout.take());
        let (orders, words) = pipes.ok_or(io::ErrorKind::BrokenPipe)?;
        // A guard that stands still must not hold up its node.
        never_wait(&orders)?;
        let state = State { guard: Some((guard, words)), orders: Some(orders), until: 0, is_over: false };
        Ok(Self { state: Mutex::new(state), over: Condvar::new() })
    }

    /// Listens to the guard until it has ended. Returns how its command ended; `None` where the guard did not say. `renew` is called now and
    /// then, and says after how many microseconds again.
    pub fn follow(&self, renew: impl Fn() -> Option<u64>) -> Option<Outcome> {
        let (mut guard, mut words) = self.lock().guard.take()?;
        let (mut lines, mut group, mut outcome) = (Lines::default(), None, None);
        while listen(&mut words, &mut lines, &renew) {
            while let Some(line) = lines.next() {
                group = read_began(&line).or(group);
                outcome = Outcome::read(&line).or(outcome);
            }
        }
        // It has said its last word, or was killed.
        let _ = guard.wait();
        if outcome.is_none()
            && let Some(group) = group.and_then(Pid::from_raw)
        {
            // The command died with its guard. What it started is in its group, or out of reach.
            let _ = kill_process_group(group, Signal::KILL);
        }
        outcome
    }

    /// The lease ends then, and no sooner.
    pub fn renew(&self, until: u64) {
        let mut state = self.lock();
        if until <= state.until {
            return;
        }
        // If the guard does not listen, the command ends at the end of the lease that the guard knows.
        let told =
            state.orders.as_mut().is_some_and(|orders| orders.write_all(lease(until).as_bytes()).is_ok());
        if told {
            state.until = until;
        }
    }

    /// The command must end.
    pub fn let_go(&self) {
        self.lock().orders = None;
    }

    /// Ends the command, and waits until it has ended with all that it started, at most so long.
    pub fn stop(&self, patience: Duration) {
        let mut state = self.lock();
        state.orders = None;
        let waited = self.over.wait_timeout_while(state, patience, |state| !state.is_over);
        drop(waited);
    }

    /// The command has ended.
    pub fn is_over(&self) {
        self.lock().is_over = true;
        self.over.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Waits for a word of the guard; `false` once it says no more.
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

/// Writes and reads of this pipe give up in place of waiting.
pub fn never_wait(pipe: impl AsFd) -> io::Result<()> {
    let flags = fcntl_getfl(&pipe)?;
    Ok(fcntl_setfl(&pipe, flags | OFlags::NONBLOCK)?)
}
