//! Suites: the cases to measure, and the bounds of their ratios.

use crate::sample::Sample;
use std::fmt;

/// How much work each case does in a round.
#[derive(Clone, Copy, Debug)]
pub enum Effort {
    /// Each case does this share of the operations that it does in a full round.
    Share(f64),
    /// Each case does this many operations, however many a full round has.
    Times(u32),
}

impl Effort {
    /// The effort of a full round.
    pub const FULL: Self = Self::Share(1.0);

    /// The number of operations of a case; `full` is its number in a full round. At least one.
    #[must_use]
    pub fn of(self, full: u32) -> u32 {
        match self {
            Self::Share(share) => {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "a share of a u32"
                )]
                let share = (f64::from(full) * share.clamp(0.0, 1.0)) as u32;
                share.max(1)
            }
            Self::Times(times) => times.max(1),
        }
    }
}

/// One measurement: it sets everything up, measures, and removes everything again.
pub type Run = Box<dyn Fn(Effort) -> Sample>;

/// A named measurement.
pub struct Case {
    /// The case's name: the subject, a slash, the operation.
    pub name: String,
    /// What exactly the case measures.
    pub about: &'static str,
    /// Measures once.
    pub run: Run,
    /// Whether threads of the case run on two processors at once, so that its result depends on how near these
    /// processors are to each other.
    pub on_two: bool,
}

impl Case {
    /// Makes a case that works on one processor, or on any.
    pub fn new(
        name: impl Into<String>,
        about: &'static str,
        run: impl Fn(Effort) -> Sample + 'static,
    ) -> Self {
        Self { name: name.into(), about, run: Box::new(run), on_two: false }
    }
}

/// A statistic of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Stat {
    /// The median time.
    P50,
    /// The 99th percentile of the times.
    P99,
    /// The 99.9th percentile of the times.
    P999,
    /// The mean time.
    Mean,
    /// The number of the sample that is not a time.
    Count,
}

impl Stat {
    /// The value of this statistic in a sample.
    #[must_use]
    pub const fn of(self, sample: &Sample) -> Option<f64> {
        match self {
            Self::P50 => Some(sample.p50),
            Self::P99 => Some(sample.p99),
            Self::P999 => Some(sample.p999),
            Self::Mean => Some(sample.mean),
            Self::Count => sample.count,
        }
    }

    /// The name of the statistic in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::P50 => "p50",
            Self::P99 => "p99",
            Self::P999 => "p99.9",
            Self::Mean => "mean",
            Self::Count => "count",
        }
    }
}

/// What the statistic of a case, the subject of a row, is compared with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Against {
    /// The subject's statistic is compared with the same statistic of another case.
    Case(String),
    /// The subject's statistic is compared with another statistic of the same case.
    Itself(Stat),
    /// The statistic is compared with the same statistic of another case: the difference of the two, divided by this
    /// number of steps, is bounded.
    Above(String, u32),
    /// The statistic is not compared with another one; the bound applies to the statistic itself.
    Nothing,
}

/// The bound of a row's ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// The subject takes at most this many times the time of the other case.
    AtMost(f64),
    /// The other case takes at least this many times the time of the subject.
    AtLeast(f64),
}

impl Goal {
    /// The ratio to which the bound applies.
    #[must_use]
    pub fn ratio(self, subject: f64, against: f64) -> Option<f64> {
        let (over, under) = match self {
            Self::AtMost(_) => (subject, against),
            Self::AtLeast(_) => (against, subject),
        };
        (under > 0.0).then(|| over / under)
    }

    /// Whether a ratio keeps the bound, with `slack` as a factor (1.0 for none).
    #[must_use]
    pub fn met(self, ratio: f64, slack: f64) -> bool {
        match self {
            Self::AtMost(bound) => ratio <= bound * slack,
            Self::AtLeast(bound) => ratio >= bound / slack,
        }
    }
}

impl fmt::Display for Goal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AtMost(bound) => write!(f, "<= {bound}"),
            Self::AtLeast(bound) => write!(f, ">= {bound}"),
        }
    }
}

