//! The end of a run: stops the nodes, takes their remaining messages, and sums up.

use super::{EXIT_WITHIN, Launcher};
use crate::cells::Loaded;
use crate::children::End;
use crate::clock::now_us;
use crate::fact::Fact;
use crate::faults::Fault;
use crate::folds::report::Report;
use crate::folds::story::{Events, Story};
use crate::folds::summary::{NodeSummary, Outcome, Summary};
use crate::folds::trouble::Trouble;
use crate::pipe::Order;
use imrs_protocol::NodeId;
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

/// How long the nodes may take to stop.
const STOP_WITHIN: Duration = Duration::from_secs(5);
/// How long the launcher still reads what nodes reported before they ended.
const READ_WITHIN: Duration = Duration::from_secs(2);

/// A run that has ended.
pub struct Ended<'a> {
    loaded: &'a Loaded,
    /// The run's summary.
    pub summary: Summary,
    /// What this launcher reports, for the summary of all machines.
    pub report: Report,
    events: Option<Events>,
}

/// How a run is judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Nothing went wrong in the run, and every check could be judged.
    Well,
    /// A promise was broken, or something other than the launcher killed a node.
    Finding,
    /// There was no finding, but a link was faulty, or too many datagrams came that no node of the cell sent.
    Suspect,
    /// There was no finding, but some evidence is missing.
    Incomplete,
    /// This program is at fault.
    Fault,
}

impl Ended<'_> {
    /// Puts an explanation of the run into its summary, if its events were kept for one.
    pub fn explain(&mut self, explain: impl FnOnce(&Story<'_>) -> Outcome) {
        let story = self.events.take().map(|events| events.story(self.loaded, &self.summary));
        self.summary.outcome = story.map(|story| explain(&story));
    }

    /// The verdict on the run.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        Verdict::of(&self.summary, &self.report.trouble)
    }
}

impl Verdict {
    /// The verdict on a run from its summary and its problems. Broken promises are a finding, and so is a node that something
    /// other than the launcher killed. The effects of injected faults are no finding.
    #[must_use]
    pub fn of(summary: &Summary, trouble: &[Trouble]) -> Self {
        let false_release = summary.rendezvous.iter().any(|r| r.false_releases.is_some_and(|n| n > 0));
        let broken = summary.outcome.as_ref().is_some_and(|outcome| outcome.held == Some(false))
            || summary.checks.is_broken();
        if trouble.iter().any(|trouble| trouble.at_fault) {
            Self::Fault
        } else if false_release || broken || !trouble.is_empty() {
            Self::Finding
        } else if summary.nodes.iter().any(NodeSummary::is_suspect) {
            Self::Suspect
        } else if summary.incomplete.is_empty() {
            Self::Well
        } else {
            Self::Incomplete
        }
    }
}

