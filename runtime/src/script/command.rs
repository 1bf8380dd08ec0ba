//! Actions that are commands to execute.

use super::actions::{Act, Actions, Ending, Stop};
use std::collections::BTreeMap;
use std::io::{self, Read};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// How often a command is asked whether it has ended.
const LOOK_EVERY: Duration = Duration::from_millis(1);
/// How much of a command's answer is read.
const LONGEST_ANSWER: u64 = 64;

/// Executes a command for each action that has one, and leaves the others to someone else.
///
/// The program is started with its own arguments, then those of the action, without a shell. Exit code 0 is success,
/// and the first line of its standard output the result, where that is a whole number. It is killed where the action
/// is cut short.
pub struct Commands {
    commands: BTreeMap<String, Vec<String>>,
    others: Arc<dyn Actions>,
    tell: Tell,
}

/// What hears of a command that could not be executed: the action, its program, and why.
type Tell = Box<dyn Fn(&str, &str, &io::Error) + Send + Sync>;

impl Commands {
    /// By the name of the action, its program and that one's first arguments.
    #[must_use]
    pub fn new(commands: BTreeMap<String, Vec<String>>, others: Arc<dyn Actions>) -> Self {
        Self { commands, others, tell: Box::new(|_, _, _| {}) }
    }

    /// Who is told of a command that could not be executed: the name of the action, its program, and why. To the script
    /// it is an action that failed.
    #[must_use]
    pub fn tell(self, tell: impl Fn(&str, &str, &io::Error) + Send + Sync + 'static) -> Self {
        Self { tell: Box::new(tell), ..self }
    }
}

impl Actions for Commands {
    fn begin(&self, act: &Act<'_>, ending: Ending) -> Option<Stop> {
        let Some((program, first)) = self.commands.get(act.name).and_then(|words| words.split_first()) else {
            return self.others.begin(act, ending);
        };
        let mut command = Command::new(program);
        command.args(first).args(act.arguments.iter().map(i64::to_string));
        let started = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn();
        let child = match started {
            Ok(child) => Arc::new(Mutex::new(child)),
            Err(why) => {
                (self.tell)(act.name, program, &why);
                ending.failed();
                return None;
            }
        };
        let watched = Arc::clone(&child);
        let name = format!("action {}", act.name);
        // Without a thread the ending is dropped, and says that the action failed.
        let watching = thread::Builder::new().name(name).spawn(move || watch(&watched, ending));
        if watching.is_err() {
            kill(&child);
        }
        Some(Box::new(move || kill(&child)))
    }
}

fn kill(child: &Mutex<Child>) {
    let mut child = child.lock().unwrap_or_else(PoisonError::into_inner);
    // It has ended already.
    let _ = child.kill();
    let _ = child.wait();
}

fn watch(child: &Mutex<Child>, ending: Ending) {
    let output = child.lock().unwrap_or_else(PoisonError::into_inner).stdout.take();
    let status = loop {
        let ended = child.lock().unwrap_or_else(PoisonError::into_inner).try_wait();
        match ended {
            Ok(None) => thread::sleep(LOOK_EVERY),
            Ok(Some(status)) => break status,
            Err(_) => return ending.failed(),
        }
    };
    if !status.success() {
        return ending.failed();
    }
    let mut text = String::new();
    if let Some(output) = output {
        // What cannot be read is no number.
        let _ = output.take(LONGEST_ANSWER).read_to_string(&mut text);
    }
    let answer = text.lines().next().and_then(|line| line.trim().parse().ok());
    ending.done(answer.unwrap_or(0));
}