/// A row: a goal for a case, which says with what the case is compared, and the bound of the ratio.
#[derive(Clone, Debug)]
pub struct Row {
    /// The goal's number.
    pub id: &'static str,
    /// What is compared, in words.
    pub what: String,
    /// The name of the case.
    pub subject: String,
    /// The case of another library, or the baseline, with which the case is compared.
    pub against: Against,
    /// The statistic of both cases that is compared.
    pub stat: Stat,
    /// The bound of the ratio.
    pub goal: Goal,
    /// The first bound of the goal, if another bound replaced it.
    pub was: Option<&'static str>,
    /// Whether a round counts only if other programs left the processors alone in it.
    pub quiet: bool,
    /// Into how many equal parts the subject and the other case are divided before they are compared.
    pub parts: [u32; 2],
}

impl Row {
    /// Compares two cases.
    pub fn new(id: &'static str, subject: impl Into<String>, against: &str, stat: Stat, goal: Goal) -> Self {
        let subject = subject.into();
        let what = format!("{subject} : {against}");
        Self::of(id, what, subject, Against::Case(against.into()), stat, goal)
    }

    /// Compares two statistics of one case.
    pub fn within(id: &'static str, subject: &str, stat: Stat, against: Stat, goal: Goal) -> Self {
        let what = format!("{subject}, {} : {}", stat.name(), against.name());
        Self::of(id, what, subject.into(), Against::Itself(against), stat, goal)
    }

    /// Bounds a statistic itself.
    pub fn bounded(id: &'static str, what: &str, subject: &str, stat: Stat, goal: Goal) -> Self {
        Self::of(id, what.into(), subject.into(), Against::Nothing, stat, goal)
    }

    /// Bounds how many nanoseconds longer a case takes than another case, divided by the number of its steps.
    pub fn above(id: &'static str, what: &str, cases: [&str; 2], steps: u32, stat: Stat, goal: Goal) -> Self {
        let [subject, against] = cases.map(String::from);
        Self::of(id, what.into(), subject, Against::Above(against, steps), stat, goal)
    }

    const fn of(
        id: &'static str,
        what: String,
        subject: String,
        against: Against,
        stat: Stat,
        goal: Goal,
    ) -> Self {
        Self { id, what, subject, against, stat, goal, was: None, quiet: false, parts: [1, 1] }
    }

    /// The same row, with the text of the bound that its present bound has replaced.
    #[must_use]
    pub const fn was(mut self, bound: &'static str) -> Self {
        self.was = Some(bound);
        self
    }

    /// The same row, for which only those rounds count in which other programs left the processors alone.
    #[must_use]
    pub const fn when_quiet(mut self) -> Self {
        self.quiet = true;
        self
    }

    /// The same row for one of many equal parts: the subject's time is divided by `parts[0]`, and that of the other
    /// case by `parts[1]`.
    #[must_use]
    pub fn for_each(mut self, part: &str, parts: [u32; 2]) -> Self {
        self.what += ", for each ";
        self.what += part;
        self.parts = parts;
        self
    }

    /// The same row, whose text names the circumstances that hold for both cases.
    #[must_use]
    pub fn with(mut self, circumstances: &str) -> Self {
        self.what += ", ";
        self.what += circumstances;
        self
    }

    /// Whether the row needs this case.
    #[must_use]
    pub fn has(&self, case: &str) -> bool {
        self.subject == case || self.other() == Some(case)
    }

    /// The case with which the row's case is compared.
    #[must_use]
    pub fn other(&self) -> Option<&str> {
        match &self.against {
            Against::Case(name) | Against::Above(name, _) => Some(name),
            Against::Itself(_) | Against::Nothing => None,
        }
    }
}

/// Cases that are measured alternately, and the rows for their ratios.
#[derive(Default)]
pub struct Suite {
    /// The suite's name.
    pub name: &'static str,
    /// The cases. Each round measures all of them in this order: A B C A B C.
    pub cases: Vec<Case>,
    /// The rows with the goals.
    pub rows: Vec<Row>,
}

impl Suite {
    /// An empty suite.
    #[must_use]
    pub fn new(name: &'static str) -> Self {
        Self { name, ..Self::default() }
    }

    /// Adds a case.
    pub fn case(
        &mut self,
        name: impl Into<String>,
        about: &'static str,
        run: impl Fn(Effort) -> Sample + 'static,
    ) -> &mut Self {
        self.cases.push(Case::new(name, about, run));
        self
    }

    /// Adds a row.
    pub fn row(&mut self, row: Row) -> &mut Self {
        self.rows.push(row);
        self
    }
}
