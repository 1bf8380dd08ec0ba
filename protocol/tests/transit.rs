//! The transit buffer of a node (§5.1.1, §5.2.3; D19, D60).

use crate::support;
use crate::support::NextExpiry;
use imrs_protocol::rules::Eviction;
use imrs_protocol::*;
use proptest::prelude::*;
use std::sync::Arc;

const NEAR: NodeId = NodeId(1);
const FAR: NodeId = NodeId(2);

/// A node that is linked to nodes 1 and 2, four ticks away each. Tasks 0 and 1 are on node 0, task 2 on node 1, 3 on node 2.
fn table(eviction: Eviction) -> NodeTable {
    let mut cell = Cell::new("star", Ticks(1));
    cell.rules.eviction = eviction;
    let [hub, near, far] = ["hub", "near", "far"].map(|name| cell.node(name));
    cell.link(hub, near, Ticks(4));
    cell.link(hub, far, Ticks(4));
    for (name, node) in [("a", hub), ("b", hub), ("c", near), ("d", far)] {
        cell.task(name, node);
    }
    let users = [TaskId(2), TaskId(3)];
    cell.port(PortDecl::new("status", TaskId(0), Usage::Send, &users, Ticks(90)));
    cell.port(PortDecl::new("command", TaskId(0), Usage::Send, &users, Ticks(90)).command());
    NodeTable::new(Arc::new(CellTable::new(cell).expect("a checked cell")), NodeId(0))
}

/// The buffer's effects: notices that a copy never left, packets, and drops with the packet's sequence number.
#[derive(Default, Debug, PartialEq)]
struct Out {
    unsent: Vec<(TaskId, u32)>,
    words: Vec<String>,
    drops: Vec<(Reason, u32)>,
}

impl RouteOutbox for Out {
    fn unsent(&mut self, task: TaskId, id: MessageId) {
        self.unsent.push((task, id.sequence.get()));
    }
    fn transmit(&mut self, packet: Packet) {
        self.words.push(support::packet(&packet));
    }
    fn observe(&mut self, observation: Observation) {
        if let Event::Discarded(reason) = observation.event {
            self.drops.push((reason, observation.number));
        }
    }
}

fn packet(class: Class, number: u32, to: NodeId, ttl: u64) -> Packet {
    Packet {
        kind: Kind::Send,
        class,
        more: false,
        resent: false,
        hops: MAX_HOPS,
        fragment: 0,
        destination: TaskId(to.0 + 1),
        source: TaskId(0),
        port: PortId(u16::from(class == Class::Command)),
        id: MessageId { incarnation: Incarnation(0), sequence: Seq24::new(number) },
        remaining: Ticks(ttl),
        contents: Contents::EMPTY,
        seal: Seal::NONE,
    }
}

fn status(number: u32, ttl: u64) -> Packet {
    packet(Class::Status, number, NEAR, ttl)
}

fn command(number: u32, ttl: u64) -> Packet {
    packet(Class::Command, number, NEAR, ttl)
}

struct Rig {
    table: NodeTable,
    transit: Transit,
}

impl Rig {
    fn new(capacity: u16) -> Self {
        Self::with(capacity, Eviction::ByClass)
    }

    fn with(capacity: u16, eviction: Eviction) -> Self {
        Self { table: table(eviction), transit: Transit::new(capacity) }
    }

    fn offer(&mut self, packet: Packet) -> Out {
        let mut out = Out::default();
        self.transit.offer(&self.table, packet, &mut out);
        out
    }

    fn advance(&mut self, ticks: u64) -> Out {
        let mut out = Out::default();
        self.transit.advance(&self.table, self.transit.now() + Ticks(ticks), &mut out);
        out
    }

    /// Takes out all waiting packets in the order in which they leave. Returns the number and the remaining time of each.
    fn drain(&mut self) -> Vec<(u32, u64)> {
        let next = || self.transit.next(|_| true).map(|(_, p)| (p.id.sequence.get(), p.remaining.0));
        std::iter::from_fn(next).collect()
    }

