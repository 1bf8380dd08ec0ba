//! Prints the result of random runs, for people.

use super::{Report, What};
use crate::args::Format;
use crate::failure::Failure;
use crate::output::{BAD, FAINT, HEAD, NOTE, Output, Styled, complain, count, grouped};
use crate::verify::chart;
use imrs_model::cell::{Ended, Fault, Found};

/// The caveat that is printed if runs have no findings.
pub(super) const PROVES_NOTHING: &str = "random runs prove nothing about others";

impl Report<'_> {
    /// Shows the findings, the runs and the statements that no run reached.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn show(&self, format: Format, out: &mut Output) -> Result<(), Failure> {
        match (format, self.refused) {
            (Format::Json, _) => {
                self.unsaved().into_iter().for_each(complain);
                out.json(&self.answer())
            }
            (Format::Text, Some(refused)) => {
                self.unsaved().into_iter().try_for_each(|said| out.line(Styled(NOTE, said)))?;
                let text = format!("{}: not simulated: {}", self.subject.file, refused.why);
                out.line(Styled(NOTE, text))
            }
            (Format::Text, None) => self.text(out),
        }
    }

    fn text(&self, out: &mut Output) -> Result<(), Failure> {
        for (number, found) in self.all.found.iter().enumerate() {
            let again = self.again(number, found);
            let whole = usize::from(self.args.finding) == number + 1;
            self.subject.tell(&found.finding, (!whole).then_some(&again), out)?;
            self.found(found, out)?;
            out.line(format!("  again: {again}"))?;
            out.line("")?;
        }
        if let Some(drawn) = &self.chart {
            chart(drawn, None, out)?;
            out.line("")?;
        }
        self.unsaved().into_iter().try_for_each(|said| out.line(Styled(NOTE, said)))?;
        self.runs(out)?;
        let unseen = "not reached in these runs, which proves nothing about others";
        self.subject.statements(unseen, &self.all.not_reached, out)?;
        let never = match self.what {
            What::Seeds { count: 2.., .. } => "this fault happened in none of these runs",
            What::Seeds { .. } | What::Schedule(_) => "this fault did not happen",
        };
        for fault in &self.all.idle {
            out.line(Styled(NOTE, format!("  {never}: {}", self.words(fault))))?;
        }
        self.subject.tell_rounded(!self.all.found.is_empty(), out)?;
        let file = &self.subject.file;
        let all = match (self.all.found.len(), self.all.interrupted) {
            (0, false) => {
                Styled(NOTE, format!("{file}: nothing found; {PROVES_NOTHING}: `imrs verify` does"))
            }
            (0, true) => Styled(NOTE, format!("{file}: nothing found so far; {PROVES_NOTHING}")),
            (found, _) => Styled(BAD, format!("{file}: {}", count(found as u64, "finding"))),
        };
        out.line(all)
    }

    /// Prints which runs have this finding, and its schedule.
    fn found(&self, found: &Found, out: &mut Output) -> Result<(), Failure> {
        if let Some(seed) = found.seed {
            let runs = match found.runs {
                1 => "this run alone shows it".into(),
                runs => format!("{} show it", count(runs, "run")),
            };
            out.line(format!("  found with seed {seed}; {runs}"))?;
        }
        if let Some(shrunk) = found.shrunk {
            let size = |faults: usize, choices: usize, moves: usize| {
                let [faults, choices, moves] = [(faults, "fault"), (choices, "choice"), (moves, "step")]
                    .map(|(n, one)| count(n as u64, one));
                format!("{faults}, {choices} and {moves}")
            };
            let before = size(shrunk.faults, shrunk.choices, shrunk.moves);
            let now = size(found.schedule.faults.len(), found.schedule.choices(), found.finding.moves.len());
            let part = if shrunk.whole { "" } else { "; shrinking was cut short" };
            out.line(format!("  shrunk from {before} to {now}{part}"))?;
        }
        match &found.schedule.faults[..] {
            [] => out.line("  without a fault"),
            faults => {
                let faults: Vec<String> = faults.iter().map(|fault| self.words(fault)).collect();
                out.line(format!("  with: {}", faults.join("; ")))
            }
        }
    }

    /// A fault in words, with the names of the cell.
    pub(super) fn words(&self, fault: &Fault) -> String {
        fault.words(&self.subject.table, &|ticks| self.names.time(ticks))
    }

    fn runs(&self, out: &mut Output) -> Result<(), Failure> {
        let (all, file) = (self.all, &self.subject.file);
        let bound = grouped(self.args.steps.into());
        let head = match self.what {
            What::Seeds { first, count: 1, .. } => format!("{file}: the run of seed {first}"),
            What::Seeds { first, .. } => {
                let last = first.wrapping_add(all.runs.saturating_sub(1));
                format!("{file}: the runs of seeds {first} to {last}")
            }
            What::Schedule(_) => format!("{file}: the run of the file"),
        };
        let ended = if all.interrupted { ", ended early" } else { "" };
        out.line(Styled(HEAD, format!("{head}{ended}")))?;
        out.line(format!(
            "  {}, {} with faults; {}; {} of the cell's time",
            count(all.runs, "run"),
            grouped(all.with_faults),
            count(all.steps, "step"),
            self.names.time(all.ticks)
        ))?;
        let by = |ended: Ended| grouped(all.ended[ended as usize]);
        let mut ends = vec![
            format!("{} where nothing happens any more", by(Ended::Over)),
            format!("{} at a finding", by(Ended::Found)),
            format!("{} after {bound} steps (--steps)", by(Ended::Steps)),
        ];
        if all.ended[Ended::Crowded as usize] > 0 {
            ends.push(format!("{} with more packets in flight than can be numbered", by(Ended::Crowded)));
        }
        out.line(format!("  ended: {}", ends.join(", ")))?;
        out.line(Styled(
            FAINT,
            "  judged: checks, invariants of the machine, deadlocks, and how scripts and requests end"
                .to_owned(),
        ))
    }
}
