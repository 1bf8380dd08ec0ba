//! The work of the guard: one thread waits for the end of its node, of the lease, of the action's time, or of the command.

use super::exec::UNSTARTED;
use super::notices::{Notice, Notices};
use super::running::never_wait;
use super::words::{self, Errand, Lines, Outcome, read_lease};
use super::{EXEC, OWN_FILE, kin, stage};
use crate::{actuator, clock};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use rustix::process::{Pid, PidfdFlags, WaitStatus, getpid, pidfd_open, set_child_subreaper};
use rustix::time::{
    Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec, timerfd_create, timerfd_settime,
};
use std::io::{self, Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, ExitCode, Stdio};

/// The answer of a command is the first line of its output; this many bytes of that line count.
const LONGEST_ANSWER: usize = 64;
/// How many bytes are read at most from the output of a command that has ended. No pipe holds more.
const LONGEST_REST: usize = 1 << 20;
const PIECE: usize = 1 << 14;

/// Guards a command until it and everything that it started have ended, and reports how it ended.
pub fn watch(errand: &Errand) -> ExitCode {
    // If the launcher has ended, no notice is needed.
    let notices = errand.notices.as_ref().and_then(|(path, key)| Some((Notices::open(path).ok()?, key)));
    let outcome = match over_before(errand) {
        Some(outcome) => outcome,
        None => Watch::start(errand).map_or_else(
            |error| Outcome::Unstarted(error.raw_os_error().unwrap_or_default()),
            |mut watch| {
                let why = watch.wait();
                watch.end(why)
            },
        ),
    };
    if let Some((notices, key)) = &notices {
        notices.tell_at_last(&Notice::ended(key));
    }
    say(&outcome.line());
    ExitCode::SUCCESS
}

/// The outcome of an action that was over before it could begin, because the guard started late; `None` if it may begin.
fn over_before(errand: &Errand) -> Option<Outcome> {
    let stdin = io::stdin();
    let mut orders = [PollFd::new(&stdin, PollFlags::IN)];
    let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
    let _ = poll(&mut orders, Some(&at_once));
    // A closed pipe means that the node stopped the action or is gone, even if unread lines are still in the pipe.
    if orders[0].revents().contains(PollFlags::HUP) {
        return Some(Outcome::Stopped);
    }
    why_over(errand.limit, errand.lease).map(Why::outcome)
}

/// Which of the two times has passed, the action's limit or the lease; `None` if neither has.
fn why_over(limit: u64, lease: Option<u64>) -> Option<Why> {
    let now = clock::now();
    if limit <= now { Some(Why::Late) } else { lease.filter(|lease| *lease <= now).map(|_| Why::LeaseEnded) }
}

/// Writes a line to the node. If that fails, the node is gone and needs no line.
fn say(line: &str) {
    let mut out = io::stdout().lock();
    let _ = out.write_all(line.as_bytes()).and_then(|()| out.flush());
}

/// The reason for which a command must end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Why {
    Ended,
    Stopped,
    Late,
    LeaseEnded,
}

impl Why {
    const fn outcome(self) -> Outcome {
        match self {
            Self::Late => Outcome::Late,
            Self::LeaseEnded => Outcome::LeaseEnded,
            // If the command ended by itself, `Answer::outcome` decides.
            Self::Stopped | Self::Ended => Outcome::Stopped,
        }
    }
}

struct Watch {
    /// What the node has told this guard to do. Renewals of the lease change it.
    errand: Errand,
    orders: Lines,
    pid: Pid,
    /// A file descriptor that is readable once the command has ended.
    ended: OwnedFd,
    /// A file descriptor that is readable once the deadline has passed, however long the machine was suspended.
    timer: OwnedFd,
    /// The deadline for which the timer is set. `told` is the deadline that the command knows.
    armed: Option<u64>,
    told: Option<u64>,
    input: Option<ChildStdin>,
    output: Answer,
}

/// The output of a command. Its first line is kept; the other lines are dropped.
struct Answer {
    pipe: ChildStdout,
    is_open: bool,
    kept: Vec<u8>,
    is_whole: bool,
}

