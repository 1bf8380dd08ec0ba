//! The summary of a run, in the form that `--format json` prints and keeps stable.

use super::links::{SecuritySummary, link_summary};
use super::report::{AfterKill, NodeReport, Report, TaskSummary};
use super::rounds::Rounds;
use crate::checks::Settlement;
use crate::pipe::{Figures, Outcomes, RefusalFigures};
use imrs_protocol::{CellTable, NodeId, Port, PortCounters, Usage};
use imrs_wire::obs::LinkSummary;
use serde::Serialize;
use std::collections::BTreeMap;

/// The summary of a run, in the form that `--format json` prints and keeps stable.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The version of this JSON format.
    pub version: u32,
    /// The name of the cell that ran.
    pub cell: String,
    /// How long the tasks ran, in seconds.
    pub seconds: f64,
    /// The seed of the injected losses and of the durations of simulated actions.
    pub seed: u64,
    /// The share of datagrams that were dropped on purpose.
    pub loss: f64,
    /// The ports, each summed over all its ends.
    pub ports: Vec<PortSummary>,
    /// The results of each `waitfor`.
    pub rendezvous: Vec<RendezvousSummary>,
    /// How the class-2 messages of the tasks ended.
    pub commands: Outcomes,
    /// The tasks that gave up because a node was killed: for each kill, the first time_out of each task that waited for
    /// a task on the killed node.
    pub after_kill: Vec<AfterKill>,
    /// The scripts that ended by themselves.
    pub tasks: Vec<TaskSummary>,
    /// The nodes that this launcher ran.
    pub nodes: Vec<NodeSummary>,
    /// The verdicts on the checks of the cell.
    pub checks: Settlement,
    /// What the run could not observe, one line each. If there are such lines, a run without findings proves nothing
    /// about these parts.
    pub incomplete: Vec<String>,
    /// Whether the nodes ran under the real-time scheduler: `--rt` asked for it, and the kernel did not refuse.
    pub rt: bool,
    /// The outcome of a demo; `None` for any other run.
    pub outcome: Option<Outcome>,
}

impl Summary {
    /// Makes the summary from the reports of one launcher or of several. If a node is in several reports, each report
    /// is of another start of the node.
    #[must_use]
    pub fn of(table: &CellTable, reports: &[Report], rendezvous: Vec<RendezvousSummary>) -> Self {
        let nodes = nodes(table, reports);
        let figures = nodes.iter().map(|(_, _, figures)| figures);
        let mut commands = Outcomes::default();
        figures.clone().for_each(|figures| commands += figures.outcomes);
        Self {
            version: 1,
            cell: table.cell().name.clone(),
            seconds: reports.iter().map(|report| report.seconds).fold(0.0, f64::max),
            seed: reports.first().map_or(0, |report| report.seed),
            loss: reports.iter().map(|report| report.loss).fold(0.0, f64::max),
            ports: ports(table, figures),
            rendezvous,
            commands,
            after_kill: reports.iter().flat_map(|report| report.after_kill.clone()).collect(),
            tasks: reports.iter().flat_map(|report| report.tasks.clone()).collect(),
            nodes: nodes
                .iter()
                .map(|(id, node, figures)| NodeSummary::of(table, *id, node, figures))
                .collect(),
            checks: Settlement::joined(reports.iter().map(|report| &report.checks)),
            incomplete: reports.iter().flat_map(|report| report.incomplete.clone()).collect(),
            rt: !reports.is_empty() && reports.iter().all(|report| report.rt),
            outcome: None,
        }
    }
}

/// For each node, one report joined from all its reports, and the counters of all its incarnations. The last report
/// says how the node ended.
fn nodes(table: &CellTable, reports: &[Report]) -> Vec<(NodeId, NodeReport, Figures)> {
    let mut nodes: Vec<(NodeId, NodeReport, Figures)> = Vec::new();
    for report in reports.iter().flat_map(|report| &report.nodes) {
        let Some(id) = table.cell().nodes.iter().position(|node| node.name == report.name) else { continue };
        let id = NodeId::from_index(id);
        let at = nodes.iter().position(|(of, ..)| *of == id).unwrap_or_else(|| {
            let NodeReport { name, exit, .. } = report.clone();
            nodes.push((
                id,
                NodeReport { name, exit, incarnations: Vec::new(), alarms: 0 },
                Figures::default(),
            ));
            nodes.len() - 1
        });
        let (_, node, figures) = &mut nodes[at];
        report.incarnations.iter().for_each(|more| figures.add(more));
        node.exit.clone_from(&report.exit);
        node.incarnations.extend_from_slice(&report.incarnations);
        node.alarms += report.alarms;
    }
    nodes
}

