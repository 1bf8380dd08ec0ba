//! What a node does at one time, in every order in which its threads may do it (D170).
//!
//! Each communication task takes its inputs one after the other, and what follows from one is carried out by the thread that
//! brought it. So of two tasks that have something to do at the same time either may be first, and what the first one sends to the
//! second may come before or after what that one does. A checker lets time pass with [`let_pass`](Node::let_pass),
//! takes the inputs of tasks that wait in any of the orders that [`open`](Node::open) says, by [`take`](Node::take), and files
//! what came of each with [`file`](Node::file).

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
    /// The time that the task has not noticed.
    Time,
    /// The Timer's word.
    Timer,
    /// Another task, or the node.
    Others,
}

impl Node {
    /// Time passes as by [`NodeInput::Time`](super::NodeInput::Time), but what it makes tasks do waits.
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

    /// Carries out all effects but the inputs of tasks, which stay in their order: what goes to links or to the Timer is in
    /// nobody's way.
    pub fn file(&mut self, out: &mut impl NodeOutbox) {
        let mut inputs = VecDeque::new();
        while let Some(work) = self.work.pop_front() {
            match work {
                Work::Task(..) | Work::Pass(..) => inputs.push_back(work),
                // For a task of this node it comes back as its input.
                Work::Route(_) => self.carry_out(work, out),
                Work::Arm(task, id, ..) | Work::Disarm(task, id) => {
                    // The Timer's word of an earlier start says nothing to the task any more: a packed state has no such word.
                    inputs.retain(|input| !input.is_word_of(task, id));
                    self.carry_out(work, out);
                }
            }
        }
        self.work = inputs;
    }

    /// Sorts the inputs that wait by their tasks and kinds: only the order of those of one kind of one task matters.
    pub fn sort_inputs(&mut self) {
        self.work.make_contiguous().sort_by_key(Work::stream);
    }

    /// The positions of the inputs that may be taken next. A task first notices the time. Then the Timer's words come to it in
    /// their order, and what others bring in theirs: of those two either may be first.
    pub fn open(&self) -> impl Iterator<Item = usize> {
        let is_open = |&at: &usize| {
            let (task, kind) = self.work[at].stream();
            let earlier = self.work.iter().take(at).any(|other| other.stream() == (task, kind));
            !earlier
                && (kind == Kind::Time || !self.work.iter().any(|other| other.stream() == (task, Kind::Time)))
        };
        (0..self.work.len()).filter(is_open)
    }

    /// How many inputs of tasks wait, once all else is [filed](Self::file).
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.work.len()
    }

    /// The task that takes the input at a position, and what that is.
    #[must_use]
    pub fn waiting(&self, at: usize) -> Option<(TaskId, Input)> {
        match *self.work.get(at)? {
            Work::Pass(task, _) => Some((task, Input::Time)),
            Work::Task(task, input) => Some((task, input)),
            Work::Route(_) | Work::Arm(..) | Work::Disarm(..) => None,
        }
    }

    /// How much time has passed that a task has not noticed.
    #[must_use]
    pub fn late(&self, task: TaskId) -> Ticks {
        let of_task = self.work.iter().map(|work| match work {
            Work::Pass(of, elapsed) if *of == task => *elapsed,
            _ => Ticks::ZERO,
        });
        of_task.fold(Ticks::ZERO, |all, one| all + one)
    }

    /// A task takes the input that waits at a position.
    pub fn take(&mut self, at: usize, out: &mut impl NodeOutbox) {
        if let Some(work) = self.work.remove(at) {
            self.carry_out(work, out);
        }
    }
}

impl Work {
    /// The task that takes it, and what kind of input it is.
    const fn stream(&self) -> (Option<TaskId>, Kind) {
        match self {
            Self::Pass(task, _) => (Some(*task), Kind::Time),
            Self::Task(task, Input::TimeOut { .. }) => (Some(*task), Kind::Timer),
            Self::Task(task, _) => (Some(*task), Kind::Others),
            Self::Route(_) | Self::Arm(..) | Self::Disarm(..) => (None, Kind::Others),
        }
    }

    /// Whether it is the Timer's word of a task's delay or timer.
    fn is_word_of(&self, task: TaskId, id: TimeId) -> bool {
        matches!(*self, Self::Task(of, Input::TimeOut { id: word, .. }) if (of, word) == (task, id))
    }
}