impl Watch {
    fn start(errand: &Errand) -> io::Result<Self> {
        let own = getpid();
        set_child_subreaper(Some(own))?;
        let timer = timerfd_create(TimerfdClockId::Boottime, TimerfdFlags::CLOEXEC | TimerfdFlags::NONBLOCK)?;
        let second = Errand { parent: Some(own.as_raw_nonzero().get()), ..errand.clone() };
        let mut command = stage(Path::new(OWN_FILE), EXEC, &second);
        command.env(actuator::DEADLINE, errand.deadline().to_string());
        match errand.epoch {
            Some(epoch) => command.env(actuator::EPOCH, epoch.to_string()),
            None => command.env_remove(actuator::EPOCH),
        };
        let mut child = command.process_group(0).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let pid = Pid::from_child(&child);
        match Self::of(errand, &mut child, timer) {
            Ok(watch) => {
                say(&words::began(pid.as_raw_nonzero().get()));
                Ok(watch)
            }
            Err(error) => {
                kin::end_all(pid);
                Err(error)
            }
        }
    }

    fn of(errand: &Errand, child: &mut Child, timer: OwnedFd) -> io::Result<Self> {
        let pid = Pid::from_child(child);
        let (input, pipe) = (child.stdin.take(), child.stdout.take());
        let pipe = pipe.ok_or(io::ErrorKind::BrokenPipe)?;
        if let Some(input) = &input {
            // A command that does not read its input must not block its guard.
            never_wait(input)?;
        }
        let mut watch = Self {
            errand: errand.clone(),
            orders: Lines::default(),
            pid,
            ended: pidfd_open(pid, PidfdFlags::empty())?,
            timer,
            armed: None,
            told: None,
            input,
            output: Answer { pipe, is_open: true, kept: Vec::new(), is_whole: false },
        };
        watch.note_deadline()?;
        Ok(watch)
    }

    /// Waits until the command is over, for whatever reason.
    fn wait(&mut self) -> Why {
        loop {
            // If poll fails, the guard cannot watch anything any more, so it stops the command.
            let Ok([orders, ended, timer, output]) = self.poll() else { return Why::Stopped };
            // Lines of the node are read first, because a renewal that has arrived counts.
            if orders && !self.hear() {
                return Why::Stopped;
            }
            if output {
                self.output.read();
            }
            if ended {
                return Why::Ended;
            }
            if let Some(why) = why_over(self.errand.limit, self.errand.lease) {
                return why;
            }
            if timer {
                // The timer expired, but the deadline was renewed. Arming the timer again also clears the expiry, so that
                // poll sleeps.
                self.armed = None;
            }
            if self.note_deadline().is_err() {
                return Why::Stopped;
            }
        }
    }

    /// Sleeps until something happens. Returns four flags: the node has written a line, the command has ended, the
    /// timer has expired, the command has written something.
    fn poll(&self) -> io::Result<[bool; 4]> {
        let stdin = io::stdin();
        let mut fds = vec![
            PollFd::new(&stdin, PollFlags::IN),
            PollFd::new(&self.ended, PollFlags::IN),
            PollFd::new(&self.timer, PollFlags::IN),
        ];
        if self.output.is_open {
            fds.push(PollFd::new(&self.output.pipe, PollFlags::IN));
        }
        clock::sleeps();
        match poll(&mut fds, None) {
            Ok(_) => {}
            Err(Errno::INTR) => return Ok([false; 4]),
            Err(error) => return Err(error.into()),
        }
        let is_ready = |at: usize| fds.get(at).is_some_and(|fd| !fd.revents().is_empty());
        Ok([is_ready(0), is_ready(1), is_ready(2), is_ready(3)])
    }

    /// Reads the lines of the node. Returns false if the node writes no more.
    fn hear(&mut self) -> bool {
        let mut bytes = [0; 1024];
        match rustix::io::read(io::stdin(), &mut bytes) {
            Ok(0) => return false,
            Ok(read) => self.orders.add(&bytes[..read]),
            Err(Errno::INTR | Errno::AGAIN) => {}
            Err(_) => return false,
        }
        while let Some(line) = self.orders.next() {
            // `max` puts a lease above `None`: a task that acted alone has a lease again once its partner has come back.
            self.errand.lease = read_lease(&line).max(self.errand.lease);
        }
        true
    }