fn ports<'a>(table: &CellTable, figures: impl Iterator<Item = &'a Figures>) -> Vec<PortSummary> {
    let mut sums = vec![PortCounters::default(); table.ports().len()];
    for &(task, port, mut counters) in figures.flat_map(|figures| &figures.ports) {
        let usage = table.port(port).and_then(|port| port.party(task)).map(|party| party.usage);
        if matches!(usage, Some(Usage::Send | Usage::Query)) {
            // At the sending end of a port, the counter of deliveries counts answers, so it is not added.
            counters.delivered = 0;
        }
        if let Some(sum) = sums.get_mut(port.index()) {
            add(sum, &counters);
        }
    }
    let port = |(port, c): (&Port, PortCounters)| PortSummary {
        name: port.decl.name.clone(),
        usage: port.decl.usage.word(),
        sent: c.sent,
        resent: c.resent,
        delivered: c.delivered,
        expired: c.expired,
        refused: c.refused,
        timed_out: c.timed_out,
        duplicates: c.duplicates,
    };
    table.ports().iter().zip(sums).map(port).collect()
}

fn add(sum: &mut PortCounters, more: &PortCounters) {
    sum.sent += more.sent;
    sum.resent += more.resent;
    sum.delivered += more.delivered;
    sum.expired += more.expired;
    sum.refused += more.refused;
    sum.timed_out += more.timed_out;
    sum.duplicates += more.duplicates;
}

/// One port, summed over all its ends.
#[derive(Clone, Debug, Serialize)]
pub struct PortSummary {
    /// The port's name.
    pub name: String,
    /// What the owner does with the port.
    pub usage: &'static str,
    /// How many messages were sent; of a waitfor, how many arrivals.
    pub sent: u64,
    /// How many copies were sent again.
    pub resent: u64,
    /// How many messages were delivered at the receiving ends; of a waitfor, how many releases.
    pub delivered: u64,
    /// How many messages expired in a buffer or on a link.
    pub expired: u64,
    /// How many messages were refused, because there was no room.
    pub refused: u64,
    /// How many requests ended by time_out.
    pub timed_out: u64,
    /// How many received messages were copies of messages that had arrived before.
    pub duplicates: u64,
}

/// The results of one waitfor.
#[derive(Clone, Debug, Serialize)]
pub struct RendezvousSummary {
    /// The name of the waitfor's port.
    pub port: String,
    /// The outcomes of the waitfor's rounds.
    #[serde(flatten)]
    pub rounds: Rounds,
    /// How many releases came before all members had arrived. `None` if only some nodes ran here, because arrivals on
    /// other nodes are not known.
    pub false_releases: Option<u64>,
}

/// The results of one node.
#[derive(Clone, Debug, Serialize)]
pub struct NodeSummary {
    /// The node's name.
    pub name: String,
    /// How the node's process ended: `clean`, `killed` by the launcher, or what went wrong.
    pub exit: String,
    /// The number of the node's incarnations in this run: 1 plus one per restart.
    #[serde(rename = "lives")]
    pub incarnations: usize,
    /// How many packets the node sent over links: its own, and those that it relayed.
    pub forwarded: u64,
    /// How many packets and messages the node's state machines dropped, by reason.
    pub discards: BTreeMap<String, u64>,
    /// How many packets the node's link dropped, by reason.
    pub link_discards: BTreeMap<String, u64>,
    /// Other counters of the node's link.
    pub link: BTreeMap<String, u64>,
    /// The links from the node's neighbours, as this node measured them; empty if nodes are joined without sockets.
    pub links: Vec<LinkSummary>,
    /// The datagrams that the node dropped, and that no node of the cell sent in this form.
    pub security: SecuritySummary,
    /// The neighbours that the node refused at the end of the run, because their cells differ.
    pub refusals: Vec<RefusalFigures>,
    /// How many packets the node's link dropped on purpose, as a random loss.
    pub lost_on_purpose: u64,
    /// How many packets the node's link dropped because of a cut.
    pub cut_off: u64,
}

impl NodeSummary {
    fn of(table: &CellTable, id: NodeId, node: &NodeReport, figures: &Figures) -> Self {
        Self {
            name: node.name.clone(),
            exit: node.exit.clone(),
            incarnations: node.incarnations.len(),
            forwarded: figures.forwarded,
            discards: figures.discards.clone(),
            link_discards: figures.link_discards.clone(),
            link: figures.link.clone(),
            links: figures.links.iter().map(|link| link_summary(table, id, link)).collect(),
            security: SecuritySummary::new(&figures.link_discards, node.alarms),
            refusals: figures.refusals.clone(),
            lost_on_purpose: figures.lost_on_purpose,
            cut_off: figures.cut_off,
        }
    }

    /// Whether a link to this node was faulty, or too many datagrams came that no node of the cell sent.
    #[must_use]
    pub fn is_suspect(&self) -> bool {
        self.security.alarms > 0 || self.links.iter().any(|link| link.integrity.faults > 0)
    }
}

/// The outcome of a demo.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Outcome {
    /// Whether the demo's promise was kept; `None` if the run did not test it.
    pub held: Option<bool>,
    /// What happened in the demo, in sentences.
    pub words: Vec<String>,
}
