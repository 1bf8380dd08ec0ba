//! The effects that a state machine asks for: collected under its lock, and carried out after the release by the thread
//! that held the lock (D39).

mod slot;

use crate::clock::{self, Micros};
use crate::link::udp::SEGMENTS;
use crate::node::home::Home;
use crate::script::OutsideEffect;
use imrs_protocol::{Input, Packet, TaskId, Ticks, TimeId};
use imrs_wire::envelope::MAX_PACKETS;
use std::collections::VecDeque;

/// An input, and the instant at which it happened.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stamped {
    pub at: Micros,
    pub input: Input,
}

/// An input for a member of a domain.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Addressed {
    pub member: usize,
    pub stamped: Stamped,
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum Effect {
    /// The route layer gets the packet, whose remaining time was true at this instant.
    Transmit(Micros, Packet),
    /// A communication task gets input from another state machine of the node.
    Feed(TaskId, Stamped),
    /// A communication task has input in its inbox and must handle it.
    Wake(TaskId),
    Arm(Micros, TaskId, TimeId, u8, Ticks),
    Disarm(Micros, TaskId, TimeId),
}

/// Inputs that members of a domain have for each other, in the order in which they were sent.
#[derive(Debug, Default)]
pub(crate) struct Inside {
    /// The receiver and the kind of each entry. Most entries are signals between scripts, so an entry is small.
    order: VecDeque<(Home, What)>,
    /// The inputs of the entries of kind `Input`, in the same order.
    inputs: VecDeque<Stamped>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum What {
    Input,
    /// A mark: a fused step (one that replaces several small steps) has given a signal to the member's script.
    Told,
}

impl Inside {
    pub fn send(&mut self, to: Home, input: Stamped) {
        self.order.push_back((to, What::Input));
        self.inputs.push_back(input);
    }

    /// Notes that a fused step (one that replaces several small steps) has given a signal to the member's script.
    pub fn told(&mut self, to: Home) {
        self.order.push_back((to, What::Told));
    }

    /// Whether there is input for a member.
    #[inline]
    pub fn has_input_for(&self, to: Home) -> bool {
        !self.inputs.is_empty() && self.order.contains(&(to, What::Input))
    }

    /// The receiver of the first entry.
    pub fn first(&self) -> Option<Home> {
        self.order.front().map(|&(to, _)| to)
    }

    /// Takes the first entry, if it is for a member of this domain. The input is `None` if the entry is a signal for
    /// the member's script.
    pub fn take(&mut self, domain: usize) -> Option<(Home, Option<Stamped>)> {
        let (to, what) = self.order.pop_front_if(|(to, _)| to.domain() == domain)?;
        Some((to, if what == What::Input { self.inputs.pop_front() } else { None }))
    }

    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }
}

/// The effects that one thread still has to carry out. Each thread keeps its own `Effects`: once they have grown to
/// their size, nothing is allocated.
#[derive(Debug)]
pub(crate) struct Effects {
    pub queue: VecDeque<Effect>,
    pub inside: Inside,
    /// The positions on the node of the futures that have an answer to take.
    pub called: Vec<usize>,
    /// Whether this is the thread of the node's futures.
    pub of_the_futures: bool,
    /// Actions that scripts begin or end.
    pub outside: VecDeque<OutsideEffect>,
    /// How many steps scripts took since the last input from outside of the node.
    pub steps: u32,
    /// Packets for links, each with the instant at which its remaining time was true.
    pub leaving: Vec<(Micros, Packet)>,
    /// Whether the packets in `leaving` are kept until later packets can leave with them.
    pub holds: bool,
    /// The task whose own thread this is, if this thread waits for answers.
    pub waiter: Option<TaskId>,
    /// Packets for scripts of the node, and packets that came over a link together with others.
    pub bundles: Bundles,
    /// The instant of this thread's current turn for scripts; `None` between two turns.
    pub turn: Option<Micros>,
}