    fn packed(&mut self, frame: &Frame<'_>) -> Result<Vec<u8>, Overflow> {
        Encode::bytes(frame, |w| self.transit.walk(&self.table, w))
    }
}

#[test]
fn the_smallest_time_out_leaves_first_and_its_residence_is_charged() {
    let mut rig = Rig::new(8);
    for (number, ttl) in [(1, 30), (2, 20), (3, 25)] {
        rig.offer(status(number, ttl));
    }
    rig.offer(command(4, 25));
    assert_eq!(rig.transit.next_expiry(), Some(Ticks(16)), "four ticks of way");
    assert_eq!(rig.transit.view().min_slack, Some(Ticks(20)));
    rig.advance(5);
    assert_eq!(
        rig.drain(),
        [(2, 15), (4, 20), (3, 20), (1, 25)],
        "commands before status of the same urgency"
    );
    assert!(rig.transit.is_empty());
    assert_eq!((rig.transit.view().forwarded, rig.transit.next_expiry()), (4, None));
}

#[test]
fn equal_urgency_leaves_in_the_order_of_arrival() {
    let mut rig = Rig::new(8);
    for number in 0..8 {
        rig.offer(status(number, 20));
    }
    assert_eq!(rig.drain().iter().map(|&(n, _)| n).collect::<Vec<_>>(), (0..8).collect::<Vec<_>>());
}

#[test]
fn a_busy_link_holds_up_only_its_own_packets() {
    let mut rig = Rig::new(8);
    rig.offer(packet(Class::Status, 1, NEAR, 10));
    rig.offer(packet(Class::Status, 2, FAR, 30));
    rig.offer(packet(Class::Status, 3, FAR, 20));
    assert_eq!(rig.transit.view().next, [NEAR, FAR]);
    let mut open = |node| rig.transit.next(|next| next == node).map(|(next, p)| (next, p.id.sequence.get()));
    assert_eq!(open(FAR), Some((FAR, 3)));
    assert_eq!(open(FAR), Some((FAR, 2)));
    assert_eq!(open(FAR), None);
    assert_eq!(open(NEAR), Some((NEAR, 1)));
}

#[test]
fn what_can_arrive_no_more_is_dropped_and_its_task_knows_that_it_never_left() {
    let mut rig = Rig::new(8);
    rig.offer(status(1, 10));
    rig.offer(command(2, 10));
    // The link delay is up to four ticks, so a packet with less time left is dropped.
    assert_eq!(rig.advance(5), Out::default());
    let out = rig.advance(1);
    assert_eq!(out.drops, [(Reason::ExpiredInTransit, 2), (Reason::ExpiredInTransit, 1)]);
    assert_eq!((out.unsent, out.words), (vec![(TaskId(0), 2)], vec![]));
    assert_eq!(rig.transit.view().discarded[Reason::ExpiredInTransit as usize], 2);
}

#[test]
fn the_command_of_another_node_only_counts_when_it_expires() {
    let mut rig = Rig::new(1);
    rig.offer(Packet { source: TaskId(3), ..command(2, 10) });
    let out = rig.advance(10);
    assert_eq!((out.unsent, out.words, out.drops.len()), (vec![], vec![], 1));
}

#[test]
fn status_makes_room_for_a_command_whatever_its_urgency() {
    let mut rig = Rig::new(3);
    rig.offer(status(1, 10));
    rig.offer(status(2, 12));
    rig.offer(command(3, 60));
    let out = rig.offer(command(4, 80));
    assert_eq!((out.drops, out.unsent, out.words), (vec![(Reason::Evicted, 2)], vec![], vec![]));
    assert_eq!(rig.drain(), [(1, 10), (3, 60), (4, 80)]);
}

#[test]
fn of_status_the_packet_with_most_time_left_goes_the_newcomer_included() {
    let mut rig = Rig::new(2);
    rig.offer(status(1, 20));
    rig.offer(status(2, 30));
    assert_eq!(rig.offer(status(3, 40)).drops, [(Reason::Refused, 3)]);
    assert_eq!(rig.offer(status(4, 25)).drops, [(Reason::Evicted, 2)]);
    assert_eq!(rig.drain(), [(1, 20), (4, 25)]);
}

