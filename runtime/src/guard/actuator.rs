//! Helps a program that moves a tool to act for only one task of a couple at a time.
//!
//! Two work-coupled tasks never act at the same time. But a process that acts for one of them may be stopped, or
//! suspended, or may outlive its node. So the program that moves the tool makes a check of its own. A *gate* is a
//! file with the newest epoch; all processes that move the tool share it. A process shows its epoch to the gate
//! before it acts. From then on the gate refuses older epochs, even in the middle of their work.
//! What a command learns from the runtime that started it:
//!
//! | what | where |
//! |---|---|
//! | the epoch of its task's lease, a whole number from 0 to 255 | `IMRS_EPOCH`; absent where the task is in no couple |
//! | until when it may act, in microseconds of `CLOCK_BOOTTIME` | `IMRS_DEADLINE_US`, always set by the runtime; the largest `u64` where no instant ends it |
//! | a later deadline | a line `deadline N` on standard input |
//! | that it must stop | standard input ends |
//!
//! ```
//! use imrs_runtime::actuator::{Deadline, Gate, Refused};
//! # let folder = tempfile::tempdir()?;
//! # let path = folder.path().join("welder.gate");
//! // Once, when the program starts. All programs that move this tool name the same file.
//! let gate = Gate::open(&path)?;
//!
//! // The primary acts under epoch 1, step by step, each of them well within the time by which it may be late.
//! let mut primary = gate.admit(1, Deadline::none())?;
//! let mut steps = 0;
//! primary.act(|| steps += 1)?;
//!
//! // The standby has taken over, in a process of its own as a rule: from here on the primary is refused.
//! let standby = gate.admit(2, Deadline::none())?;
//! assert!(standby.may_act() && !primary.may_act());
//! assert!(matches!(primary.act(|| steps += 1), Err(Refused::Epoch { shown: 1, newest: 2 })));
//! assert_eq!(steps, 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! This module is no safety function: it keeps programs that obey it from acting for two tasks, and stops no motor.

use crate::clock;
use imrs_wire::files;
use rustix::fs::{FlockOperation, flock};
use std::fs::{File, OpenOptions};
use std::io::{self, BufRead};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use thiserror::Error;

/// The environment variable that holds the epoch of a command's lease.
pub const EPOCH: &str = "IMRS_EPOCH";
/// The environment variable that holds the deadline of a command. The runtime sets it for every command.
pub const DEADLINE: &str = "IMRS_DEADLINE_US";

/// The beginning of a gate's file. The newest epoch follows, in three digits.
const HEAD: &str = "imrs gate 1 epoch ";
const BYTES: usize = HEAD.len() + 4;

/// Why a gate cannot be used.
#[derive(Debug, Error)]
pub enum GateError {
    /// The file cannot be opened, locked, read or written.
    #[error("cannot use the gate {path}: {source}")]
    File {
        /// The file on which the operation failed.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file exists, but is no gate's file.
    #[error("{0} is no file of a gate: name another file, or remove this one")]
    Foreign(PathBuf),
}

/// Why a program may not act.
#[derive(Debug, Error)]
pub enum Refused {
    /// The program's epoch is over: another program has acted under a newer one.
    #[error("epoch {shown} is over: epoch {newest} acts")]
    Epoch {
        /// The epoch of this program.
        shown: u8,
        /// The newest epoch in the gate.
        newest: u8,
    },
    /// The deadline has passed, or the runtime said that the program must stop.
    #[error("the deadline has passed")]
    Deadline,
    /// The gate cannot be read, so it counts as closed.
    #[error(transparent)]
    Gate(#[from] GateError),
}

/// The current instant on the clock of deadlines: microseconds of `CLOCK_BOOTTIME`.
#[must_use]
pub fn now() -> u64 {
    clock::now()
}

/// The file that holds the newest epoch of a tool, shared by all programs that act with the tool.
///
/// A second file beside it, `PATH.next`, is a queue: a program that waits for an admission locks this file, and later
/// steps wait until it is free. So a program whose steps follow each other closely cannot keep a newer epoch out.
///
/// The file survives a restart of the machine. When the whole cell restarts, its epochs begin anew. So
/// [`reset`](Self::reset) the gate before that, or keep the file where a restart of the machine removes it (`/run`).
#[derive(Clone, Debug)]
pub struct Gate {
    path: PathBuf,
}

impl Gate {
    /// Opens the gate of this file, which is created if it is missing.
    ///
    /// # Errors
    /// [`GateError`] if the file cannot be used, or belongs to something else.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, GateError> {
        let gate = Self { path: path.as_ref().to_owned() };
        // This read finds a foreign file when the gate is opened, not only when the tool must move.
        gate.locked(FlockOperation::LockShared)?.newest()?;
        Ok(gate)
    }

