//! Runs SPIN on the Promela models of `specs/promela`: builds a verifier with some definitions, runs it, and reads its
//! report.
#![allow(dead_code, reason = "every user of this uses a part of it")]

use std::path::{Path, PathBuf};
use std::process::Command;

/// The folder of the models.
pub const MODELS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../specs/promela");

/// A program that SPIN needs and that is missing; `None` if SPIN can run.
pub fn missing() -> Option<&'static str> {
    let answers = |program: &str, flag: &str| {
        Command::new(program).arg(flag).output().is_ok_and(|output| output.status.success())
    };
    if !answers("spin", "-V") {
        Some("spin")
    } else if !answers(&compiler(), "--version") {
        Some("a C compiler")
    } else {
        None
    }
}

fn compiler() -> String {
    std::env::var("CC").unwrap_or_else(|_| "cc".into())
}

/// A verifier program that SPIN made from a model.
pub struct Verifier {
    program: PathBuf,
}

/// The result that a verifier reported.
#[derive(Clone, Copy, Debug)]
pub struct Verdict {
    /// Whether the verifier looked at every state and the property held in all of them.
    pub holds: bool,
    /// The number of different states that were stored.
    pub states: u64,
    /// Wall-clock seconds of the search, as reported by SPIN.
    pub seconds: f64,
    /// The megabytes of memory in all, including the hash table and the stack, as reported by SPIN.
    pub megabytes: f64,
}

/// Builds the verifier of a model. The build uses `folder` alone; each of `definitions` is `NAME` or `NAME=value`.
pub fn build(folder: &Path, model: &Path, definitions: &[String], flags: &[&str]) -> Verifier {
    let define = definitions.iter().map(|definition| format!("-D{definition}"));
    let mut spin = Command::new("spin");
    spin.current_dir(folder).args(define).arg("-a").arg(model);
    done(spin);
    let mut cc = Command::new(compiler());
    // With this limit the verifier reports the end of its memory, instead of using up the computer's memory.
    cc.current_dir(folder).args(["-w", "-DSAFETY", "-DMEMLIM=4000"]).args(flags).args(["-o", "pan", "pan.c"]);
    done(cc);
    Verifier { program: folder.join("pan") }
}

fn done(mut command: Command) -> String {
    let output = command.output().unwrap_or_else(|e| panic!("{command:?}: {e}"));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {said}{complained}");
    said
}

impl Verifier {
    /// The path of the verifier program.
    pub fn path(&self) -> &Path {
        &self.program
    }

    /// A verifier that was built earlier.
    pub fn at(program: PathBuf) -> Self {
        Self { program }
    }

    /// Runs the verifier with these arguments in its own folder.
    pub fn run(&self, arguments: &[&str]) -> Verdict {
        self.run_in(self.program.parent().expect("a folder"), arguments)
    }

    /// Runs the verifier in this folder, in which the verifier leaves its trail. Memory bounds the run, because a time
    /// limit could end it early on a busy machine.
    pub fn run_in(&self, folder: &Path, arguments: &[&str]) -> Verdict {
        let mut pan = Command::new(&self.program);
        pan.current_dir(folder).args(arguments);
        read(&done(pan))
    }
}

/// Reads the report of a verifier.
pub fn read(said: &str) -> Verdict {
    let errors = number(said, "errors:", After) as u64;
    let complete = !said.contains("Search not completed") && !said.contains("search depth too small");
    assert!(errors > 0 || complete, "the verifier did not look at everything: {said}");
    assert!(errors == 0 || said.contains("assertion violated"), "another error than asked for: {said}");
    Verdict {
        holds: errors == 0,
        states: number(said, "states, stored", Before) as u64,
        seconds: number(said, "pan: elapsed time", After),
        megabytes: number(said, "total actual memory usage", Before),
    }
}

#[derive(Clone, Copy)]
enum Side {
    Before,
    After,
}

use Side::{After, Before};

/// The number beside these words in the report.
fn number(said: &str, words: &str, side: Side) -> f64 {
    let found = said.find(words).and_then(|at| match side {
        Before => said[..at].split_whitespace().next_back(),
        After => said[at + words.len()..].split_whitespace().next(),
    });
    found.and_then(|number| number.parse().ok()).unwrap_or_else(|| panic!("no number by {words:?}: {said}"))
}
