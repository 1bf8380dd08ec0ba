//! Actions that are commands to execute, each under a guard ([`crate::guard`], D141).

use super::actions::{Act, Actions, Ending, HeldLease, Stop};
use crate::clock;
use crate::guard::{Errand, GuardProgram, Notice, Notices, Outcome, Running};
use crate::lock::lock;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::io;
use std::os::unix::process::CommandExt;
use std::process::Stdio;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};

/// How much longer than declared a command may take before it is killed, by default: programs start slowly on a busy machine.
const MARGIN: Duration = Duration::from_secs(2);
/// How long a stop waits for the guard to confirm the end of the command, and how long the next action of the task
/// waits for it.
const STOP_WITHIN: Duration = Duration::from_millis(250);
/// The least and the greatest time after which a lease is checked again, in microseconds. Between these limits, the
/// next check comes after a quarter of the lease's remaining time.
const RENEW_EVERY: [u64; 2] = [2_000, 100_000];
/// The time between two checks of the lease, in microseconds, while a task acts without its partner. When the partner
/// comes back, the task's lease counts again, so it is checked.
const ALONE_EVERY: u64 = 10_000;

/// Executes a command for each action that has one. Another [`Actions`] carries out the other actions.
///
/// The program is started with its own arguments, then those of the action, without a shell. Exit code 0 is success.
/// The result of the action is the first line of the program's standard output, if that is a whole number (of at most
/// 64 bytes; further output is dropped). The program runs in a process group of its own under a guard
/// ([`crate::guard`]). The guard kills it, with all processes that it started, when
///
/// - the action is cut short, or the node ends, however it ends;
/// - the lease of the task's couple ends without a renewal;
/// - the action takes longer than declared, by more than the [`margin`](Self::margin) of 2 s: then the action has
///   failed, and this is reported;
/// - the command itself ends: the processes that it left behind end with it.
///
/// The command finds in its environment:
///
/// - `IMRS_DEADLINE_US`: the instant by which the command must have ended, in microseconds of `CLOCK_BOOTTIME`, in decimal;
/// - `IMRS_EPOCH`: the epoch of the lease under which the command acts, in decimal; absent if the task is in no couple.
///
/// The command's standard input has a line `deadline N` at once, and another such line whenever a renewal of the lease
/// moves the deadline. The end of standard input means that the command must stop now.
///
/// ```
/// use imrs_runtime::guard::GuardProgram;
/// use imrs_runtime::script::{Commands, Simulated};
/// use std::collections::BTreeMap;
///
/// let simulated = Simulated::start(1, Vec::new(), Vec::new()).expect("a thread");
/// let grip = BTreeMap::from([("grip".to_owned(), vec!["./grip".to_owned(), "--hard".to_owned()])]);
/// let actions = Commands::new(grip, simulated)
///     .guard(GuardProgram::At("/usr/local/bin/imrs-guard".into()))
///     .tell(|action, error| eprintln!("action {action}: {error}"));
/// # drop(actions);
/// ```
pub struct Commands {
    commands: BTreeMap<String, Vec<String>>,
    others: Arc<dyn Actions>,
    tell: Tell,
    guard: GuardProgram,
    margin: Duration,
    cores: Option<String>,
    /// The actions whose commands print a real.
    reals: BTreeSet<String>,
    notices: Option<(Arc<Notices>, String)>,
    begun: AtomicU64,
    stopping: Arc<Stopping>,
}

/// A callback for a command that went wrong: it gets the action's name and the error.
type Tell = Arc<dyn Fn(&str, &CommandError) + Send + Sync>;

/// How a command went wrong, other than by an exit code, which means that the action failed.
#[derive(Debug, thiserror::Error)]
pub enum CommandError {
    /// The program of the command cannot be executed.
    #[error("cannot execute `{program}`: {why}")]
    Program {
        /// The path of the program.
        program: String,
        /// The error of the operating system.
        why: io::Error,
    },
    /// The guard (a process that ends the command with its node) cannot be started, so the command was not started.
    #[error(
        "cannot start the guard `{program}` of commands: {why}; install `imrs-guard` beside this program"
    )]
    Guard {
        /// The path of the guard's program.
        program: String,
        /// The error of the operating system.
        why: io::Error,
    },
    /// The notice for the launcher could not be written, so the command's program was not started.
    #[error("cannot tell the launcher of the command: {0}")]
    Notices(io::Error),
    /// The command took too long and was killed.
    #[error("took longer than the declared {most:?} and the margin of {margin:?}: killed")]
    Late {
        /// How long the cell lets the action take.
        most: Duration,
        /// How much longer the action was allowed to take.
        margin: Duration,
    },
    /// The lease of the command's task ended, and the command was killed.
    #[error("killed at the end of its lease")]
    LeaseEnded,
    /// The guard (the process that ends the command with its node) was killed.
    #[error("its guard was killed: processes that the command started may still run")]
    Unguarded,
}