    /// Admits a program that acts under this epoch until `deadline`; from then on no program may act under an older epoch.
    /// Waits for the end of a step that another program is [in the middle of](Permit::act).
    ///
    /// Epochs wrap around at 256: the newer of two is less than 128 ahead. Returns once the new epoch is on the disk.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn admit(&self, epoch: u8, deadline: Deadline) -> Result<Permit, Refused> {
        let held = self.exclusive()?;
        if !deadline.is_ahead() {
            return Err(Refused::Deadline);
        }
        match held.newest()? {
            Some(newest) if newest == epoch => {}
            Some(newest) if is_newer(newest, epoch) => return Err(Refused::Epoch { shown: epoch, newest }),
            Some(_) => held.write(Some(epoch))?,
            None => {
                // The file may be new, and a power cut must not lose its name.
                self.sync_folder()?;
                held.write(Some(epoch))?;
            }
        }
        // A lock belongs to an open file. Dropping `held` releases its lock, so the permit opens the file again for itself.
        drop(held);
        let (file, next) = (self.file()?, self.next()?);
        Ok(Permit { file, next, path: self.path.clone(), epoch, deadline })
    }

    /// Forgets all epochs: no program that was admitted before may act. Call it at the start of a whole cell.
    ///
    /// # Errors
    /// [`GateError`] if the file cannot be used.
    pub fn reset(&self) -> Result<(), GateError> {
        self.exclusive()?.write(None)
    }

    fn file(&self) -> Result<File, GateError> {
        open(&self.path)
    }

    fn next_path(&self) -> PathBuf {
        let mut name = self.path.clone().into_os_string();
        name.push(".next");
        name.into()
    }

    fn next(&self) -> Result<File, GateError> {
        open(&self.next_path())
    }

    /// Takes the exclusive lock on the gate's file. `flock` does not prefer writers, so programs that begin a step
    /// during this wait must queue at `PATH.next`.
    fn exclusive(&self) -> Result<Held<'_>, GateError> {
        let path = self.next_path();
        let _queue = Held::new(open(&path)?, &path, FlockOperation::LockExclusive)?;
        self.locked(FlockOperation::LockExclusive)
    }

    fn sync_folder(&self) -> Result<(), GateError> {
        let synced = File::open(files::folder_of(&self.path)).and_then(|folder| folder.sync_all());
        synced.map_err(|source| GateError::File { path: self.path.clone(), source })
    }

    fn locked(&self, how: FlockOperation) -> Result<Held<'_>, GateError> {
        Held::new(self.file()?, &self.path, how)
    }
}

fn open(path: &Path) -> Result<File, GateError> {
    let mut options = OpenOptions::new();
    let file = options.read(true).write(true).create(true).truncate(false).open(path);
    file.map_err(|source| GateError::File { path: path.to_owned(), source })
}

/// Whether epoch `one` is newer than epoch `other`; epochs wrap around.
const fn is_newer(one: u8, other: u8) -> bool {
    let steps = one.wrapping_sub(other);
    steps != 0 && steps < 128
}

/// A gate's file, which stays locked until this value is dropped.
struct Held<'a> {
    file: File,
    path: &'a Path,
}

impl<'a> Held<'a> {
    fn new(file: File, path: &'a Path, how: FlockOperation) -> Result<Self, GateError> {
        lock(&file, path, how)?;
        Ok(Self { file, path })
    }

    fn newest(&self) -> Result<Option<u8>, GateError> {
        newest(&self.file, self.path)
    }

    /// Writes the epoch in one write, which is on the disk on return. After a power cut the file has the old content or the
    /// new one.
    fn write(&self, epoch: Option<u8>) -> Result<(), GateError> {
        let write = || match epoch {
            Some(epoch) => self.file.write_all_at(format!("{HEAD}{epoch:03}\n").as_bytes(), 0),
            None => self.file.set_len(0),
        };
        let written = write().and_then(|()| self.file.sync_data());
        written.map_err(|source| GateError::File { path: self.path.to_owned(), source })
    }
}

fn lock(file: &File, path: &Path, how: FlockOperation) -> Result<(), GateError> {
    loop {
        match flock(file, how) {
            Ok(()) => return Ok(()),
            Err(rustix::io::Errno::INTR) => {}
            Err(errno) => return Err(GateError::File { path: path.to_owned(), source: errno.into() }),
        }
    }
}

/// The newest epoch in a file; `None` if no program was admitted yet.
fn newest(file: &File, path: &Path) -> Result<Option<u8>, GateError> {
    // The buffer has one byte more than the file may have, so that a file that is too long is noticed.
    let mut bytes = [0; BYTES + 1];
    let mut length = 0;
    loop {
        match file.read_at(&mut bytes[length..], length as u64) {
            Ok(0) => break,
            Ok(more) => length += more,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(source) => return Err(GateError::File { path: path.to_owned(), source }),
        }
    }
    if length == 0 {
        return Ok(None);
    }
    let text = std::str::from_utf8(&bytes[..length]).ok();
    let epoch = text.and_then(|text| text.strip_prefix(HEAD)?.strip_suffix('\n')?.parse().ok());
    epoch.map(Some).filter(|_| length == BYTES).ok_or_else(|| GateError::Foreign(path.to_owned()))
}

/// The permission of an admitted program to act. Each thread that acts needs its own.
#[derive(Debug)]
pub struct Permit {
    file: File,
    /// The file `PATH.next`, which a program that waits for an admission locks first.
    next: File,
    path: PathBuf,
    epoch: u8,
    deadline: Deadline,
}