/// The most packets that a task takes in one turn: as many as a datagram brings. A script reads the clock once for all
/// of them (D112).
const BUNDLE: usize = MAX_PACKETS;

/// The most packets that a link of this crate hands over in one call: the packets of all datagrams that left in one
/// call (D129).
const RECEIVED: usize = MAX_PACKETS * SEGMENTS;

/// Packets for tasks of the node, grouped by task, so that each task takes its packets under one lock. A receiving thread
/// allocates the room for them when it starts, because many packets may arrive together for the first time after hours.
#[derive(Debug)]
pub(crate) struct Bundles {
    /// The held inputs, each with the index of the next input for the same task. A free entry has the index of the
    /// next free entry.
    held: Vec<(Addressed, usize)>,
    /// The index of the first free entry; an index past the end if no entry is free.
    free: usize,
    /// The bundle of each task, by its position among the node's tasks.
    of: Vec<Bundle>,
    /// The tasks that have held inputs, in the order in which the inputs came. A task is listed once for every
    /// [`BUNDLE`] of its inputs.
    full: VecDeque<usize>,
    /// An empty queue, kept so that the next call of `pop` need not allocate one.
    spare: VecDeque<Addressed>,
}

/// The inputs that are held for one task.
#[derive(Clone, Copy, Debug, Default)]
struct Bundle {
    first: usize,
    last: usize,
    count: usize,
}

impl Bundles {
    /// Makes room for this many packets for this many tasks; the room grows if needed.
    fn with_room(packets: usize, tasks: usize) -> Self {
        Self {
            held: Vec::with_capacity(packets),
            free: usize::MAX,
            of: vec![Bundle::default(); tasks],
            full: VecDeque::with_capacity(tasks + packets / BUNDLE),
            spare: VecDeque::with_capacity(packets.min(BUNDLE)),
        }
    }

    pub fn push(&mut self, place: usize, input: Addressed) {
        if self.of.len() <= place {
            self.of.resize(place + 1, Bundle::default());
        }
        let at = self.put(input);
        let bundle = &mut self.of[place];
        if bundle.count.is_multiple_of(BUNDLE) {
            self.full.push_back(place);
        }
        if bundle.count == 0 {
            bundle.first = at;
        } else {
            self.held[bundle.last].1 = at;
        }
        (bundle.last, bundle.count) = (at, bundle.count + 1);
    }

    fn put(&mut self, input: Addressed) -> usize {
        let at = self.free;
        if let Some(place) = self.held.get_mut(at) {
            self.free = place.1;
            place.0 = input;
            return at;
        }
        self.held.push((input, usize::MAX));
        self.held.len() - 1
    }

    pub fn is_empty(&self) -> bool {
        self.full.is_empty()
    }

    /// Takes a task's next inputs, as a queue. The caller must empty this queue and [give it back](Self::give_back).
    pub fn pop(&mut self) -> Option<(usize, VecDeque<Addressed>)> {
        let place = self.full.pop_front()?;
        let bundle = &mut self.of[place];
        let mut next = std::mem::take(&mut self.spare);
        for _ in 0..bundle.count.min(BUNDLE) {
            let (input, after) = self.held[bundle.first];
            next.push_back(input);
            self.held[bundle.first].1 = self.free;
            (self.free, bundle.first) = (bundle.first, after);
        }
        bundle.count -= next.len();
        Some((place, next))
    }

