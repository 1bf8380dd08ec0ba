//! Gathers the summary of a run from its facts.

use super::attendance::{Attendance, waitfors};
use super::links::Alarm;
use super::report::{AfterKill, NodeReport, Report, TaskSummary};
use super::summary::RendezvousSummary;
use super::tally::Tally;
use crate::fact::{Fact, Fold};
use crate::faults::Fault;
use crate::pipe::{Event, Figures, What, Word};
use crate::words::count;
use imrs_protocol::{CellTable, NodeId, PortId, TaskId};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The summary so far.
pub struct Gatherer {
    table: Arc<CellTable>,
    tallies: BTreeMap<PortId, Tally>,
    /// The rounds in which each task took part, for the summary of all machines.
    attendance: Attendance,
    /// For each node, the counters of its incarnations.
    figures: Vec<Vec<Figures>>,
    /// For each node, whether too many datagrams came that no node of the cell sent.
    alarms: Vec<Alarm>,
    /// The nodes that report to this launcher: all nodes, or the only one that it runs.
    here: Vec<NodeId>,
    kills: Vec<(NodeId, u64)>,
    after_kill: Vec<AfterKill>,
    ended: Vec<TaskSummary>,
    /// The nodes whose last reports did not reach the launcher.
    unheard: Vec<NodeId>,
    /// The end of the run. Later events, while the nodes stop, do not count: a stopped task leaves its waitfor, and the
    /// other members move on to another round, which is not a fault.
    end: u64,
}

impl Fold for Gatherer {
    fn take(&mut self, at: u64, fact: &Fact) {
        match fact {
            Fact::Said(_, Word::Event(event)) => self.event(event),
            Fact::Said(node, Word::Figures(figures)) => {
                self.alarms[node.index()].take(at, &figures.link_discards);
                self.figures(*node, figures);
            }
            Fact::Said(_, Word::TaskEnded { task, how, .. }) => {
                let name = self.table.cell().tasks[task.index()].name.clone();
                self.ended.push(TaskSummary { name, end: how.clone() });
            }
            Fact::Fault(Fault::Kill(node)) | Fact::Died(node) => self.killed(*node, at),
            Fact::Fault(Fault::Restart(node)) => self.revived(*node, at),
            Fact::Unheard(node) => self.unheard(*node),
            Fact::Over => self.end = at,
            _ => {}
        }
    }
}

impl Gatherer {
    /// Makes the summary of a run of these nodes, before any report.
    pub fn new(table: Arc<CellTable>, here: Vec<NodeId>) -> Self {
        let heard = |task: &TaskId| table.location(*task).is_some_and(|node| here.contains(&node));
        let tally =
            |port: &imrs_protocol::Port| Tally::new(port.parties.iter().map(|p| p.task).filter(heard));
        let tallies = waitfors(&table).map(|port| (port.id, tally(port))).collect();
        let figures = table.cell().nodes.iter().map(|_| vec![Figures::default()]).collect();
        let alarms = vec![Alarm::default(); table.cell().nodes.len()];
        Self {
            attendance: Attendance::new(&table, &here),
            table,
            tallies,
            figures,
            alarms,
            here,
            kills: Vec::new(),
            after_kill: Vec::new(),
            ended: Vec::new(),
            unheard: Vec::new(),
            end: u64::MAX,
        }
    }

    /// Takes a node's report of an event at a waitfor.
    fn event(&mut self, event: &Event) {
        if event.at > self.end {
            return;
        }
        if let Some(tally) = self.tallies.get_mut(&event.port) {
            tally.take(event);
        }
        self.attendance.take(event);
        if let What::GaveUp { waited, missing } = event.what {
            self.note_give_up(event, waited, missing);
        }
    }

    /// Takes a node's counters since its start. They replace the node's earlier counters.
    fn figures(&mut self, node: NodeId, figures: &Figures) {
        if figures.untold > 0 {
            self.for_tasks_on(node, Tally::untold);
        }
        if let Some(kept) =
            self.figures.get_mut(node.index()).and_then(|incarnations| incarnations.last_mut())
        {
            kept.clone_from(figures);
        }
    }

    /// Notes that the last reports of a node did not reach the launcher.
    fn unheard(&mut self, node: NodeId) {
        self.for_tasks_on(node, Tally::untold);
        self.unheard.push(node);
    }