impl<'a> Launcher<'a> {
    /// Stops the nodes, takes their remaining messages, and sums up.
    #[must_use]
    pub fn finish(mut self) -> Ended<'a> {
        let seconds = self.elapsed().as_secs_f64();
        self.log.note(now_us(), &Fact::Over);
        let ends = self.stop();
        self.hear_of_commands();
        for node in self.children.nodes() {
            self.log.judge.gone(node);
        }
        self.log.judge.settle();
        let Self { run, cell, log, .. } = self;
        let exits: Vec<(NodeId, String)> = ends.iter().map(|(node, end)| (*node, end.to_string())).collect();
        let mut report = log.gatherer.report((seconds, run.seed, run.loss), &exits);
        report.rt = run.rt && !run.rt_refused;
        report.checks = log.judge.settlement(log.began);
        report.incomplete.extend(report.checks.unjudged());
        if log.judge.is_missing() && report.incomplete.is_empty() {
            let words = "changes that checks look at came faster than they could be judged";
            report.incomplete.push(words.into());
        }
        let summary =
            Summary::of(&run.loaded.table, std::slice::from_ref(&report), log.gatherer.rendezvous());
        let mut trouble = log.trouble.found();
        trouble.extend(ends.iter().filter_map(|(node, end)| {
            let what = format!("node `{}`: {end}", cell.nodes[node.index()].name);
            Some(Trouble { at_fault: end.at_fault()?, what })
        }));
        let refusals = summary
            .nodes
            .iter()
            .flat_map(|node| node.refusals.iter().map(|refusal| refusal.words(&node.name)));
        let outside = refusals.chain(summary.checks.complaints());
        trouble.extend(outside.map(|what| Trouble { at_fault: false, what }));
        report.trouble = trouble;
        Ended { loaded: run.loaded, summary, report, events: log.events }
    }

    /// Stops the nodes. Returns how each node ended.
    fn stop(&mut self) -> Vec<(NodeId, End)> {
        // A process that SIGSTOP has stopped cannot read the order, so it is resumed first.
        for (_, fault) in std::mem::take(&mut self.faults) {
            if let Fault::Resume(node) = fault {
                self.children.stand_still(node, false);
            }
        }
        self.children.order_all(&Order::Stop);
        let interrupts = self.interrupts.count();
        let mut deadline = Instant::now() + STOP_WITHIN;
        while !self.log.standing.is_gone() {
            if self.interrupts.count() > interrupts {
                deadline = Instant::now();
                break;
            }
            match self.messages.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(message) => self.take(message),
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => break,
            }
        }
        let ends = self.children.wait(deadline.saturating_duration_since(Instant::now()) + EXIT_WITHIN);
        // A node may have ended before a thread of this process has read the node's last reports from the pipe.
        let deadline = Instant::now() + READ_WITHIN;
        while !self.log.standing.is_gone()
            && let Ok(message) =
                self.messages.recv_timeout(deadline.saturating_duration_since(Instant::now()))
        {
            self.take(message);
        }
        // After a second Ctrl-C, reports may stay unread in the pipes. So a release is not called false because an
        // announcement is missing.
        for node in self.log.standing.unheard() {
            self.log.note(now_us(), &Fact::Unheard(node));
        }
        ends
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::tests::beam_lift;
    use crate::fact::Fold;
    use crate::folds::gatherer::Gatherer;
    use crate::pipe::{Event, Figures, What, Word};
    use imrs_protocol::{Round, TaskId, Usage};
    use std::sync::Arc;

    #[test]
    fn a_node_that_could_not_tell_everything_leaves_the_verdict_open() {
        let loaded = beam_lift();
        let mut gatherer = Gatherer::new(Arc::clone(&loaded.table), [0, 1, 2].map(NodeId).to_vec());
        let ended = |gatherer: &Gatherer, trouble: &[Trouble]| Ended {
            loaded: &loaded,
            summary: gatherer.summary((1.0, 7, 0.0), &[]),
            report: Report { trouble: trouble.to_vec(), ..Report::default() },
            events: None,
        };
        assert_eq!(ended(&gatherer, &[]).verdict(), Verdict::Well);
        let figures = |node, figures| Fact::Said(NodeId(node), Word::Figures(Box::new(figures)));
        gatherer.take(1, &figures(0, Figures { untold: 3, ..Figures::default() }));
        let open = ended(&gatherer, &[]);
        assert_eq!(open.summary.incomplete, ["node nl could not report 3 happenings: too many at once"]);
        assert_eq!(open.verdict(), Verdict::Incomplete);
        // A finding outranks missing evidence.
        let trouble = Trouble { at_fault: false, what: "a task failed".into() };
        assert_eq!(ended(&gatherer, &[trouble]).verdict(), Verdict::Finding);
        let unrecorded = vec!["the recording run.nr.imrs misses 2 inputs".to_owned()];
        gatherer.take(2, &figures(0, Figures::default()));
        gatherer.take(3, &figures(1, Figures { unrecorded: unrecorded.clone(), ..Figures::default() }));
        assert_eq!(ended(&gatherer, &[]).summary.incomplete, unrecorded);
    }

    #[test]
    fn a_node_that_was_not_heard_to_its_end_makes_no_release_false() {
        let loaded = beam_lift();
        let mut gatherer = Gatherer::new(Arc::clone(&loaded.table), [0, 1, 2].map(NodeId).to_vec());
        let lift =
            loaded.table.ports().iter().find(|port| port.decl.usage == Usage::Waitfor).expect("a waitfor");
        for (task, what) in [(0, What::Announced), (1, What::Announced), (0, What::Released)] {
            let event = Event { at: 5, task: TaskId(task), port: lift.id, round: Round(1), what };
            gatherer.take(5, &Fact::Said(NodeId(0), Word::Event(event)));
        }
        let summary = |gatherer: &Gatherer| gatherer.summary((1.0, 7, 0.0), &[]);
        assert_eq!(summary(&gatherer).rendezvous[0].false_releases, Some(1), "the hoist has not arrived");
        gatherer.take(6, &Fact::Unheard(NodeId(2)));
        assert_eq!(summary(&gatherer).rendezvous[0].false_releases, Some(0), "or that was not heard");
        assert_eq!(summary(&gatherer).incomplete, ["node nh was not heard to its end"]);
    }
}
