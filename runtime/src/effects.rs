//! What a machine wants done, and by whom. Filled under a lock, carried out after it, by the thread that held it (D39).

use crate::clock::{self, Micros};
use crate::script::Deed;
use imrs_protocol::{Input, Packet, TaskId, Ticks, TimeId};
use imrs_wire::envelope::MAX_PACKETS;
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
    /// Packets for links, and when their remaining times were true.
    pub leaving: Vec<(Micros, Packet)>,
    /// Whether they wait for more.
    pub holds: bool,
    /// The task whose thread this is, if it waits for what it asks.
    pub waiter: Option<TaskId>,
    /// What goes to scripts of the node, and what came in over a link with others.
    pub bundles: Bundles,
    /// The time of the turn at a script that this thread has; none between two turns.
    pub turn: Option<Micros>,
}

/// The most packets that a task takes in one turn, a script with one look at the clock (D112): what a datagram brings.
const BUNDLE: usize = MAX_PACKETS;

/// Packets for tasks of the node, tied together by who gets them: so that each task takes its own under one lock.
#[derive(Debug, Default)]
pub(crate) struct Bundles {
    /// By position among the node's tasks.
    of: Vec<VecDeque<Stamped>>,
    /// Those that hold something, in the order in which they began to. Once for every [`BUNDLE`] of packets.
    full: VecDeque<usize>,
    /// An empty one.
    spare: VecDeque<Stamped>,
}

impl Bundles {
    pub fn push(&mut self, place: usize, stamped: Stamped) {
        if self.of.len() <= place {
            self.of.resize_with(place + 1, VecDeque::new);
        }
        let bundle = &mut self.of[place];
        if bundle.len().is_multiple_of(BUNDLE) {
            self.full.push_back(place);
        }
        bundle.push_back(stamped);
    }

    pub fn is_empty(&self) -> bool {
        self.full.is_empty()
    }

    /// Takes out what one task gets next. To be [given back](Self::give_back) empty.
    pub fn pop(&mut self) -> Option<(usize, VecDeque<Stamped>)> {
        let place = self.full.pop_front()?;
        let bundle = self.of.get_mut(place)?;
        let mut next = std::mem::take(&mut self.spare);
        if bundle.len() > BUNDLE {
            next.extend(bundle.drain(..BUNDLE));
        } else {
            std::mem::swap(bundle, &mut next);
        }
        Some((place, next))
    }

    pub fn give_back(&mut self, empty: VecDeque<Stamped>) {
        self.spare = empty;
    }
}

impl Effects {
    pub fn new(waiter: Option<TaskId>) -> Self {
        Self {
            queue: VecDeque::with_capacity(256),
            leaving: Vec::with_capacity(MAX_PACKETS),
            waiter,
            ..Self::of_an_onlooker()
        }
    }

    /// For a thread that only looks, and sometimes finds work that others left it.
    pub fn of_an_onlooker() -> Self {
        Self {
            queue: VecDeque::new(),
            deeds: VecDeque::new(),
            steps: 0,
            leaving: Vec::new(),
            holds: false,
            waiter: None,
            bundles: Bundles::default(),
            turn: None,
        }
    }

    /// Whether there is nothing to carry out.
    pub fn is_done(&self) -> bool {
        self.queue.is_empty() && self.deeds.is_empty() && self.bundles.is_empty() && self.leaving.is_empty()
    }

    /// The time of this turn at a script: the next whole microsecond when it began.
    pub fn time_of_turn(&mut self) -> Micros {
        *self.turn.get_or_insert_with(clock::next)
    }
}