    /// Sets the timer to the deadline, and tells it to the command.
    fn note_deadline(&mut self) -> io::Result<()> {
        let deadline = self.errand.deadline();
        if self.armed != Some(deadline) {
            let zero = Timespec { tv_sec: 0, tv_nsec: 0 };
            let it_value = clock::boottime(deadline).unwrap_or(zero);
            let spec = Itimerspec { it_interval: zero, it_value };
            timerfd_settime(&self.timer, TimerfdTimerFlags::ABSTIME, &spec)?;
            self.armed = Some(deadline);
        }
        if self.told != Some(deadline)
            && let Some(input) = &mut self.input
        {
            match input.write_all(format!("deadline {deadline}\n").as_bytes()) {
                Ok(()) => self.told = Some(deadline),
                // The command does not read its input, and the pipe is full. The next renewal sends the
                // deadline again.
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(_) => self.input = None,
            }
        }
        Ok(())
    }

    /// Kills everything that remains of the command.
    fn end(mut self, why: Why) -> Outcome {
        let status = kin::end_all(self.pid);
        // All processes that could write to the pipe have ended, so this reading ends, too.
        self.output.read_rest();
        if why == Why::Ended { self.output.outcome(status, self.errand.real) } else { why.outcome() }
    }
}

impl Answer {
    /// Reads once from the command's output. Returns how many bytes it read.
    fn read(&mut self) -> usize {
        let mut bytes = [0; PIECE];
        match self.pipe.read(&mut bytes) {
            Ok(0) => self.is_open = false,
            Ok(read) => {
                self.keep(&bytes[..read]);
                return read;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(_) => self.is_open = false,
        }
        0
    }

    fn keep(&mut self, bytes: &[u8]) {
        if self.is_whole {
            return;
        }
        let end = bytes.iter().position(|&byte| byte == b'\n');
        let line = &bytes[..end.unwrap_or(bytes.len())];
        let room = LONGEST_ANSWER - self.kept.len();
        self.kept.extend_from_slice(&line[..line.len().min(room)]);
        self.is_whole = end.is_some() || self.kept.len() == LONGEST_ANSWER;
    }

    fn read_rest(&mut self) {
        // Another process may still hold the pipe, so this reads only the bytes that are there now.
        if never_wait(&self.pipe).is_err() {
            return;
        }
        let mut rest = 0;
        while self.is_open && rest < LONGEST_REST {
            rest += self.read();
        }
    }

    fn outcome(&self, status: Option<WaitStatus>, real: bool) -> Outcome {
        if let Some(errno) = self.kept.strip_prefix(UNSTARTED) {
            let errno = String::from_utf8_lossy(errno);
            return Outcome::Unstarted(errno.trim().parse().unwrap_or_default());
        }
        if status.and_then(WaitStatus::exit_status) != Some(0) {
            return Outcome::Failed;
        }
        let line = String::from_utf8_lossy(&self.kept);
        Outcome::Done(result(line.trim(), real))
    }
}

/// The number that a command printed; a real is given by its bits. Any other text counts as zero.
fn result(printed: &str, real: bool) -> i32 {
    if !real {
        return printed.parse().unwrap_or(0);
    }
    let number = printed.parse::<f32>().ok().filter(|number| number.is_finite());
    // The scripts have only one zero.
    number.map_or(0, |number| if number == 0.0 { 0 } else { number.to_bits().cast_signed() })
}

#[cfg(test)]
mod tests {
    use super::result;

    #[test]
    fn a_real_is_read_as_its_bits_and_what_is_no_number_as_zero() {
        assert_eq!(
            [result("3", false), result("-4", false), result("2.5", false), result("", false)],
            [3, -4, 0, 0]
        );
        let real = |printed: &str| f32::from_bits(result(printed, true).cast_unsigned());
        assert_eq!(
            [real("3"), real("-2.5"), real("-0.0"), real("inf"), real("x")],
            [3.0, -2.5, 0.0, 0.0, 0.0]
        );
        assert_eq!(result("-0.0", true), 0);
    }
}