    /// Notes the restart of a killed node, at this instant of the clock that all processes of one machine share.
    fn revived(&mut self, node: NodeId, at: u64) {
        self.figures[node.index()].push(Figures::default());
        self.for_tasks_on(node, |tally, task| tally.revived(task, at));
    }

    /// Notes the kill of a node, at this instant of the clock that all processes of one machine share.
    fn killed(&mut self, node: NodeId, at: u64) {
        self.kills.push((node, at));
        self.for_tasks_on(node, |tally, task| tally.died(task, at));
    }

    /// How many rounds have released all members so far; `None` in a cell without waitfors.
    pub fn released(&self) -> Option<u64> {
        (!self.tallies.is_empty()).then(|| self.tallies.values().map(Tally::released).sum())
    }

    /// The report of the run so far, without the checks and problems. `exits` says how each node ended that this launcher ran.
    pub fn report(&self, (seconds, seed, loss): (f64, u64, f64), exits: &[(NodeId, String)]) -> Report {
        let cell = self.table.cell();
        let node = |(node, exit): &(NodeId, String)| NodeReport {
            name: cell.nodes[node.index()].name.clone(),
            exit: exit.clone(),
            incarnations: self.figures[node.index()].clone(),
            alarms: self.alarms[node.index()].raised,
        };
        Report {
            cell: cell.name.clone(),
            seconds,
            seed,
            loss,
            nodes: exits.iter().map(node).collect(),
            tasks: self.ended.clone(),
            after_kill: self.after_kill.clone(),
            attended: self.attendance.told(self.is_partial()),
            incomplete: self.untold().chain(self.cut_short()).chain(self.unrecorded()).collect(),
            ..Report::default()
        }
    }

    /// The outcomes of the waitfors.
    pub fn rendezvous(&self) -> Vec<RendezvousSummary> {
        let all = self.here.len() == self.table.cell().nodes.len();
        let one = |(&port, tally): (&PortId, &Tally)| {
            let mut rounds = tally.rounds();
            let false_releases = all.then_some(rounds.false_releases);
            rounds.start_skew_us = rounds.start_skew_us.filter(|_| all);
            RendezvousSummary { port: self.port_name(port), rounds, false_releases }
        };
        self.tallies.iter().map(one).collect()
    }

    /// Whether events of nodes are missing.
    fn is_partial(&self) -> bool {
        !self.unheard.is_empty() || self.figures.iter().flatten().any(|figures| figures.untold > 0)
    }

    /// The nodes that could not report all events, one line each.
    fn untold(&self) -> impl Iterator<Item = String> {
        self.figures.iter().zip(&self.table.cell().nodes).filter_map(|(incarnations, node)| {
            let untold: u64 = incarnations.iter().map(|figures| figures.untold).sum();
            let times = count(untold, "happening");
            (untold > 0).then(|| format!("node {} could not report {times}: too many at once", node.name))
        })
    }

    /// The nodes whose last reports did not reach the launcher, one line each.
    fn cut_short(&self) -> impl Iterator<Item = String> {
        let name = |node: &NodeId| &self.table.cell().nodes[node.index()].name;
        self.unheard.iter().map(move |node| format!("node {} was not heard to its end", name(node)))
    }

    /// The losses of recordings, one line each.
    fn unrecorded(&self) -> impl Iterator<Item = String> {
        self.figures.iter().flatten().flat_map(|figures| figures.unrecorded.iter().cloned())
    }

    fn for_tasks_on(&mut self, node: NodeId, mut change: impl FnMut(&mut Tally, TaskId)) {
        for task in self.table.tasks_on(node) {
            self.tallies.values_mut().for_each(|tally| change(tally, task));
        }
    }

    /// Keeps the event that a task gave up a waitfor, if it is the task's first since a kill, and a task on the killed
    /// node had not arrived.
    fn note_give_up(&mut self, event: &Event, waited: u64, missing: u64) {
        let Some(port) = self.table.port(event.port) else { return };
        let task = self.table.cell().tasks[event.task.index()].name.clone();
        for &(node, at) in &self.kills {
            let dead = |(i, party): (usize, &imrs_protocol::Party)| {
                missing >> i.min(63) & 1 == 1 && self.table.location(party.task) == Some(node)
            };
            let waited_for_it = port.parties.iter().enumerate().any(dead);
            let killed = &self.table.cell().nodes[node.index()].name;
            let first = !self.after_kill.iter().any(|a| a.killed == *killed && a.task == task);
            if event.at >= at && waited_for_it && first {
                self.after_kill.push(AfterKill {
                    killed: killed.clone(),
                    task: task.clone(),
                    waited_us: waited,
                    time_out_us: port.party(event.task).map_or(0, |p| p.time_out.0),
                    after_kill_us: event.at - at,
                });
            }
        }
    }

