//! The fields of effects within a node.

use super::Node;
use super::work::Work;
use crate::ids::{MessageId, NodeId, TaskId};
use crate::packet::Packet;
use crate::request::TimeId;
use crate::state::{Walk, same_variant};
use crate::task::Input;
use crate::ticks::Ticks;

/// The kinds of effects that a state can have.
const WORKS: [Work; 8] = [
    Work::Route(Packet::BLANK),
    Work::Task(TaskId(0), Input::Packet(Packet::BLANK)),
    Work::Task(TaskId(0), Input::Unsent(MessageId::BLANK)),
    Work::Task(TaskId(0), Input::TimeOut { id: TimeId(0), turn: 0 }),
    Work::Arm(TaskId(0), TimeId(0), 0, Ticks::ZERO),
    Work::Disarm(TaskId(0), TimeId(0)),
    Work::Task(TaskId(0), Input::PeerRestarted(NodeId(0))),
    Work::Pass(TaskId(0), Ticks::ZERO),
];

impl Node {
    /// Walks the effects that are not carried out yet. An input that [`begin`](Self::begin) was given and
    /// [`proceed`](Self::proceed) has not handed on has no packed form.
    pub fn walk_work<W: Walk>(&mut self, w: &mut W) {
        let count = w.count(self.work.len());
        if W::READS {
            self.work.clear();
            self.work.resize(count, Work::Route(Packet::BLANK));
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
        let task = match self {
            // It says itself from whom it is.
            Self::Route(packet) => &mut { packet.source },
            Self::Task(task, _) | Self::Pass(task, _) | Self::Arm(task, ..) | Self::Disarm(task, _) => task,
        };
        w.small(&mut task.0);
        let task = *task;
        // One thread drives a packed node: no word of an earlier start of a delay can still be on its way.
        match self {
            Self::Route(packet) | Self::Task(_, Input::Packet(packet)) => packet.walk(w),
            Self::Task(_, Input::Unsent(id)) => {
                w.byte(&mut id.incarnation.0);
                w.sequence(task, &mut id.sequence);
            }
            Self::Task(_, Input::TimeOut { id, turn: _ }) | Self::Disarm(_, id) => w.byte(&mut id.0),
            Self::Arm(_, id, _, length) => {
                w.byte(&mut id.0);
                length.0 = w.count(usize::try_from(length.0).unwrap_or(usize::MAX)) as u64;
            }
            Self::Pass(_, elapsed) => {
                let mut ticks = u32::try_from(elapsed.0).unwrap_or(u32::MAX);
                w.number(&mut ticks);
                *elapsed = Ticks(ticks.into());
            }
            Self::Task(_, Input::PeerRestarted(node)) => w.small(&mut node.0),
            Self::Task(_, Input::Time | Input::Request(_)) => {}
        }
    }
}
