//! The result of random runs, as JSON for programs.

use super::tell::PROVES_NOTHING;
use super::{Report, What};
use crate::verify;
use imrs_model::cell::{Ended, Found};
use serde::Serialize;

/// The JSON answer. It contains no times of this machine: the same seeds give the same bytes.
#[derive(Serialize)]
pub(super) struct Answer<'a> {
    version: u32,
    cell: &'a str,
    file: &'a str,
    /// Why the cell was not simulated; null if it was.
    not_simulated: Option<verify::NotChecked<'a>>,
    /// The first seed; null if the schedule of a file was run.
    seed: Option<u64>,
    runs: u64,
    with_faults: u64,
    steps: u64,
    /// The greatest number of steps of a run.
    most_steps: u32,
    simulated_us: u64,
    ended: Ends,
    /// Whether all requested runs were made.
    complete: bool,
    findings: Vec<One<'a>>,
    /// Statements that no run reached.
    not_reached: Vec<verify::Place<'a>>,
    /// The faults of the file that happened in no run.
    idle: Vec<String>,
    /// Times of the cell that are not multiples of its tick: the rounding may cause a finding.
    rounded: Vec<verify::Rounded<'a>>,
    /// Kinds of faults that the runs do not look for.
    not_looked_for: [&'static str; 1],
    /// The chart of a single run without findings.
    chart: Option<&'a str>,
}

/// The number of runs, by how they ended.
#[derive(Serialize)]
struct Ends {
    over: u64,
    finding: u64,
    steps: u64,
    crowded: u64,
}

#[derive(Serialize)]
struct One<'a> {
    #[serde(flatten)]
    told: verify::FindingAnswer<'a>,
    /// The first seed that shows the finding; null if the schedule of a file was run.
    seed: Option<u64>,
    /// Number of runs that show the finding.
    runs: u64,
    faults: Vec<String>,
    choices: usize,
    steps: usize,
    /// The size of the schedule before shrinking; null if it was not shrunk.
    shrunk_from: Option<Before>,
    again: String,
}

#[derive(Serialize)]
struct Before {
    faults: usize,
    choices: usize,
    steps: usize,
    /// Whether the schedule was shrunk as far as possible.
    whole: bool,
}

impl Report<'_> {
    /// The JSON answer.
    pub fn answer(&self) -> Answer<'_> {
        let (all, subject) = (self.all, self.subject);
        let by = |ended: Ended| all.ended[ended as usize];
        Answer {
            version: 1,
            cell: &subject.lowered.cell.name,
            file: &subject.file,
            not_simulated: self.refused.map(|refused| subject.not_checked(refused)),
            seed: match self.what {
                What::Seeds { first, .. } => Some(*first),
                What::Schedule(_) => None,
            },
            runs: all.runs,
            with_faults: all.with_faults,
            steps: all.steps,
            most_steps: self.args.steps,
            simulated_us: all.ticks.saturating_mul(subject.tick_us),
            ended: Ends {
                over: by(Ended::Over),
                finding: by(Ended::Found),
                steps: by(Ended::Steps),
                crowded: by(Ended::Crowded),
            },
            complete: self.refused.is_none() && !all.interrupted,
            findings: all.found.iter().enumerate().map(|(number, found)| self.one(number, found)).collect(),
            not_reached: subject.places(&all.not_reached),
            idle: all.idle.iter().map(|fault| self.words(fault)).collect(),
            rounded: subject.rounded_times(),
            not_looked_for: [PROVES_NOTHING],
            chart: self.chart.as_deref(),
        }
    }

    fn one<'a>(&'a self, number: usize, found: &'a Found) -> One<'a> {
        One {
            told: self.subject.told(&found.finding, self.is_saved(number)),
            seed: found.seed,
            runs: found.runs,
            faults: found.schedule.faults.iter().map(|fault| self.words(fault)).collect(),
            choices: found.schedule.choices(),
            steps: found.finding.moves.len(),
            shrunk_from: found.shrunk.map(|shrunk| Before {
                faults: shrunk.faults,
                choices: shrunk.choices,
                steps: shrunk.moves,
                whole: shrunk.whole,
            }),
            again: self.again(number, found),
        }
    }
}