    pub fn give_back(&mut self, empty: VecDeque<Addressed>) {
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

    /// The effects of a thread that receives for this many tasks.
    pub fn of_a_receiver(tasks: usize) -> Self {
        Self { bundles: Bundles::with_room(RECEIVED, tasks), ..Self::new(None) }
    }

    /// The effects of a thread that only looks at tasks, and sometimes finds work that other threads left.
    pub fn of_an_onlooker() -> Self {
        Self {
            queue: VecDeque::new(),
            inside: Inside::default(),
            called: Vec::new(),
            of_the_futures: false,
            outside: VecDeque::new(),
            steps: 0,
            leaving: Vec::new(),
            holds: false,
            waiter: None,
            bundles: Bundles::with_room(0, 0),
            turn: None,
        }
    }

    /// Whether there is nothing to carry out.
    pub fn is_done(&self) -> bool {
        self.queue.is_empty()
            && self.inside.is_empty()
            && self.called.is_empty()
            && self.outside.is_empty()
            && self.bundles.is_empty()
            && self.leaving.is_empty()
    }

    /// The time of this turn for a script: the time at which the turn began, rounded up.
    pub fn time_of_turn(&mut self) -> Micros {
        *self.turn.get_or_insert_with(clock::next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::home::{Homes, RunBy};

    fn numbered(at: Micros) -> Addressed {
        Addressed { member: 0, stamped: Stamped { at, input: Input::Time } }
    }

    /// Puts `counts[i]` inputs for each task `i` into the bundles, and then takes all inputs out.
    fn through(bundles: &mut Bundles, counts: &[usize]) -> Vec<(usize, Vec<Micros>)> {
        // The inputs for several tasks are interleaved, as packets for several tasks are.
        let most = counts.iter().copied().max().unwrap_or(0);
        for number in 0..most {
            let places = (0..counts.len()).filter(|&place| number < counts[place]);
            places.for_each(|place| bundles.push(place, numbered(number as Micros)));
        }
        let mut out = Vec::new();
        while let Some((place, mut bundle)) = bundles.pop() {
            out.push((place, bundle.drain(..).map(|input| input.stamped.at).collect()));
            bundles.give_back(bundle);
        }
        assert!(bundles.is_empty());
        out
    }

    #[test]
    fn each_task_gets_its_own_in_order_and_no_more_than_a_bundle_at_once() {
        let mut bundles = Bundles::with_room(RECEIVED, 2);
        let many = BUNDLE as Micros;
        for _ in 0..3 {
            let out = through(&mut bundles, &[2 * BUNDLE + 1, 3]);
            let expected = [
                (0, (0..many).collect::<Vec<_>>()),
                (1, vec![0, 1, 2]),
                (0, (many..2 * many).collect()),
                (0, vec![2 * many]),
            ];
            assert_eq!(out, expected);
        }
        // This input is for a task beyond the number of tasks for which there is room.
        assert_eq!(through(&mut bundles, &[0, 0, 1]), [(2, vec![0])]);
    }

    #[test]
    fn what_is_inside_of_a_domain_comes_out_in_its_order() {
        let tasks = [RunBy::AnyThread, RunBy::AnyThread, RunBy::TheThreadOfFutures];
        let homes = Homes::new((0..).map(TaskId).zip(tasks), 3);
        let [a, b, c] = [0, 1, 2].map(|place| homes.at(place));
        let input = |at: Micros| Stamped { at, input: Input::Time };
        let mut inside = Inside::default();
        inside.told(a);
        inside.send(b, input(1));
        inside.told(b);
        inside.send(a, input(2));
        inside.send(c, input(3));
        assert!(inside.has_input_for(a) && inside.has_input_for(b));
        let out: Vec<_> = std::iter::from_fn(|| inside.take(a.domain())).collect();
        let out: Vec<_> = out.into_iter().map(|(to, input)| (to, input.map(|input| input.at))).collect();
        assert_eq!(out, [(a, None), (b, Some(1)), (b, None), (a, Some(2))]);
        assert!(!inside.has_input_for(a) && inside.has_input_for(c));
        assert_eq!(inside.first(), Some(c), "of another domain");
    }

    #[test]
    fn what_comes_and_goes_takes_no_more_room() {
        let mut bundles = Bundles::with_room(2, 1);
        for number in 0..1_000 {
            bundles.push(0, numbered(number));
            bundles.push(0, numbered(number + 1));
            let (_, mut bundle) = bundles.pop().expect("two");
            assert!(bundle.drain(..).map(|input| input.stamped.at).eq([number, number + 1]));
            bundles.give_back(bundle);
        }
        assert_eq!(bundles.held.len(), 2);
    }
}