impl Permit {
    /// Whether the program may act now: its deadline is ahead, and no program was admitted under a newer epoch. Each call
    /// checks both, which takes about a microsecond. If the gate cannot be read, the answer is false.
    ///
    /// An action after this check may come too late, because a program that is stopped between the two does not notice.
    /// [`act`](Self::act) keeps newer epochs waiting until the action has ended.
    #[must_use]
    pub fn may_act(&self) -> bool {
        self.check().is_ok()
    }

    /// Runs `step`, one step of the work, if the program may act. No newer epoch is admitted before the step has ended, so
    /// steps of two epochs never overlap, wherever a program is stopped. Keep the step short: the next program to act waits
    /// for it, forever if this program is stopped in the step and not killed.
    ///
    /// # Errors
    /// [`Refused`]: nothing was done.
    pub fn act<R>(&mut self, step: impl FnOnce() -> R) -> Result<R, Refused> {
        // If a program waits for an admission, it holds `next`, so this step waits until that program is admitted.
        lock(&self.next, &self.path, FlockOperation::LockShared)?;
        lock(&self.next, &self.path, FlockOperation::Unlock)?;
        lock(&self.file, &self.path, FlockOperation::LockShared)?;
        let done = self.check().map(|()| step());
        lock(&self.file, &self.path, FlockOperation::Unlock)?;
        done
    }

    fn check(&self) -> Result<(), Refused> {
        if !self.deadline.is_ahead() {
            return Err(Refused::Deadline);
        }
        match newest(&self.file, &self.path)? {
            Some(newest) if newest == self.epoch => Ok(()),
            Some(newest) => Err(Refused::Epoch { shown: self.epoch, newest }),
            // The gate was reset after this program was admitted, because the cell starts anew.
            None => Err(Refused::Deadline),
        }
    }

    /// The epoch for which the permit was given.
    #[must_use]
    pub const fn epoch(&self) -> u8 {
        self.epoch
    }
}

/// The instant until which a program may act. Clones share one deadline: renewing or stopping one clone does so for all.
#[derive(Clone, Debug)]
pub struct Deadline(Arc<AtomicU64>);

/// The value of the deadline of a program that must stop.
const STOPPED: u64 = 0;

impl Deadline {
    /// A deadline at this instant, in microseconds of `CLOCK_BOOTTIME`.
    #[must_use]
    pub fn at(micros: u64) -> Self {
        Self(Arc::new(AtomicU64::new(micros)))
    }

    /// A deadline that only [`stop`](Self::stop) ends.
    #[must_use]
    pub fn none() -> Self {
        Self::at(u64::MAX)
    }

    /// Moves the deadline to a later instant. An earlier instant changes nothing. After a [`stop`](Self::stop),
    /// nothing changes it.
    pub fn renew(&self, micros: u64) {
        let later = |now: u64| (now != STOPPED && micros > now).then_some(micros);
        // The update fails if it would change nothing, and that is no error.
        let _ = self.0.fetch_update(Ordering::AcqRel, Ordering::Acquire, later);
    }

    /// Puts the deadline into the past, for good.
    pub fn stop(&self) {
        self.0.store(STOPPED, Ordering::Release);
    }

    /// Whether the deadline is still to come. Reads the clock.
    #[must_use]
    pub fn is_ahead(&self) -> bool {
        now() < self.0.load(Ordering::Acquire)
    }

    /// Follows the lines that the runtime writes until they end, and then [stops](Self::stop) the deadline. Call it in
    /// a thread of its own, with the standard input. Unknown lines are skipped.
    pub fn follow(&self, input: impl BufRead) {
        // A failed read counts as the end of the input.
        for line in input.lines().map_while(Result::ok) {
            let micros = line.strip_prefix("deadline ").and_then(|micros| micros.trim().parse().ok());
            micros.into_iter().for_each(|micros| self.renew(micros));
        }
        self.stop();
    }
}

/// The values that the runtime passes to a command in environment variables.
#[derive(Clone, Debug)]
pub struct Orders {
    /// The epoch of the lease of the command's task; `None` if the task has no partner with which it shares a lease.
    pub epoch: Option<u8>,
    /// Until when the command may act; [`Deadline::none`] if no runtime started the program.
    pub deadline: Deadline,
}

/// An environment variable has a value that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{name} is `{value}`, not a whole number: is this command started by the runtime?")]
pub struct OrdersError {
    /// The name of the variable.
    pub name: &'static str,
    /// The value of the variable.
    pub value: String,
}

impl Orders {
    /// Reads the orders from the environment.
    pub fn from_env() -> Result<Self, OrdersError> {
        Ok(Self {
            epoch: number(EPOCH)?,
            deadline: number(DEADLINE)?.map_or_else(Deadline::none, Deadline::at),
        })
    }
}

fn number<N: std::str::FromStr>(name: &'static str) -> Result<Option<N>, OrdersError> {
    let Some(value) = std::env::var_os(name) else { return Ok(None) };
    let value = value.to_string_lossy().into_owned();
    value.parse().map(Some).map_err(|_| OrdersError { name, value })
}
