//! The verdicts on the checks after a run, as words for people and as JSON for programs.

use super::Broken;
use super::vouch::Doubt;
use crate::cells::Loaded;
use crate::words::{count, span};
use serde::{Deserialize, Serialize};

/// The verdict on a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The check held.
    Held,
    /// The check was broken.
    Broken,
    /// The premise of a `leads` never became true.
    Untested,
    /// A task of the check runs on a node that this run does not observe.
    Elsewhere,
    /// The tasks of the check ran on several machines. These share no clock, so it is unknown which values were true at once.
    Apart,
    /// A task of the check reported nothing, or its values were unknown for some time.
    Unknown,
}

/// The verdicts on all checks of a cell.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Settlement(pub Vec<Settled>);

/// The verdict on one check, with its details.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Settled {
    /// The name of the check.
    pub name: String,
    /// The check's line in the cell file.
    pub line: usize,
    /// The verdict on the check.
    pub outcome: Outcome,
    /// For `leads`: how often its premise became true.
    mattered: Option<u64>,
    /// How often the check was broken.
    times: u64,
    /// The first time at which the check was broken.
    pub first: Option<First>,
    /// The name of the check's first task that runs elsewhere.
    elsewhere: Option<String>,
    /// For how long it is unknown whether the check held.
    unvouched: Option<Unvouched>,
    /// The text of the check's line in the cell file.
    #[serde(skip)]
    text: String,
}

/// For how long it is unknown whether a check held.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Unvouched {
    /// For how long in all it is unknown, in seconds.
    seconds: f64,
    /// The main reason: it explains the largest part of that time.
    why: String,
}

impl Unvouched {
    /// Makes the value from a sum of microseconds and the main reason.
    pub(super) fn new(loaded: &Loaded, doubt: Doubt, length: u64) -> Self {
        let cell = loaded.table.cell();
        let why = match doubt {
            Doubt::Command(task) => {
                format!("the command of `{}` was not confirmed to have ended", cell.tasks[task.index()].name)
            }
            Doubt::Silent(node) => format!("node `{}` reported nothing", cell.nodes[node.index()].name),
            Doubt::Untold(node) => {
                format!("node `{}` could not report everything", cell.nodes[node.index()].name)
            }
            Doubt::Dropped => "changes came faster than they could be judged".into(),
            Doubt::Dead(node) => {
                format!("node `{}` was dead, and a value depended on it", cell.nodes[node.index()].name)
            }
        };
        Self { seconds: length as f64 / 1e6, why }
    }

    /// The words for people: ``unknown for 0.250 s: node `m` told nothing``.
    fn words(&self) -> String {
        let Self { seconds, why } = self;
        let length = if *seconds > 0.0 { format!(" for {seconds:.3} s") } else { String::new() };
        format!("unknown{length}: {why}")
    }
}

/// The first time at which a check was broken.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct First {
    /// The time of the break, in seconds since the run began.
    pub seconds: f64,
    /// The values that the check reads: `armL.me.moving = true`.
    pub values: Vec<String>,
    #[serde(skip)]
    words: String,
}

