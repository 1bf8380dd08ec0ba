//! Computes the action and packet times with which a finding happens.

use super::subject::Subject;
use imrs_model::cell::{Finding, TimeRange, Timed};
use serde::Serialize;

/// The greatest number of ranges that are shown.
const FEW: usize = 6;

/// The times that an action or a packet takes when a finding happens, as JSON.
#[derive(Serialize)]
pub struct RangeAnswer<'a> {
    /// `action` or `packet`.
    what: &'static str,
    /// The name of the action, or of the port of the packet's message.
    name: &'a str,
    /// The task of the action.
    task: Option<&'a str>,
    /// The nodes between which the packet is on its link.
    from: Option<&'a str>,
    to: Option<&'a str>,
    /// The least and the greatest time in microseconds with which the same path happens. `null`: there is no greatest time.
    least_us: u64,
    most_us: Option<u64>,
    /// The least and the greatest time that the cell declares.
    declared_least_us: u64,
    declared_most_us: Option<u64>,
    /// Whether the action or the packet is over at the finding.
    has_ended: bool,
}

impl Subject {
    /// The ranges of a finding as JSON.
    pub fn ranges<'a>(&'a self, finding: &'a Finding) -> Vec<RangeAnswer<'a>> {
        let usec = |ticks: u64| ticks.saturating_mul(self.tick_us);
        let cell = self.table.cell();
        let node = |node: &imrs_protocol::NodeId| cell.nodes.get(node.index()).map(|node| node.name.as_str());
        let answer = |range: &'a TimeRange| {
            let (what, name, task, [from, to]) = match &range.timed {
                Timed::Action { task, name } => ("action", name.as_str(), Some(self.task(*task)), [None; 2]),
                Timed::Packet { port, from, to } => {
                    let port = cell.ports.get(port.index()).map_or("?", |port| port.name.as_str());
                    ("packet", port, None, [from, to].map(node))
                }
            };
            let (least_us, most_us) = (usec(range.least), range.most.map(usec));
            let (declared_least_us, declared_most_us) =
                (usec(range.declared_least), range.declared_most.map(usec));
            let has_ended = range.has_ended;
            RangeAnswer {
                what,
                name,
                task,
                from,
                to,
                least_us,
                most_us,
                declared_least_us,
                declared_most_us,
                has_ended,
            }
        };
        finding.ranges.iter().map(answer).collect()
    }

    /// The ranges of a finding as text: "happens if `grip` of armL takes 412..500 msec". `None` if the finding happens with each
    /// declared time of each action and packet, or if the ranges are not known.
    pub fn happens(&self, finding: &Finding) -> Option<String> {
        let narrowed: Vec<String> = (0..finding.ranges.len())
            .filter(|&at| finding.ranges[at].is_narrowed())
            .map(|at| self.range(&finding.ranges, at))
            .collect();
        let more = narrowed.len().saturating_sub(FEW);
        let last = if more > 0 { format!(" and {more} more") } else { String::new() };
        // With several ranges, a time in one range may lead to the finding only with certain times of the others.
        let can = if finding.ranges.len() == 1 { "happens if" } else { "can happen if" };
        let few: Vec<String> = narrowed.into_iter().take(FEW).collect();
        (!few.is_empty()).then(|| format!("{can} {}{last}", few.join(", ")))
    }

    fn range(&self, all: &[TimeRange], at: usize) -> String {
        let range = &all[at];
        let same = |other: &&TimeRange| other.timed == range.timed;
        let (number, count) = (1 + all[..at].iter().filter(same).count(), all.iter().filter(same).count());
        let which = if count == 1 { String::new() } else { format!(" (the {number}. of {count} times)") };
        let takes = self.takes(range);
        match &range.timed {
            Timed::Action { task, name } => format!("`{name}` of {} takes {takes}{which}", self.task(*task)),
            Timed::Packet { port, from, to } => {
                let cell = self.table.cell();
                let port = cell.ports.get(port.index()).map_or("?", |port| port.name.as_str());
                let [from, to] = [from, to]
                    .map(|node| cell.nodes.get(node.index()).map_or("?", |node| node.name.as_str()));
                format!("a packet of `{port}` takes {takes} from {from} to {to}{which}")
            }
        }
    }

    /// The times of a range, with their unit.
    fn takes(&self, range: &TimeRange) -> String {
        let ends =
            [Some(range.least), range.most].map(|end| end.map(|ticks| ticks.saturating_mul(self.tick_us)));
        let in_msec = ends.iter().flatten().all(|usec| usec.is_multiple_of(1000));
        let (unit, by) = if in_msec { ("msec", 1000) } else { ("usec", 1) };
        match ends.map(|end| end.map(|usec| usec / by)) {
            [Some(least), Some(most)] if least == most => format!("{least} {unit}"),
            [Some(least), Some(most)] => format!("{least}..{most} {unit}"),
            [least, _] => format!("{} {unit} or more", least.unwrap_or(0)),
        }
    }
}
