//! The event log of a run: it passes every fact once to all folds, which compute the results.

use crate::checks::Judge;
use crate::fact::{Fact, Fold};
use crate::faults::Fault;
use crate::folds::gatherer::Gatherer;
use crate::folds::standing::Standing;
use crate::folds::story::Events;
use crate::folds::timeline::Timeline;
use crate::folds::trouble::TaskTrouble;
use crate::pipe::Word;
use crate::run::Run;
use imrs_protocol::NodeId;
use std::sync::Arc;

/// The folds of a run: each computes one result from the facts. The facts themselves are not kept, because a run may
/// last for months.
pub struct EventLog<'a> {
    /// Collects the counts for the run's summary.
    pub gatherer: Gatherer,
    /// Judges the checks of the cell.
    pub judge: Judge<'a>,
    /// The tasks that still run.
    pub standing: Standing<'a>,
    /// The problems of tasks so far.
    pub trouble: TaskTrouble,
    /// The lines for people, if they are shown.
    pub timeline: Option<Timeline<'a>>,
    /// The events that an explanation of the run needs; `None` if the run gets no explanation.
    pub events: Option<Events>,
    /// When the run began, in microseconds of the clock that all processes of one machine share.
    pub began: u64,
    /// Whether the run is over.
    pub is_over: bool,
}

impl<'a> EventLog<'a> {
    /// Makes the event log of a run in which these nodes report; there are no facts yet.
    pub fn new(run: &Run<'a>, here: Vec<NodeId>) -> Self {
        let (loaded, table) = (run.loaded, &run.loaded.table);
        Self {
            gatherer: Gatherer::new(Arc::clone(table), here.clone()),
            judge: Judge::new(loaded, &here),
            standing: Standing::new(loaded, here),
            trouble: TaskTrouble::new(Arc::clone(table), run.is_explained, run.loss > 0.0),
            timeline: run.has_lines.then(|| Timeline::new(loaded, run.in_process, run.only.is_some())),
            events: run.is_explained.then(Events::default),
            began: 0,
            is_over: false,
        }
    }

    /// Passes a fact to all folds. `at` is its instant, in microseconds of the clock that all processes of one machine
    /// share.
    pub fn note(&mut self, at: u64, fact: &Fact) {
        match fact {
            Fact::Began => self.began = at,
            Fact::Over => self.is_over = true,
            _ => {}
        }
        let always: [&mut dyn Fold; 4] =
            [&mut self.gatherer, &mut self.judge, &mut self.standing, &mut self.trouble];
        always.into_iter().for_each(|fold| fold.take(at, fact));
        if let Some(timeline) = &mut self.timeline {
            timeline.take(at, fact);
        }
        if let Some(events) = &mut self.events {
            events.take(at, fact);
        }
    }

    /// Lets the judge evaluate the checks up to the instant before which every node has reported everything. Each new
    /// break of a check is a fact, too.
    pub fn judge(&mut self) {
        for broken in self.judge.settle() {
            let at = broken.at;
            self.note(at, &Fact::Broken(broken));
        }
    }
}

/// The judge also judges recordings, which have no launcher. So it has methods of its own, and this implementation
/// calls one of them for each fact.
impl Fold for Judge<'_> {
    fn take(&mut self, at: u64, fact: &Fact) {
        match fact {
            Fact::Said(_, Word::Stands(change)) => self.change(change.clone()),
            Fact::Said(node, Word::Told(until)) => self.told(*node, *until),
            Fact::Said(node, Word::Untold { since }) => self.untold(*node, *since),
            Fact::Fault(Fault::Kill(node)) | Fact::Died(node) => self.killed(*node, at),
            Fact::Fault(Fault::Restart(node)) => self.revived(*node, at),
            Fact::Gone(node) => self.gone(*node),
            Fact::Noticed(notice) => self.notice(notice.clone()),
            Fact::Over => self.over(at),
            _ => {}
        }
    }
}