impl Broken {
    /// The words for people: `check no_early (line 71) does not hold: armL.me.moving = true, armR.gripping = true`.
    pub fn words(&self, loaded: &Loaded) -> String {
        let check = &loaded.checks[self.check];
        let waited =
            self.since.map(|since| format!(" {} after its condition became true", span(self.at - since)));
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
    /// The verdict on the check at position `at`. `counts` says how often the check mattered, and how often it was
    /// broken. `why` says why it was never judged, and why it was not judged all the time.
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

    /// Adds the verdict of another machine, or of another start of the same one. The worse verdict counts.
    fn join(&mut self, other: &Self) {
        let rank = |settled: &Self| match settled.outcome {
            Outcome::Elsewhere | Outcome::Apart => 0,
            Outcome::Untested => 1,
            Outcome::Held => 2,
            Outcome::Unknown => 3,
            Outcome::Broken => 4,
        };
        let came = [self.mattered, other.mattered].into_iter().flatten().reduce(|one, other| one + other);
        let times = self.times + other.times;
        if rank(other) > rank(self) {
            *self = other.clone();
        }
        (self.mattered, self.times) = (came, times);
    }

    /// Whether the check held; `None` if that is unknown.
    #[must_use]
    pub const fn held(&self) -> Option<bool> {
        match self.outcome {
            Outcome::Held | Outcome::Untested => Some(true),
            Outcome::Broken => Some(false),
            Outcome::Elsewhere | Outcome::Apart | Outcome::Unknown => None,
        }
    }

    /// When the check was first broken, in seconds since the run began.
    pub fn broke_at(&self) -> Option<f64> {
        self.first.as_ref().map(|first| first.seconds)
    }

    /// The verdict in words for people: `held`.
    #[must_use]
    pub fn words(&self) -> String {
        let came = self.mattered.map(|came| format!(" (its condition became true {})", count(came, "time")));
        match self.outcome {
            Outcome::Held => format!("held{}", came.unwrap_or_default()),
            Outcome::Broken => format!("DID NOT HOLD, {}", count(self.times, "time")),
            Outcome::Untested => "not put to the test: its condition never became true".into(),
            Outcome::Elsewhere => {
                let task = self.elsewhere.as_deref().unwrap_or("?");
                format!("not evaluated here: `{task}` runs elsewhere")
            }
            Outcome::Apart => "not evaluated: its tasks ran on several machines, which share no clock".into(),
            Outcome::Unknown => match &self.unvouched {
                Some(unvouched) => unvouched.words(),
                None => "not evaluated: one of its tasks reported nothing".into(),
            },
        }
    }

    /// The complaint about a broken check, in one line.
    fn complaint(&self) -> Option<String> {
        let First { seconds, words, .. } = self.first.as_ref()?;
        Some(format!("{words}, at {seconds:.3} s (`{}`)", self.text))
    }
}

impl Settlement {
    /// The verdicts of several machines together. A check is judged on the machine that runs all of its tasks.
    pub(crate) fn joined<'a>(all: impl Iterator<Item = &'a Self>) -> Self {
        let mut joined: Vec<Settled> = Vec::new();
        for settled in all.flat_map(|settlement| &settlement.0) {
            match joined.iter_mut().find(|known| known.name == settled.name && known.line == settled.line) {
                Some(known) => known.join(settled),
                None => joined.push(settled.clone()),
            }
        }
        Self(joined)
    }

    /// Marks each check that no machine could judge, once all machines have reported. Returns one line for each such
    /// check.
    pub(crate) fn mark_apart(&mut self) -> Vec<String> {
        let elsewhere = self.0.iter_mut().filter(|settled| settled.outcome == Outcome::Elsewhere);
        let apart = |settled: &mut Settled| {
            settled.outcome = Outcome::Apart;
            format!("check {} (line {}) was {}", settled.name, settled.line, settled.words())
        };
        elsewhere.map(apart).collect()
    }

    /// The complaints about broken checks, one line each.
    pub fn complaints(&self) -> impl Iterator<Item = String> {
        self.0.iter().filter_map(Settled::complaint)
    }

    /// The checks that could not be judged all the time, one line each with the reason.
    pub fn unjudged(&self) -> impl Iterator<Item = String> {
        let unknown = self.0.iter().filter(|settled| settled.outcome == Outcome::Unknown);
        unknown.map(|Settled { name, line, unvouched, .. }| match unvouched {
            Some(unvouched) => format!("check {name} (line {line}) is {}", unvouched.words()),
            None => format!("check {name} (line {line}) was not judged: one of its tasks reported nothing"),
        })
    }

    /// The verdict on the check of this name.
    pub fn named(&self, name: &str) -> Option<&Settled> {
        self.0.iter().find(|settled| settled.name == name)
    }

    /// Whether any check was broken.
    pub fn is_broken(&self) -> bool {
        self.0.iter().any(|settled| settled.outcome == Outcome::Broken)
    }
}
