//! The progress display while claims are checked: one line on standard error for each running check.

use crate::args::Format;
use crate::output::grouped;
use imrs_model::{Progress, Verdict};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The progress lines of the claims, if standard error is a terminal.
pub struct Lines {
    all: MultiProgress,
    running: Mutex<Vec<Line>>,
}

/// The line of a claim that is being checked under one rule.
struct Line {
    name: String,
    title: String,
    bar: ProgressBar,
}

/// Where progress lines are drawn: on standard error, if it is a terminal and the answer is text.
pub(super) fn display(format: Format) -> MultiProgress {
    let target = match format {
        Format::Text => ProgressDrawTarget::stderr_with_hz(5),
        Format::Json => ProgressDrawTarget::hidden(),
    };
    MultiProgress::with_draw_target(target)
}

impl Lines {
    /// A display without lines.
    pub fn new(format: Format) -> Self {
        Self { all: display(format), running: Mutex::default() }
    }

    /// Removes all lines.
    pub fn clear(&self) {
        // If the terminal cannot be cleared, the lines stay on the screen.
        let _ = self.all.clear();
    }

    fn running(&self) -> MutexGuard<'_, Vec<Line>> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn title(name: &str, rule: &str, parties: u32) -> String {
    format!("{name} ({rule}, n={parties})")
}

impl Progress for Lines {
    fn started(&self, name: &str, rule: &str, parties: u32) {
        let title = title(name, rule, parties);
        let bar = self.all.add(ProgressBar::new_spinner().with_message(title.clone()));
        bar.enable_steady_tick(Duration::from_millis(200));
        self.running().push(Line { name: name.to_owned(), title, bar });
    }

    fn states(&self, name: &str, states: u64) {
        // If several rules of a claim are being checked, the line of the last one is changed.
        if let Some(line) = self.running().iter().rev().find(|line| line.name == name) {
            line.bar.set_message(format!("{}: {} states", line.title, grouped(states)));
        }
    }

    fn finished(&self, verdict: &Verdict) {
        let done = title(&verdict.name, &verdict.rule, verdict.parties);
        let mut running = self.running();
        if let Some(at) = running.iter().position(|line| line.title == done) {
            running.swap_remove(at).bar.finish_and_clear();
        }
    }
}
