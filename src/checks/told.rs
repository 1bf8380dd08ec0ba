//! What came of the checks, for people and for programs.

use super::Broken;
use super::vouch::Doubt;
use crate::cells::Loaded;
use crate::failure::Failure;
use crate::output::{BAD, GOOD, NOTE, Output, Styled, count, span};
use serde::Serialize;

/// What came of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// It held.
    Held,
    /// It did not.
    Broken,
    /// What should lead somewhere never came.
    Untested,
    /// One of its tasks runs elsewhere.
    Elsewhere,
    /// One of its tasks told nothing; or for some time nobody could say whether it held.
    Unknown,
}

/// All checks of a cell after a run.
#[derive(Clone, Debug, Default, Serialize)]
#[serde(transparent)]
pub struct Settlement(pub Vec<Settled>);

/// A check after a run.
#[derive(Clone, Debug, Serialize)]
pub struct Settled {
    name: String,
    /// Of the cell's text.
    line: usize,
    outcome: Outcome,
    /// Of `leads`, how often it came to matter.
    mattered: Option<u64>,
    /// How often it did not hold.
    times: u64,
    first: Option<First>,
    /// The first of its tasks that runs elsewhere.
    elsewhere: Option<String>,
    /// The time for which nobody can say whether it held.
    unvouched: Option<Unvouched>,
    /// The text of its line.
    #[serde(skip)]
    text: String,
}

/// The time for which nobody can say whether a check held.
#[derive(Clone, Debug, Serialize)]
pub struct Unvouched {
    /// How long, in all.
    seconds: f64,
    /// Why, for the most of it.
    why: String,
}

impl Unvouched {
    /// So many microseconds, for this reason.
    pub(super) fn new(loaded: &Loaded, doubt: Doubt, length: u64) -> Self {
        let cell = loaded.table.cell();
        let why = match doubt {
            Doubt::Command(task) => {
                format!("the command of `{}` was not confirmed to have ended", cell.tasks[task.index()].name)
            }
            Doubt::Silent(node) => format!("node `{}` told nothing", cell.nodes[node.index()].name),
            Doubt::Untold(node) => {
                format!("node `{}` could not tell everything", cell.nodes[node.index()].name)
            }
            Doubt::Dropped => "changes came faster than they could be judged".into(),
            Doubt::Dead(node) => {
                format!("node `{}` was dead, and a value depended on it", cell.nodes[node.index()].name)
            }
        };
        Self { seconds: length as f64 / 1e6, why }
    }

    /// ``unknown for 0.250 s: node `m` told nothing``.
    fn words(&self) -> String {
        let Self { seconds, why } = self;
        let length = if *seconds > 0.0 { format!(" for {seconds:.3} s") } else { String::new() };
        format!("unknown{length}: {why}")
    }
}

/// The first time that a check did not hold.
#[derive(Clone, Debug, Serialize)]
struct First {
    /// Since the run began.
    seconds: f64,
    values: Vec<String>,
    #[serde(skip)]
    words: String,
}

impl Broken {
    /// What a person reads: `check no_early (line 71) does not hold: armL.me.moving = true, armR.gripping = true`.
    pub fn words(&self, loaded: &Loaded) -> String {
        let check = &loaded.checks[self.check];
        let waited = self.since.map(|since| format!(" {} after its condition came", span(self.at - since)));
        format!(
            "check {} (line {}) does not hold{}: {}",
            check.name,
            loaded.line_of(check.span),
            waited.unwrap_or_default(),
            self.values.join(", ")
        )
    }
}

impl Settled {
    /// Of the check at this position; `counts`: how often it mattered and how often it did not hold; `why`: the reasons for which it was not
    /// judged at all, and not all the time.
    pub(super) fn new(
        loaded: &Loaded,
        at: usize,
        outcome: Outcome,
        counts: (Option<u64>, u64),
        first: Option<&Broken>,
        why: (Option<String>, Option<Unvouched>),
        began: u64,
    ) -> Self {
        let check = &loaded.checks[at];
        let line = loaded.line_of(check.span);
        let first = first.map(|first| First {
            seconds: first.at.saturating_sub(began) as f64 / 1e6,
            values: first.values.clone(),
            words: first.words(loaded),
        });
        let ((mattered, times), (elsewhere, unvouched)) = (counts, why);
        let (name, text) = (check.name.clone(), loaded.text_of(line).to_owned());
        Self { name, line, outcome, mattered, times, first, elsewhere, unvouched, text }
    }

    /// Whether it held; `None` if nobody can say.
    pub const fn held(&self) -> Option<bool> {
        match self.outcome {
            Outcome::Held | Outcome::Untested => Some(true),
            Outcome::Broken => Some(false),
            Outcome::Elsewhere | Outcome::Unknown => None,
        }
    }

    /// When it first did not hold, in seconds since the run began.
    pub fn broke_at(&self) -> Option<f64> {
        self.first.as_ref().map(|first| first.seconds)
    }

    /// What is wrong, in a line; `None` where nothing is.
    fn complaint(&self) -> Option<String> {
        let First { seconds, words, .. } = self.first.as_ref()?;
        Some(format!("{words}, at {seconds:.3} s (`{}`)", self.text))
    }
}

impl Settlement {
    /// What does not hold, a line each.
    pub fn complaints(&self) -> impl Iterator<Item = String> {
        self.0.iter().filter_map(Settled::complaint)
    }

    /// Checks that could not be judged, or not all the time, a line each with the reason.
    pub fn unjudged(&self) -> impl Iterator<Item = String> {
        let unknown = self.0.iter().filter(|settled| settled.outcome == Outcome::Unknown);
        unknown.map(|Settled { name, line, unvouched, .. }| match unvouched {
            Some(unvouched) => format!("check {name} (line {line}) is {}", unvouched.words()),
            None => format!("check {name} (line {line}) was not judged: one of its tasks told nothing"),
        })
    }

    /// The check of this name.
    pub fn named(&self, name: &str) -> Option<&Settled> {
        self.0.iter().find(|settled| settled.name == name)
    }

    /// Whether a check did not hold.
    pub fn is_broken(&self) -> bool {
        self.0.iter().any(|settled| settled.outcome == Outcome::Broken)
    }

    /// A line for each check.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn show(&self, out: &mut Output) -> Result<(), Failure> {
        for settled in &self.0 {
            let Settled { name, line, mattered, times, first, elsewhere, unvouched, .. } = settled;
            let came = mattered.map(|came| format!(" (its condition came {})", count(came, "time")));
            let what = match settled.outcome {
                Outcome::Held => Styled(GOOD, format!("held{}", came.unwrap_or_default())),
                Outcome::Broken => Styled(BAD, format!("DID NOT HOLD, {}", count(*times, "time"))),
                Outcome::Untested => Styled(NOTE, "not put to the test: its condition never came".into()),
                Outcome::Elsewhere => {
                    let task = elsewhere.as_deref().unwrap_or("?");
                    Styled(NOTE, format!("not evaluated here: `{task}` runs elsewhere"))
                }
                Outcome::Unknown => {
                    let unknown = unvouched.as_ref().map(Unvouched::words);
                    let unknown =
                        unknown.unwrap_or_else(|| "not evaluated: one of its tasks told nothing".into());
                    Styled(NOTE, unknown)
                }
            };
            out.line(format!("  check {name} (line {line}): {what}"))?;
            if let Some(First { seconds, values, .. }) = first {
                out.line(format!("    first at {seconds:.3} s: {}", values.join(", ")))?;
            }
        }
        Ok(())
    }
}