impl Commands {
    /// Executes `commands`: for each action's name, the program and the program's first arguments. `others` carries out
    /// all other actions.
    #[must_use]
    pub fn new(commands: BTreeMap<String, Vec<String>>, others: Arc<dyn Actions>) -> Self {
        Self {
            commands,
            others,
            tell: Arc::new(|_, _| {}),
            guard: GuardProgram::default(),
            margin: MARGIN,
            cores: None,
            reals: BTreeSet::new(),
            notices: None,
            begun: AtomicU64::new(0),
            stopping: Arc::default(),
        }
    }

    /// Sets a function that is called if a command goes wrong, with the name of the action and the error. For the
    /// script the action has failed.
    #[must_use]
    pub fn tell(self, tell: impl Fn(&str, &CommandError) + Send + Sync + 'static) -> Self {
        Self { tell: Arc::new(tell), ..self }
    }

    /// Sets which program guards the commands.
    #[must_use]
    pub fn guard(self, guard: GuardProgram) -> Self {
        Self { guard, ..self }
    }

    /// Sets how much longer than declared a command may take [default: 2 s]. A command that takes longer is killed,
    /// and its action has failed.
    #[must_use]
    pub const fn margin(mut self, margin: Duration) -> Self {
        self.margin = margin;
        self
    }

    /// Sets the cores that commands may use, if the node itself may use fewer: a node in real time has only one.
    #[must_use]
    pub fn cores(self, cores: impl IntoIterator<Item = usize>) -> Self {
        let cores: Vec<String> = cores.into_iter().map(|core| core.to_string()).collect();
        Self { cores: (!cores.is_empty()).then(|| cores.join(",")), ..self }
    }

    /// Sets the actions whose commands print a real, such as `2.5`. The commands of other actions print a whole number.
    #[must_use]
    pub fn reals(self, actions: impl IntoIterator<Item = String>) -> Self {
        Self { reals: actions.into_iter().collect(), ..self }
    }

    /// Sets the pipe in which the node reports which commands run. The keys of the commands begin with `of`, which no
    /// other node may use.
    #[must_use]
    pub fn notices(self, pipe: Notices, of: &str) -> Self {
        Self { notices: Some((Arc::new(pipe), of.to_owned())), ..self }
    }

    /// Tells the launcher that a command begins, before the command runs. Returns the command's key.
    fn announce(&self, task: &str) -> io::Result<Option<Announced>> {
        let Some((pipe, of)) = &self.notices else { return Ok(None) };
        let key = format!("{of}-{}", self.begun.fetch_add(1, Ordering::Relaxed));
        pipe.tell(&Notice::Began { key: key.clone(), task: task.to_owned(), at: clock::now() })?;
        Ok(Some(Announced { pipe: Arc::clone(pipe), key }))
    }

    fn errand(&self, act: &Act<'_>, words: &[String], told: Option<&Announced>) -> Errand {
        let first = words.iter().map(OsString::from);
        let arguments = act.arguments.iter().map(|argument| argument.to_string().into());
        let length = clock::micros(act.most.saturating_add(self.margin));
        Errand {
            limit: clock::now().saturating_add(length),
            lease: act.lease.and_then(|lease| lease.until),
            epoch: act.lease.map(|lease| lease.epoch),
            cores: self.cores.clone(),
            real: self.reals.contains(act.name),
            notices: told.map(|told| (told.pipe.path().to_owned(), told.key.clone())),
            parent: None,
            command: first.chain(arguments).collect(),
        }
    }

    /// Starts the guard of a command: a process that runs the command, and ends it with its node.
    fn start(&self, act: &Act<'_>, words: &[String]) -> Result<(Running, Option<Announced>), CommandError> {
        let told = self.announce(act.task).map_err(CommandError::Notices)?;
        let errand = self.errand(act, words, told.as_ref());
        let mut guard = self.guard.command(&errand);
        // The guard gets a process group of its own, because a signal to the node's group must not end the guard, too.
        guard.process_group(0).stdin(Stdio::piped()).stdout(Stdio::piped());
        match guard.spawn().and_then(Running::new) {
            Ok(running) => Ok((running, told)),
            Err(why) => {
                told.iter().for_each(Announced::ended);
                Err(CommandError::Guard { program: self.guard.path().display().to_string(), why })
            }
        }
    }
}

/// A command that was announced to the launcher.
struct Announced {
    pipe: Arc<Notices>,
    key: String,
}

impl Announced {
    fn ended(&self) {
        self.pipe.tell_at_last(&Notice::ended(&self.key));
    }

    fn lost(&self) {
        self.pipe.tell_at_last(&Notice::Lost { key: self.key.clone(), at: clock::now() });
    }
}

