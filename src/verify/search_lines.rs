//! The progress display while a cell is searched: a line on standard error for each phase, and one for each kind of finding so far.

use super::covered::bounds;
use super::progress::display;
use super::subject::Subject;
use crate::args::Format;
use crate::output::grouped;
use imrs_model::cell::{CellPlan, Coverage, FoundSoFar, Phase, SearchProgress, SoFar, Times};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::time::Duration;

/// The length of the interval over which the number of open states is compared, in seconds. An open state is found and
/// not explored yet.
const LATELY: f64 = 3.0;
/// The greatest number of findings that are shown while the search goes on.
const FEW: usize = 5;

/// The progress lines of a search, if standard error is a terminal.
pub(super) struct SearchLines<'a> {
    subject: &'a Subject,
    plan: &'a CellPlan,
    all: MultiProgress,
    running: RefCell<Option<Running>>,
    found: RefCell<Vec<String>>,
}

/// The search that runs now.
struct Running {
    bar: ProgressBar,
    title: String,
    pace: Pace,
}

/// The number of open states at several recent times.
#[derive(Default)]
struct Pace(VecDeque<(f64, u64)>);

impl Pace {
    /// Notes how far the search is. Returns in how many seconds it will end if the open states become fewer as fast as
    /// before, or `None` if they do not become fewer.
    fn note(&mut self, so_far: &SoFar) -> Option<f64> {
        while self.0.get(1).is_some_and(|&(at, _)| so_far.seconds - at >= LATELY) {
            self.0.pop_front();
        }
        self.0.push_back((so_far.seconds, so_far.open));
        let &(since, before) = self.0.front()?;
        let (length, fewer) = (so_far.seconds - since, before.checked_sub(so_far.open)?);
        #[expect(clippy::cast_precision_loss, reason = "an estimate")]
        let left = so_far.open as f64 * length / fewer as f64;
        (fewer > 0 && length >= 1.0).then_some(left)
    }
}

impl<'a> SearchLines<'a> {
    /// A display without lines.
    pub fn new(subject: &'a Subject, plan: &'a CellPlan, format: Format) -> Self {
        Self { subject, plan, all: display(format), running: RefCell::default(), found: RefCell::default() }
    }

    /// Removes all lines.
    pub fn clear(&self) {
        // If the terminal cannot be cleared, the lines stay on the screen.
        let _ = self.all.clear();
    }

    /// Adds a line that stays until all lines are removed.
    fn add(&self, text: String) {
        let bar = self.all.add(ProgressBar::new_spinner());
        if let Ok(style) = ProgressStyle::with_template("{wide_msg}") {
            bar.set_style(style);
        }
        bar.abandon_with_message(text);
    }
}

impl SearchProgress for SearchLines<'_> {
    fn started(&self, phase: (Phase, usize), times: Times) {
        let title = bounds(self.plan, phase, times);
        let before = self.running.take().map(|running| running.bar);
        let bar = before.unwrap_or_else(|| {
            let bar = self.all.add(ProgressBar::new(100));
            // If the share is not known yet, the bar is empty.
            if let Ok(style) = ProgressStyle::with_template("{spinner} [{bar:12}] {wide_msg}") {
                bar.set_style(style.progress_chars("=> "));
            }
            bar.enable_steady_tick(Duration::from_millis(200));
            bar
        });
        bar.set_position(0);
        bar.set_message(title.clone());
        *self.running.borrow_mut() = Some(Running { bar, title, pace: Pace::default() });
    }

    fn states(&self, so_far: &SoFar) {
        let mut running = self.running.borrow_mut();
        let Some(Running { bar, title, pace }) = running.as_mut() else { return };
        let ends = match pace.note(so_far) {
            Some(left) if so_far.seconds + left <= so_far.at_most_seconds => {
                format!("about {left:.0} s left")
            }
            _ => format!("at most {:.0} s left", (so_far.at_most_seconds - so_far.seconds).max(0.0)),
        };
        bar.set_position(((so_far.states - so_far.open) * 100).checked_div(so_far.states).unwrap_or(0));
        let (states, open) = (grouped(so_far.states), grouped(so_far.open));
        let noun = if so_far.states == 1 { "state" } else { "states" };
        bar.set_message(format!("{ends}: {states} {noun}, {open} to look at; {title}"));
    }

    fn found(&self, found: &FoundSoFar<'_>) {
        let place = found.place.and_then(|(task, at)| self.subject.place(task, at));
        let line = place.map_or_else(String::new, |(line, ..)| format!("line {line}: "));
        let text = format!("  so far: {line}{}: {}", found.kind.name(), found.cause);
        let mut all = self.found.borrow_mut();
        if all.len() < FEW && !all.contains(&text) {
            self.add(text.clone());
            all.push(text);
        }
    }

    fn finished(&self, coverage: &Coverage) {
        let Some(running) = self.running.take() else { return };
        running.bar.finish_and_clear();
        let how = if coverage.complete { "done" } else { "cut short" };
        let states = grouped(coverage.states);
        self.add(format!("{how}: {states} states in {:.1} s; {}", coverage.seconds, running.title));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64, open: u64) -> SoFar {
        SoFar { states: 10_000, open, seconds, at_most_seconds: 60.0 }
    }

    #[test]
    fn an_estimate_comes_only_from_open_states_that_become_fewer() {
        let mut pace = Pace::default();
        assert_eq!(pace.note(&at(0.0, 100)), None, "nothing to compare with");
        assert_eq!(pace.note(&at(2.0, 300)), None, "it grows");
        assert_eq!(pace.note(&at(4.0, 200)), None, "more than at the first of these");
        // Three seconds ago, there were 300 open states.
        let left = pace.note(&at(6.0, 100)).expect("it shrinks");
        assert!((left - 2.0).abs() < 1e-9, "{left}");
    }
}
