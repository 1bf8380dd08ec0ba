//! Draws the faults of a seed: within the faults that the cell declares, at packets, actions and times that a run without
//! faults has.

use super::driver::random;
use super::run::Run;
use super::schedule::{Fault, MOST_FAULTS};
use crate::cell::plan::{CellFaults, CellPlan};
use imrs_protocol::{NodeId, TaskId};

/// One run in this many has no faults, although the cell declares some.
const PLAIN: u8 = 8;
/// The number of powers of two from which a duration is drawn, if the run without faults does not bound the duration.
const MAGNITUDES: u32 = 16;

/// What the plain run contains: the run that has no faults, and in which every choice is 0.
#[derive(Debug)]
pub(super) struct Census {
    /// The directed links on which packets arrive, each with the number of its packets.
    lines: Vec<((NodeId, NodeId), u32)>,
    /// The tasks whose actions end, each with the number of its actions.
    tasks: Vec<(TaskId, u32)>,
    ticks: u64,
}

impl Census {
    pub fn of(plan: &CellPlan, links: &[(NodeId, NodeId, u8)], run: &Run) -> Self {
        let (arrived, ended) = &run.counts;
        let used = links.iter().zip(arrived).filter(|(_, count)| **count > 0);
        let mut lines: Vec<_> = used.map(|(&(from, to, _), &count)| ((from, to), count)).collect();
        if lines.is_empty() {
            lines = links.iter().map(|&(from, to, _)| ((from, to), 1)).collect();
        }
        let acts = ended.iter().enumerate().filter(|(_, count)| **count > 0);
        let mut tasks: Vec<_> = acts.map(|(task, &count)| (TaskId::from_index(task), count)).collect();
        if tasks.is_empty() {
            tasks = (0..plan.tasks.len()).map(|task| (TaskId::from_index(task), 1)).collect();
        }
        Self { lines, tasks, ticks: run.ticks }
    }

    /// The faults of a seed. Each kind of fault has its own random stream.
    pub fn draw(&self, plan: &CellPlan, seed: u64) -> Vec<Fault> {
        let mut swarm = random(seed, 0);
        let hypotheses: Vec<&CellFaults> = plan.faults.iter().filter(|faults| !faults.are_none()).collect();
        if hypotheses.is_empty() || swarm.u8(..PLAIN) == 0 {
            return Vec::new();
        }
        let within = hypotheses[swarm.usize(..hypotheses.len())];
        let nodes = plan.table.cell().nodes.len();
        let mut faults = Vec::new();
        let mut all = Vec::new();
        let mut kind =
            |stream: u64, count: usize, one: &mut dyn FnMut(&mut fastrand::Rng, usize) -> Option<Fault>| {
                let mut rng = random(seed, stream);
                let whole = rng.bool();
                for number in 0..count {
                    let taken = rng.bool() || whole;
                    let Some(fault) = one(&mut rng, number) else { continue };
                    if taken {
                        faults.push(fault.clone());
                    }
                    all.push(fault);
                }
            };
        let line = |rng: &mut fastrand::Rng| self.lines.get(rng.usize(..self.lines.len().max(1))).copied();
        let mut lost: Option<((NodeId, NodeId), u32)> = None;
        kind(1, within.loss.into(), &mut |rng, _| {
            // Half of the further losses hit the packet after the last lost one: it is often the retransmission.
            let again = lost.filter(|_| rng.bool());
            let (link, nth) = match again {
                Some((link, nth)) => (link, nth.saturating_add(1)),
                None => line(rng).map(|(link, most)| (link, count(rng, most)))?,
            };
            lost = Some((link, nth));
            Some(Fault::Lose { link, nth })
        });
        kind(2, within.dup.into(), &mut |rng, _| {
            line(rng).map(|(link, most)| Fault::Copy { link, nth: count(rng, most) })
        });
        kind(3, within.reorder.into(), &mut |rng, _| {
            line(rng).map(|(link, most)| Fault::Overtake { link, nth: count(rng, most) })
        });
        kind(4, within.fail.into(), &mut |rng, _| {
            let (task, most) = self.tasks.get(rng.usize(..self.tasks.len().max(1))).copied()?;
            Some(Fault::Fail { task, nth: count(rng, most) })
        });
        let mut instants = Vec::new();
        kind(5, within.crash.len(), &mut |rng, number| {
            let at = instant(rng, self.ticks);
            instants.push(at);
            let restart = (rng.u8(..4) > 0).then(|| if rng.bool() { 0 } else { magnitude(rng) });
            Some(Fault::Stop { node: within.crash[number], at, restart })
        });
        kind(6, within.cut.len(), &mut |rng, number| {
            let at = instant(rng, self.ticks);
            instants.push(at);
            let lasts = (rng.u8(..8) > 0).then(|| magnitude(rng));
            Some(Fault::Cut { link: within.cut[number], at, lasts })
        });
        let mut slow: Option<(NodeId, u64, bool)> = None;
        kind(7, within.drift.into(), &mut |rng, _| {
            // Three of four further drifts repeat the last drift. Half of the others happen at the first crash or cut.
            let (node, at, more) = slow.filter(|_| rng.u8(..4) > 0).unwrap_or_else(|| {
                let at = instants.first().copied().filter(|_| rng.bool());
                let at = at.unwrap_or_else(|| instant(rng, self.ticks));
                (NodeId::from_index(rng.usize(..nodes)), at, rng.bool())
            });
            slow = Some((node, at, more));
            Some(Fault::Drift { node, at, more })
        });
        kind(8, within.pause.len(), &mut |rng, number| {
            let pause = within.pause[number];
            let at = instant(rng, self.ticks);
            let lasts = if rng.bool() { pause.most } else { rng.u32(1..=pause.most.max(1)) };
            let node = pause.node.unwrap_or_else(|| NodeId::from_index(rng.usize(..nodes)));
            Some(Fault::Pause { node, at, lasts, before_action: rng.u8(..4) == 0 })
        });
        // Half of the runs have all faults of a kind, the others some of them. If none is drawn for any kind, all happen.
        let mut drawn = if faults.is_empty() { all } else { faults };
        drawn.truncate(MOST_FAULTS);
        drawn
    }
}

/// A number from 1 to `most`: half of the numbers are uniform, half rather small.
fn count(rng: &mut fastrand::Rng, most: u32) -> u32 {
    let any = rng.u32(1..=most.max(1));
    let power = rng.u32(..=most.max(1).ilog2());
    let early = 1 + rng.u32(..1 << power);
    if rng.bool() { any } else { early }
}

/// An instant up to `most`: half of the instants are uniform, half rather early.
fn instant(rng: &mut fastrand::Rng, most: u64) -> u64 {
    let any = rng.u64(..=most);
    let power = rng.u32(..=most.max(1).ilog2());
    let early = rng.u64(..1 << power);
    if rng.bool() { any } else { early }
}

/// A number of ticks, at least 1, of any magnitude.
fn magnitude(rng: &mut fastrand::Rng) -> u64 {
    let power = rng.u32(..MAGNITUDES);
    rng.u64(1 << power..2 << power)
}