impl Actions for Commands {
    fn begin(&self, act: &Act<'_>, ending: Ending) -> Option<Stop> {
        // A stop may have returned before the stopped command ended, and two commands of a task must not move the robot
        // at the same time.
        self.stopping.wait(act.task);
        let words = self.commands.get(act.name).filter(|words| !words.is_empty());
        let Some(words) = words else { return self.others.begin(act, ending) };
        let (running, told) = match self.start(act, words) {
            Ok((running, told)) => (Arc::new(running), told),
            Err(error) => {
                (self.tell)(act.name, &error);
                ending.failed();
                return None;
            }
        };
        let watcher = Watcher {
            running: Arc::clone(&running),
            lease: act.lease,
            told,
            tell: Arc::clone(&self.tell),
            action: act.name.to_owned(),
            program: words[0].clone(),
            times: (act.most, self.margin),
        };
        let watching = thread::Builder::new()
            .name(format!("action {}", act.name))
            // If the thread cannot be started, `ending` is dropped, which reports that the action failed.
            .spawn(move || watcher.watch(ending));
        if watching.is_err() {
            running.let_go();
        }
        let (stopping, task) = (Arc::clone(&self.stopping), act.task.to_owned());
        Some(Box::new(move || stopping.stop(task, &running)))
    }
}

/// Commands that were told to stop and may not have ended yet.
#[derive(Default)]
struct Stopping(Mutex<Vec<Stopped>>);

struct Stopped {
    task: String,
    running: Arc<Running>,
    /// The instant until which a thread waits for the command's end.
    until: Instant,
}

impl Stopping {
    /// Tells a command to stop, and waits for its end. The calling thread has other work, and may have to stop many
    /// commands. So commands that do not end at once share one deadline, that of the first.
    fn stop(&self, task: String, running: &Arc<Running>) {
        running.let_go();
        let now = Instant::now();
        let own = now + STOP_WITHIN;
        let shared = {
            let mut all = self.lock();
            all.retain(|other| now < other.until + STOP_WITHIN && !other.running.wait(Duration::ZERO));
            all.push(Stopped { task, running: Arc::clone(running), until: own });
            all.iter().map(|stopped| stopped.until).min().unwrap_or(own)
        };
        running.wait(shared.saturating_duration_since(now));
    }

    /// Waits until the stopped commands of a task have ended, each at most [`STOP_WITHIN`] from its own stop on.
    fn wait(&self, task: &str) {
        // The commands stay in the list during the wait, because another thread may have to wait for them, too.
        let all: Vec<_> = {
            let all = self.lock();
            let own = all.iter().filter(|stopped| stopped.task == task);
            own.map(|stopped| (Arc::clone(&stopped.running), stopped.until)).collect()
        };
        for (running, until) in all {
            running.wait(until.saturating_duration_since(Instant::now()));
        }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Stopped>> {
        lock(&self.0)
    }
}

/// Follows one command to its end.
struct Watcher {
    running: Arc<Running>,
    lease: Option<HeldLease>,
    told: Option<Announced>,
    tell: Tell,
    action: String,
    program: String,
    times: (Duration, Duration),
}

impl Watcher {
    fn watch(self, ending: Ending) {
        let outcome = self.running.follow(|| self.renew(&ending));
        if outcome.is_none() {
            self.told.iter().for_each(Announced::lost);
        }
        self.running.set_over();
        if let Some(error) = self.error(outcome) {
            (self.tell)(&self.action, &error);
        }
        match outcome {
            Some(Outcome::Done(value)) => ending.done(value),
            _ => ending.failed(),
        }
    }

    /// Tells the guard when the lease now ends. Returns after how many microseconds to check the lease again; `None`
    /// if never.
    fn renew(&self, ending: &Ending) -> Option<u64> {
        let begun = self.lease?;
        // If the task holds its lease under another epoch, the action for which this command was begun is over.
        let held = ending.lease().filter(|lease| lease.epoch == begun.epoch)?;
        let Some(until) = held.until else { return Some(ALONE_EVERY) };
        self.running.renew(until);
        let [least, most] = RENEW_EVERY;
        Some((until.saturating_sub(clock::now()) / 4).clamp(least, most))
    }

    fn error(&self, outcome: Option<Outcome>) -> Option<CommandError> {
        match outcome {
            Some(Outcome::Done(_) | Outcome::Failed | Outcome::Stopped) => None,
            Some(Outcome::Late) => {
                let (most, margin) = self.times;
                Some(CommandError::Late { most, margin })
            }
            Some(Outcome::LeaseEnded) => Some(CommandError::LeaseEnded),
            Some(Outcome::Unstarted(errno)) => {
                let why = io::Error::from_raw_os_error(errno);
                Some(CommandError::Program { program: self.program.clone(), why })
            }
            None => Some(CommandError::Unguarded),
        }
    }
}
