//! Canonical packing of the queued inputs within a node.

use super::Node;
use super::work::Work;
use crate::ids::{MessageId, NodeId, TaskId};
use crate::packet::Packet;
use crate::request::TimeId;
use crate::state::{Walk, same_variant};
use crate::task::Input;
use crate::ticks::{Instant, Ticks};

/// The kinds of inputs that a packed state can hold.
const WORKS: [Work; 6] = [
    Work::Pass(TaskId(0), Ticks::ZERO),
    Work::Task(TaskId(0), Input::Packet(Packet::BLANK)),
    Work::Task(TaskId(0), Input::Unsent(MessageId::BLANK)),
    Work::Task(TaskId(0), Input::TimeOut { id: TimeId(0), turn: 0 }),
    Work::Task(TaskId(0), Input::PeerRestarted(NodeId(0))),
    Work::Task(TaskId(0), Input::PeerStopped(NodeId(0))),
];

impl Node {
    /// Walks the queued inputs of tasks. Everything else must be [filed](Self::file): other effects have no packed form.
    pub fn walk_work<W: Walk>(&mut self, w: &mut W) {
        let count = w.count(self.work.len());
        if W::READS {
            // The parts, whose clocks were read as zero, get only differences of this clock.
            self.now = Instant::START;
            self.work.clear();
            self.work.resize(count, Work::Pass(TaskId(0), Ticks::ZERO));
        }
        self.work.iter_mut().for_each(|work| work.walk(w));
    }
}

impl Work {
    fn is_like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Task(_, a), Self::Task(_, b)) => same_variant(a, b),
            (a, b) => same_variant(a, b),
        }
    }

    pub fn walk<W: Walk>(&mut self, w: &mut W) {
        w.one_of(&WORKS, self, Self::is_like);
        let (Self::Task(task, _) | Self::Pass(task, _)) = self else { return w.overflows() };
        w.small(&mut task.0);
        let task = *task;
        match self {
            Self::Pass(_, elapsed) => {
                let mut ticks = u32::try_from(elapsed.0).unwrap_or(u32::MAX);
                w.number(&mut ticks);
                *elapsed = Ticks(ticks.into());
            }
            Self::Task(_, Input::Packet(packet)) => packet.walk(w),
            Self::Task(_, Input::Unsent(id)) => {
                w.byte(&mut id.incarnation.0);
                w.sequence(task, &mut id.sequence);
            }
            // `turn` counts the starts of the timer, and is not packed: `Node::file` has dropped the time-outs of earlier
            // starts, so a queued time-out always belongs to the timer's last start.
            Self::Task(_, Input::TimeOut { id, turn: _ }) => w.byte(&mut id.0),
            Self::Task(_, Input::PeerRestarted(node) | Input::PeerStopped(node)) => w.small(&mut node.0),
            Self::Task(_, Input::Time | Input::Request(_))
            | Self::Route(_)
            | Self::Arm(..)
            | Self::Disarm(..) => {}
        }
    }
}