    fn port_name(&self, port: PortId) -> String {
        self.table.port(port).map(|p| p.decl.name.clone()).unwrap_or_default()
    }
}

#[cfg(test)]
impl Gatherer {
    /// The summary of the run so far.
    pub fn summary(&self, counts: (f64, u64, f64), exits: &[(NodeId, String)]) -> super::summary::Summary {
        super::summary::Summary::of(&self.table, &[self.report(counts, exits)], self.rendezvous())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::tests::beam_lift;
    use imrs_protocol::{PortCounters, Round};

    fn gatherer() -> Gatherer {
        Gatherer::new(Arc::clone(&beam_lift().table), [0, 1, 2].map(NodeId).to_vec())
    }

    #[test]
    fn the_first_give_up_after_a_kill_is_kept_of_every_task_that_waited_for_it() {
        let mut gatherer = gatherer();
        let hoist_missing = What::GaveUp { waited: 200_100, missing: 0b100 };
        let give_up =
            |at, task, what| Event { at, task: TaskId(task), port: PortId(0), round: Round(1), what };
        gatherer.event(&give_up(900, 0, hoist_missing));
        gatherer.killed(NodeId(2), 1_000);
        gatherer.event(&give_up(1_500, 0, What::GaveUp { waited: 200_100, missing: 0b010 }));
        gatherer.event(&give_up(2_000, 0, hoist_missing));
        gatherer.event(&give_up(3_000, 0, hoist_missing));
        gatherer.event(&give_up(4_000, 1, hoist_missing));
        let kept: Vec<_> = gatherer.after_kill.iter().map(|a| (a.task.as_str(), a.after_kill_us)).collect();
        assert_eq!(kept, [("armL", 1_000), ("armR", 3_000)]);
        let time_out = beam_lift().table.ports()[0].decl.time_out.0;
        assert!(gatherer.after_kill.iter().all(|a| a.killed == "nh" && a.time_out_us == time_out));
    }

    #[test]
    fn figures_replace_earlier_ones_of_the_node_and_add_up_over_nodes() {
        let mut gatherer = gatherer();
        let figures = |sent| Figures {
            ports: vec![(TaskId(0), PortId(1), PortCounters { sent, ..PortCounters::default() })],
            ..Figures::default()
        };
        gatherer.figures(NodeId(0), &figures(1));
        gatherer.figures(NodeId(0), &figures(5));
        gatherer.figures(NodeId(1), &figures(2));
        // The counters of the restarted node begin at zero again.
        gatherer.killed(NodeId(1), 7);
        gatherer.revived(NodeId(1), 9);
        gatherer.figures(NodeId(1), &figures(3));
        let exits = [(NodeId(0), "clean".into()), (NodeId(1), "clean".into()), (NodeId(2), "killed".into())];
        let summary = gatherer.summary((1.0, 7, 0.0), &exits);
        assert_eq!(summary.ports[1].sent, 10);
        assert_eq!((summary.nodes[1].incarnations, summary.nodes[2].incarnations), (2, 1));
        assert_eq!(summary.nodes[2].exit, "killed");
        let json = serde_json::to_value(&summary).unwrap();
        assert_eq!(json["rendezvous"][0]["start_skew_us"], serde_json::Value::Null);
        assert_eq!(json["rendezvous"][0]["port"], "lift");
        assert_eq!(json["rendezvous"][0]["false_releases"], 0);
    }

    #[test]
    fn what_one_node_cannot_know_is_null() {
        let gatherer = Gatherer::new(Arc::clone(&beam_lift().table), vec![NodeId(1)]);
        let json =
            serde_json::to_value(gatherer.summary((1.0, 7, 0.0), &[(NodeId(1), "clean".into())])).unwrap();
        assert_eq!(json["nodes"].as_array().unwrap().len(), 1);
        assert_eq!(json["rendezvous"][0]["false_releases"], serde_json::Value::Null);
    }
}