#[test]
fn among_commands_the_least_urgent_is_refused_and_its_source_told() {
    let mut rig = Rig::new(2);
    rig.offer(command(1, 20));
    rig.offer(command(2, 30));
    let out = rig.offer(command(3, 40));
    assert_eq!((out.drops, out.unsent), (vec![(Reason::Refused, 3)], vec![(TaskId(0), 3)]));
    assert_eq!(out.words, ["REFUSED ON THE WAY T2>T0 #3 for 40"]);
    let out = rig.offer(command(4, 25));
    assert_eq!((out.drops, out.unsent), (vec![(Reason::Evicted, 2)], vec![(TaskId(0), 2)]));
    assert_eq!(rig.offer(status(5, 5)).drops, [(Reason::Refused, 5)], "status never displaces a command");
    assert_eq!(rig.drain(), [(1, 20), (4, 25)]);
}

#[test]
fn what_cannot_arrive_in_time_any_more_takes_neither_room_nor_the_link() {
    let mut rig = Rig::new(2);
    let out = rig.offer(command(1, 4));
    assert_eq!(out.drops, [(Reason::ExpiredInTransit, 1)], "four ticks of way, four left");
    assert_eq!((out.unsent, out.words), (vec![(TaskId(0), 1)], vec![]));
    rig.offer(command(2, 7));
    rig.offer(status(3, 8));
    assert_eq!(rig.advance(3).drops, [(Reason::ExpiredInTransit, 2)]);
    assert!(rig.offer(status(4, 60)).drops.is_empty());
    assert_eq!(rig.drain(), [(3, 5), (4, 60)], "what can, if it goes now, goes first");
}

#[test]
fn each_goes_as_long_as_its_own_way_lets_it() {
    // The second link has a bound of five ticks, the first link one of four.
    let mut cell = Cell::new("line", Ticks(1));
    let [a, b, c] = ["a", "b", "c"].map(|name| cell.node(name));
    cell.link(a, b, Ticks(4));
    cell.link(b, c, Ticks(5));
    let tasks = [("x", a), ("y", b), ("z", c)].map(|(name, node)| cell.task(name, node));
    cell.port(PortDecl::new("p", tasks[0], Usage::Send, &tasks[1..], Ticks(50)));
    let table = NodeTable::new(Arc::new(CellTable::new(cell).expect("a checked cell")), a);
    let (mut transit, mut out) = (Transit::new(4), Out::default());
    for (number, to, ttl) in [(1, tasks[2], 12), (2, tasks[1], 10), (3, tasks[2], 11)] {
        let packet = Packet { destination: to, ..status(number, ttl) };
        transit.offer(&table, packet, &mut out);
    }
    transit.advance(&table, Instant(2), &mut out);
    assert_eq!(out.drops, [(Reason::ExpiredInTransit, 3)], "its way takes nine");
    transit.advance(&table, Instant(3), &mut out);
    assert_eq!(out.drops[1..], [(Reason::ExpiredInTransit, 1)]);
    assert_eq!(transit.next(|_| true).map(|(_, p)| (p.id.sequence.get(), p.remaining)), Some((2, Ticks(7))));
}

#[test]
fn a_packet_without_a_way_is_dropped() {
    let mut rig = Rig::new(2);
    let nowhere = Packet { destination: TaskId(9), ..status(1, 10) };
    assert_eq!(rig.offer(nowhere).drops, [(Reason::Unroutable, 1)]);
    let here = Packet { destination: TaskId(1), ..status(2, 10) };
    assert_eq!(rig.offer(here).drops, [(Reason::Unroutable, 2)]);
    assert!(rig.transit.is_empty());
}

#[derive(Clone, Debug)]
enum Step {
    Offer(bool, u64),
    Advance(u64),
    Next,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        5 => (any::<bool>(), 1..40_u64).prop_map(|(command, ttl)| Step::Offer(command, ttl)),
        2 => (0..12_u64).prop_map(Step::Advance),
        1 => Just(Step::Next),
    ];
    proptest::collection::vec(step, 1..60)
}

