//! What a machine wants done, and by whom. Filled under a lock, carried out after it, by the thread that held it (D39).

use crate::clock::Micros;
use crate::script::Deed;
use imrs_protocol::{Input, Packet, TaskId, Ticks, TimeId};
use std::collections::VecDeque;

/// An input and when it happened.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stamped {
    pub at: Micros,
    pub input: Input,
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum Effect {
    /// The route layer takes the packet; its remaining time was true then.
    Transmit(Micros, Packet),
    /// Another machine of the node has something for a communication task.
    Feed(TaskId, Stamped),
    /// A communication task has something in its inbox.
    Nudge(TaskId),
    Arm(Micros, TaskId, TimeId, u8, Ticks),
    Disarm(Micros, TaskId, TimeId),
}

/// The effects that one thread has still to carry out. Each thread has its own and keeps it: once it has grown to its
/// size, nothing is allocated.
#[derive(Debug)]
pub(crate) struct Effects {
    pub queue: VecDeque<Effect>,
    /// What scripts want done outside.
    pub deeds: VecDeque<Deed>,
    /// How many steps scripts took since something came from outside of the node.
    pub steps: u32,
    /// Whether what is sent waits for more, and how many packets of this thread do.
    pub holds: bool,
    pub held: usize,
    /// The task whose thread this is, if it waits for what it asks.
    pub waiter: Option<TaskId>,
}

impl Effects {
    pub fn new(waiter: Option<TaskId>) -> Self {
        Self { queue: VecDeque::with_capacity(256), waiter, ..Self::of_an_onlooker() }
    }

    /// For a thread that only looks, and rarely finds work that others left it.
    pub fn of_an_onlooker() -> Self {
        Self { queue: VecDeque::new(), deeds: VecDeque::new(), steps: 0, holds: false, held: 0, waiter: None }
    }
}
