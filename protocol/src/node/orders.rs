//! Explores the orders in which the threads of a node may handle what happens at one time (D170).
//!
//! Each communication task takes its inputs one after the other, and the thread that brought an input carries out its
//! effects. If two tasks have an input at the same time, either may be first. A message of the first task to the second
//! may arrive before or after the second task's own input. A checker lets time pass with [`let_pass`](Node::let_pass), takes
//! one of the inputs that [`open`](Node::open) lists by [`take`](Node::take), and routes its effects with
//! [`file`](Node::file).

use super::work::Work;
use super::{Node, NodeOutbox};
use crate::ids::TaskId;
use crate::request::TimeId;
use crate::task::Input;
use crate::ticks::{Instant, Ticks};
use alloc::collections::VecDeque;

/// Who brings an input to a task.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    /// Time has passed that the task has not handled.
    Time,
    /// The node's Timer, which reports that a delay or timer has ended.
    Timer,
    /// Another task, or the node.
    Others,
}

impl Node {
    /// Lets time pass as [`NodeInput::Time`](super::NodeInput::Time) does, but queues the passed time as an input of each task
    /// that then has something due.
    pub fn let_pass(&mut self, now: Instant, out: &mut impl NodeOutbox) {
        let Some(elapsed) = self.begin_time(now, out) else { return };
        for at in 0..self.parts.tasks.len() {
            let task = &self.parts.tasks[at];
            let work = Work::Pass(task.task(), elapsed);
            if task.next_deadline() <= task.now() + elapsed {
                self.work.push_back(work);
            } else {
                self.carry_out(work, out);
            }
        }
        self.pass_in_timer(elapsed);
    }

    /// Carries out all pending effects except inputs of tasks, which stay queued in their order. Effects on links and on the
    /// Timer need no interleaving.
    pub fn file(&mut self, out: &mut impl NodeOutbox) {
        let mut inputs = VecDeque::new();
        while let Some(work) = self.work.pop_front() {
            match work {
                Work::Task(..) | Work::Pass(..) => inputs.push_back(work),
                // A packet for a task of this node comes back as an input of that task.
                Work::Route(_) => self.carry_out(work, out),
                Work::Arm(task, id, ..) | Work::Disarm(task, id) => {
                    // The task ignores a time-out of an earlier start of this delay or timer, and a packed state cannot
                    // hold such a time-out.
                    inputs.retain(|input| !input.is_word_of(task, id));
                    self.carry_out(work, out);
                }
            }
        }
        self.work = inputs;
    }

    /// Sorts the queued inputs by task and kind: order matters only among inputs of the same task and kind.
    pub fn sort_inputs(&mut self) {
        self.work.make_contiguous().sort_by_key(Work::stream);
    }

    /// The positions of the inputs that may be taken next. A task handles passed time first. Then time-outs keep their order
    /// and inputs from others keep theirs, but the two sequences may interleave.
    pub fn open(&self) -> impl Iterator<Item = usize> {
        let is_open = |&at: &usize| {
            let (task, kind) = self.work[at].stream();
            let earlier = self.work.iter().take(at).any(|other| other.stream() == (task, kind));
            !earlier
                && (kind == Kind::Time || !self.work.iter().any(|other| other.stream() == (task, Kind::Time)))
        };
        (0..self.work.len()).filter(is_open)
    }

    /// How many inputs are queued, once all other effects are [filed](Self::file).
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.work.len()
    }

    /// The task and the input at a position.
    #[must_use]
    pub fn waiting(&self, at: usize) -> Option<(TaskId, Input)> {
        match *self.work.get(at)? {
            Work::Pass(task, _) => Some((task, Input::Time)),
            Work::Task(task, input) => Some((task, input)),
            Work::Route(_) | Work::Arm(..) | Work::Disarm(..) => None,
        }
    }

    /// How much passed time a task has not handled yet.
    #[must_use]
    pub fn late(&self, task: TaskId) -> Ticks {
        let of_task = self.work.iter().map(|work| match work {
            Work::Pass(of, elapsed) if *of == task => *elapsed,
            _ => Ticks::ZERO,
        });
        of_task.fold(Ticks::ZERO, |all, one| all + one)
    }

    /// Hands the queued input at a position to its task.
    pub fn take(&mut self, at: usize, out: &mut impl NodeOutbox) {
        if let Some(work) = self.work.remove(at) {
            self.carry_out(work, out);
        }
    }
}

impl Work {
    /// The task that takes this work as an input, and the kind of that input.
    const fn stream(&self) -> (Option<TaskId>, Kind) {
        match self {
            Self::Pass(task, _) => (Some(*task), Kind::Time),
            Self::Task(task, Input::TimeOut { .. }) => (Some(*task), Kind::Timer),
            Self::Task(task, _) => (Some(*task), Kind::Others),
            Self::Route(_) | Self::Arm(..) | Self::Disarm(..) => (None, Kind::Others),
        }
    }

    /// Whether this work is the time-out of this delay or timer of the task.
    fn is_word_of(&self, task: TaskId, id: TimeId) -> bool {
        matches!(*self, Self::Task(of, Input::TimeOut { id: word, .. }) if (of, word) == (task, id))
    }
}