proptest! {
    /// No command that can still arrive is dropped for lack of space while the buffer holds status messages (D60). The
    /// clock may also be set back to zero at any moment.
    #[test]
    fn no_command_goes_for_space_while_status_is_held(steps in steps(), capacity in 1..5_u16, mask: u64) {
        let (mut rig, mut rebased) = (Rig::new(capacity), Rig::new(capacity));
        for (number, step) in steps.into_iter().enumerate() {
            let number = u32::try_from(number).unwrap();
            if mask >> (number % 64) & 1 == 1 {
                rebased.transit.rebase(&rebased.table);
            }
            let (out, same) = match step {
                Step::Offer(is_command, ttl) => {
                    let p = if is_command { command(number, ttl) } else { status(number, ttl) };
                    let before = rig.transit.waiting();
                    let (out, same) = (rig.offer(p), rebased.offer(p));
                    for &(_, dropped) in &out.drops {
                        let all = before.iter().chain([&p]);
                        let lost = all.clone().find(|p| p.id.sequence.get() == dropped).unwrap();
                        let status_held = rig.transit.waiting().iter().any(|p| p.class == Class::Status);
                        let could = lost.class == Class::Command && lost.remaining > Ticks(4);
                        prop_assert!(!(could && status_held), "{:?} was dropped", lost);
                    }
                    prop_assert!(out.drops.len() <= 1 && rig.transit.len() <= usize::from(capacity));
                    let useless = out.drops.iter().any(|&(reason, _)| reason == Reason::ExpiredInTransit);
                    prop_assert_eq!(useless, ttl <= 4);
                    prop_assert!(out.drops.is_empty() || useless || rig.transit.len() == usize::from(capacity));
                    (out, same)
                }
                Step::Advance(ticks) => (rig.advance(ticks), rebased.advance(ticks)),
                Step::Next => {
                    prop_assert_eq!(rebased.transit.next(|_| true), rig.transit.next(|_| true));
                    continue;
                }
            };
            prop_assert_eq!(same, out);
            prop_assert!(rig.transit.waiting().iter().all(|p| p.remaining > Ticks(4)), "all can arrive");
            prop_assert_eq!(rebased.transit.waiting(), rig.transit.waiting());
            prop_assert_eq!(rebased.transit.next_expiry(), rig.transit.next_expiry());
        }
    }
}

#[test]
fn a_full_buffer_says_so_without_dropping_another_command() {
    let mut rig = Rig::new(1);
    rig.offer(command(1, 20));
    let out = rig.offer(Packet { source: TaskId(3), ..command(2, 30) });
    let word = out.words.first().expect("the source hears of it");
    assert_eq!(word, "REFUSED ON THE WAY T2>T3 #2 for 30");
    // The refusal is a packet for a task of another node. It enters the same buffer, where refusals have their own queue.
    let said = Control::RefusedOnTheWay.to_contents();
    let word = Packet {
        kind: Kind::Control,
        source: TaskId(2),
        destination: TaskId(3),
        contents: said,
        ..command(2, 30)
    };
    for number in 0..4 {
        let id = MessageId { sequence: Seq24::new(number), ..word.id };
        let drops = rig.offer(Packet { id, ..word }).drops;
        // A buffer for one message has space for one refusal.
        let expected = if number == 0 { vec![] } else { vec![(Reason::Refused, number)] };
        assert_eq!(drops, expected);
    }
    assert_eq!((rig.transit.len(), rig.transit.words().len(), rig.transit.is_full()), (1, 1, true));
    assert_eq!(rig.drain(), [(1, 20), (0, 30)], "the word leaves when it is the most urgent");
    rig.offer(word);
    assert_eq!(rig.advance(30).drops, [(Reason::ExpiredInTransit, 2)]);
}

