//! The program that moves a tool which two work-coupled tasks share. The program acts for one of the two tasks at a
//! time, whatever happens to the nodes that started it (`imrs_runtime::actuator`).
//!
//! `imrs run CELL --action 'weld=target/debug/examples/actuator FOLDER MILLISECONDS'` makes the program act once a
//! millisecond and log each step. `FOLDER` holds the gate of the tool and the log. A further argument is the epoch if
//! the runtime gives none: 1 for the primary, 2 for the standby.

use imrs_runtime::actuator::{Deadline, Gate, Orders, Refused, now};
use std::error::Error;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;
use std::time::Duration;
use std::{env, thread};

/// The time between two steps.
const STEP: Duration = Duration::from_millis(1);

/// The log: each line has an instant, an epoch and an event. A line is one write, so that lines of several processes do not
/// mix.
struct Log(File);

impl Log {
    fn open(path: &Path) -> io::Result<Self> {
        OpenOptions::new().create(true).append(true).open(path).map(Self)
    }

    fn line(&mut self, epoch: u8, what: &str) -> io::Result<()> {
        self.0.write_all(format!("{} {epoch} {what}\n", now()).as_bytes())
    }
}

/// Acts with the tool in this folder for the time `length`, under this epoch, as long as the gate admits the epoch.
///
/// # Errors
/// The gate refuses the epoch, or a file cannot be used.
pub fn weld(folder: &Path, epoch: u8, deadline: Deadline, length: Duration) -> Result<(), Box<dyn Error>> {
    let gate = Gate::open(folder.join("tool.gate"))?;
    let mut log = Log::open(&folder.join("tool.log"))?;
    let mut permit = gate.admit(epoch, deadline)?;
    permit.act(|| log.line(epoch, "begin"))??;
    let end = now() + u64::try_from(length.as_micros())?;
    let stopped = loop {
        if now() >= end {
            break Ok(());
        }
        // A real program would move the motor by one step here.
        match permit.act(|| log.line(epoch, "act")) {
            Ok(written) => written?,
            Err(refused) => break Err(refused),
        }
        thread::sleep(STEP);
    };
    // This line is written outside the permit, because it is not an act.
    log.line(epoch, "end")?;
    stopped.map_err(Refused::into)
}

/// Acts under the epoch and the deadline that the runtime gives.
pub fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [folder, millis, rest @ ..] = arguments.as_slice() else {
        return Err("name a folder and a number of milliseconds".into());
    };
    let Orders { epoch, deadline } = Orders::from_env()?;
    let epoch = match (epoch, rest.first()) {
        (Some(epoch), _) => epoch,
        (None, Some(epoch)) => epoch.parse()?,
        (None, None) => return Err("the task is in no couple: name an epoch behind the milliseconds".into()),
    };
    let said = deadline.clone();
    // A runtime that gives no deadline sends no new deadlines on standard input either.
    if env::var_os(imrs_runtime::actuator::DEADLINE).is_some() {
        thread::spawn(move || said.follow(io::stdin().lock()));
    }
    weld(Path::new(folder), epoch, deadline, Duration::from_millis(millis.parse()?))
}