#[test]
fn by_time_alone_a_command_makes_room_for_a_status() {
    let mut rig = Rig::with(1, Eviction::ByTime);
    rig.offer(command(1, 30));
    assert_eq!(rig.offer(status(2, 20)).drops, [(Reason::Evicted, 1)]);
    assert_eq!(rig.offer(command(3, 25)).drops, [(Reason::Refused, 3)]);
}

#[test]
fn what_waits_comes_back_from_its_packed_form() {
    let mut rig = Rig::new(4);
    rig.offer(command(1, 20));
    rig.offer(status(2, 12));
    let said = Control::RefusedOnTheWay.to_contents();
    let (source, destination) = (TaskId(2), TaskId(3));
    rig.offer(Packet { kind: Kind::Control, source, destination, contents: said, ..command(3, 9) });
    rig.advance(4);
    let next = [Seq24::new(9); 5];
    let frame = Frame { rounds: &[], sequences: &next, incarnations: false };
    let bytes = rig.packed(&frame).expect("it fits");
    let mut back = Rig::new(4);
    back.offer(status(7, 7));
    assert_eq!(Decode::read(&bytes, false, |r| back.transit.walk(&back.table, r)), bytes.len());
    let left = |rig: &Rig| {
        [rig.transit.waiting(), rig.transit.words()]
            .map(|l| l.iter().map(|p| p.remaining).collect::<Vec<_>>())
    };
    assert_eq!(left(&back), left(&rig));
    let shifted = [Frame::SEQUENCE; 5];
    let frame = Frame { rounds: &[], sequences: &shifted, incarnations: false };
    assert_eq!(back.packed(&frame), Ok(bytes));
}

#[test]
fn of_equal_urgency_a_refusal_leaves_before_a_message() {
    let mut rig = Rig::new(8);
    rig.offer(command(1, 20));
    let said = Control::RefusedOnTheWay.to_contents();
    let (source, destination) = (TaskId(2), TaskId(3));
    rig.offer(Packet { kind: Kind::Control, source, destination, contents: said, ..command(2, 20) });
    assert_eq!(rig.drain(), [(2, 20), (1, 20)]);
}

#[test]
fn more_packets_than_the_packed_count_holds_are_an_overflow() {
    let mut rig = Rig::new(128);
    (0..127).for_each(|number| _ = rig.offer(command(number, 20)));
    let next = [Seq24::new(200); 5];
    let frame = Frame { rounds: &[], sequences: &next, incarnations: false };
    assert!(rig.packed(&frame).is_ok());
    rig.offer(command(127, 20));
    assert!(rig.transit.is_full() && rig.packed(&frame).is_err(), "bit 7 says that words follow");
}

proptest! {
    /// `pass` has the same effects as `offer` followed by `next`, whatever waits and whichever links are ready.
    #[test]
    fn to_pass_is_to_be_offered_and_to_leave(
        before in prop_oneof![Just(Vec::new()), steps()], ttl in 0..20_u64, asks: bool, far: bool, mask in 0..4_u64,
    ) {
        let class = if asks { Class::Command } else { Class::Status };
        let packet = packet(class, 99, if far { FAR } else { NEAR }, ttl);
        let ready = |node: NodeId| mask >> (node.0 - 1) & 1 == 1;
        let mut rig = Rig::new(4);
        for (number, step) in (0..).zip(before) {
            match step {
                Step::Offer(true, ttl) => drop(rig.offer(command(number, ttl))),
                Step::Offer(false, ttl) => drop(rig.offer(status(number, ttl))),
                Step::Advance(ticks) => drop(rig.advance(ticks)),
                Step::Next => drop(rig.transit.next(|_| true)),
            }
        }
        let (mut short, mut long) = (rig.transit.clone(), rig.transit);
        let (mut one, mut other) = (Out::default(), Out::default());
        let alone = short.is_empty();
        let passed = short.pass(&rig.table, packet, ready, &mut one);
        long.offer(&rig.table, packet, &mut other);
        let left = if alone { long.next(ready) } else { None };
        prop_assert_eq!(passed, left);
        prop_assert_eq!(one, other);
        prop_assert_eq!(short.view(), long.view());
        prop_assert_eq!(short.waiting(), long.waiting());
    }
}
