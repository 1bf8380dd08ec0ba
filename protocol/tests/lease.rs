//! Work-coupled tasks (R8; D30, D61): the echoed lease, the fence, the take-over, epochs.

use crate::support::{self, NextExpiry, Solo, get_on, send};
use imrs_protocol::rules::{LeaseRule, Rules};
use imrs_protocol::*;
use imrs_testkit::{ScriptedNode, VirtualCell};
use std::sync::Arc;

const P: TaskId = TaskId(0);
const S: TaskId = TaskId(1);
const ARM: TaskId = TaskId(2);
const NP: NodeId = NodeId(0);
const NS: NodeId = NodeId(1);

const ALIVE: PortId = PortId(0);
const MOVE: PortId = PortId(1);

const LEASE: u64 = 14;
const TAKEOVER: u64 = 32;
const EVERY: u64 = 4;

/// A cell with two robots and the arm that they command, on three nodes with links of one tick.
fn cell(mutual: bool) -> Cell {
    let mut cell = Cell::new("couple", Ticks(1));
    let nodes = ["p", "s", "a"].map(|name| cell.node(name));
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        cell.link(nodes[a], nodes[b], Ticks(1));
    }
    let [p, s, arm] = [("p", 0), ("s", 1), ("arm", 2)].map(|(name, on)| cell.task(name, nodes[on]));
    cell.port(PortDecl::new("alive", p, Usage::Response, &[s], Ticks(6)));
    cell.port(PortDecl::new("move", arm, Usage::Receive, &[p, s], Ticks(8)).bounded_buffer(4).guard(0));
    cell.couples.push(CoupleDecl {
        primary: p,
        standby: s,
        lease: Ticks(LEASE),
        takeover: Ticks(TAKEOVER),
        every: Ticks(EVERY),
        via: ALIVE,
        trusted: false,
        mutual,
    });
    cell
}

fn acting(net: &VirtualCell) -> [bool; 2] {
    [P, S].map(|task| net.task(task).is_active())
}

/// Runs tick by tick and returns when each robot began or stopped acting. Both must never act at the same time.
fn changes(net: &mut VirtualCell, ticks: u64) -> Vec<(u64, [bool; 2])> {
    let mut seen = vec![(net.now(), acting(net))];
    for _ in 0..ticks {
        net.run(1);
        let now = acting(net);
        assert_ne!(now, [true, true], "both act at {}", net.now());
        if now != seen[seen.len() - 1].1 {
            seen.push((net.now(), now));
        }
    }
    seen
}

/// A net in which the primary of the couple holds the lease.
fn leased(mutual: bool) -> VirtualCell {
    let mut net = VirtualCell::new(cell(mutual));
    net.ask(P, Request::Lease);
    net.run(12);
    assert_eq!(net.heard(P), ["granted 3"]);
    assert_eq!(acting(&net), [true, false]);
    net
}

#[test]
fn the_primary_acts_once_a_heartbeat_has_echoed_its_answer_and_the_lease_is_renewed() {
    let mut net = VirtualCell::new(cell(false));
    net.ask(P, Request::Lease);
    assert_eq!(changes(&mut net, 100), [(0, [false, false]), (5, [true, false])]);
    // A heartbeat leaves at instant 1, its answer at 3, and the heartbeat that echoes this answer at 4.
    assert_eq!(net.heard(P), ["granted 3"]);
    assert_eq!(net.heard(S), [""; 0]);
}

#[test]
fn with_the_link_cut_the_primary_is_fenced_and_the_standby_takes_over_later() {
    let mut net = leased(false);
    net.ask(S, Request::Work);
    net.ask(P, Request::Work);
    net.cut(NP, NS);
    let seen = changes(&mut net, 60);
    let [(_, _), (fenced, [false, false]), (taken, [false, true])] = seen[..] else { panic!("{seen:?}") };
    assert!(taken >= fenced + (TAKEOVER - LEASE), "fenced at {fenced}, taken over at {taken}");
    assert_eq!(net.heard(P), ["interrupt Fenced"]);
    assert_eq!(net.heard(S), ["interrupt TakeOver(4)"]);
    // In this couple the roles are not exchanged, so the former primary does not act again in this incarnation.
    net.mend();
    assert_eq!(changes(&mut net, 100).len(), 1);
    net.ask(P, send(MOVE, ARM, 1));
    assert_eq!(net.heard(P), ["fault Fenced"]);
}

#[test]
fn a_short_cut_changes_nothing() {
    let mut net = leased(false);
    net.cut(NP, NS);
    assert_eq!(changes(&mut net, 2).len(), 1);
    net.mend();
    assert_eq!(changes(&mut net, 60).len(), 1);
}

#[test]
fn a_standby_that_waits_for_the_lease_is_granted_it_by_the_take_over() {
    let mut net = leased(false);
    net.ask(S, Request::Lease);
    net.ask(P, Request::End);
    changes(&mut net, 60);
    assert_eq!(net.heard(S), ["granted 4"]);
    assert_eq!(acting(&net), [false, true]);
}

#[test]
fn a_restarted_standby_waits_for_the_whole_take_over() {
    let mut net = VirtualCell::new(cell(false));
    net.run(3);
    net.lose(|_, _, _| true);
    net.restart(NS, 1);
    let seen = changes(&mut net, 40);
    assert_eq!(seen, [(3, [false, false]), (3 + TAKEOVER, [false, true])]);
}

#[test]
fn a_restarted_primary_is_granted_a_fresh_lease_in_a_new_epoch() {
    let mut net = leased(false);
    net.restart(NP, 1);
    assert_eq!(acting(&net), [false, false]);
    changes(&mut net, 20);
    assert_eq!(acting(&net), [true, false]);
    assert_eq!(net.task(P).epoch(), Some(7));
}

#[test]
fn what_was_published_comes_with_the_answers() {
    let mut net = leased(false);
    let said = Contents::new(&[12, 1]).expect("short");
    net.ask(P, Request::Publish(said));
    net.run(10);
    let standby = net.task(S);
    assert_eq!(standby.partner_published(), Some(&said));
    net.ask(P, Request::Publish(Contents::new(&[0; 9]).expect("nine bytes")));
    net.ask(ARM, Request::Publish(said));
    net.ask(ARM, Request::Lease);
    assert_eq!(net.heard(P), ["accepted 0", "fault WrongLength"]);
    assert_eq!(net.heard(ARM), ["fault WrongUsage", "fault WrongUsage"]);
    // The arm is in no couple, so it is always active.
    assert!(net.task(ARM).is_active());
    assert_eq!(net.task(ARM).epoch(), None);
}

#[test]
fn with_exchanged_roles_the_former_primary_is_the_standby_of_the_one_that_took_over() {
    let mut net = leased(true);
    net.cut(NP, NS);
    let seen = changes(&mut net, 60);
    assert_eq!(seen[seen.len() - 1].1, [false, true]);
    net.mend();
    assert_eq!(changes(&mut net, 40).len(), 1, "nobody gives up what it has");
    net.cut(NP, NS);
    let seen = changes(&mut net, 80);
    let [_, (_, [false, false]), (_, [true, false])] = seen[..] else { panic!("{seen:?}") };
    assert_eq!(net.task(P).epoch(), Some(5));
}

#[test]
fn with_exchanged_roles_one_that_was_away_takes_over_from_nobody_it_never_heard() {
    let mut net = leased(true);
    net.cut(NP, NS);
    changes(&mut net, 60);
    assert_eq!(acting(&net), [false, true]);
    // The standby acts alone. The new incarnation of its partner cannot know whether the standby acts.
    net.restart(NP, 1);
    assert_eq!(changes(&mut net, 200).len(), 1);
    // The same holds for a standby that has never heard from its primary.
    let mut alone = VirtualCell::new(cell(true));
    alone.cut(NP, NS);
    assert_eq!(changes(&mut alone, 200).len(), 1);
}

#[test]
fn plain_heartbeats_let_both_act_when_only_the_answers_are_lost() {
    let mut cell = cell(false);
    cell.rules = Rules { lease: LeaseRule::Heartbeat, ..Rules::DEFAULT };
    let mut net = VirtualCell::new(cell);
    net.run(12);
    assert_eq!(acting(&net), [true, false]);
    net.lose(|from, to, _| from == NP && to == NS);
    net.run(TAKEOVER + 4);
    assert_eq!(acting(&net), [true, true]);
}

fn table(mutual: bool) -> Arc<CellTable> {
    Arc::new(CellTable::new(cell(mutual)).expect("a checked cell"))
}

/// A status message to the arm from the primary or the standby (`from`), which carries this epoch.
fn order(from: TaskId, sequence: u32, epoch: u8, what: u8) -> Packet {
    let mut packet = Solo::new(&table(false), ARM).nothing();
    packet.source = from;
    packet.id.sequence = Seq24::new(sequence);
    packet.contents = Contents::new(&[what, epoch]).expect("short");
    packet
}

trait Template {
    fn nothing(&self) -> Packet;
}

impl Template for Solo {
    fn nothing(&self) -> Packet {
        Packet {
            kind: Kind::Send,
            class: Class::Status,
            more: false,
            resent: false,
            hops: MAX_HOPS,
            fragment: 0,
            destination: ARM,
            source: P,
            port: MOVE,
            id: MessageId::default(),
            remaining: Ticks(8),
            contents: Contents::EMPTY,
            seal: Seal::NONE,
        }
    }
}

#[test]
fn an_actuator_drops_what_an_older_epoch_ordered_and_what_still_waits_of_it() {
    let mut arm = Solo::new(&table(false), ARM);
    arm.hear(order(P, 0, 1, 10));
    let newer = arm.hear(order(S, 0, 2, 20));
    assert_eq!(newer.discards(), [Reason::StaleEpoch], "what waited of the first epoch");
    assert_eq!(arm.hear(order(P, 1, 1, 11)).discards(), [Reason::StaleEpoch]);
    assert_eq!(arm.ask(get_on(MOVE, 0)).words(), ["message [20] from T1 for 8"]);
    assert_eq!(arm.ask(get_on(MOVE, 0)).words(), ["nothing"]);
    // No message of the first epoch can be in flight any more, so the arm accepts messages of a couple that began anew.
    arm.pass(8 + 1);
    assert_eq!(arm.hear(order(P, 2, 1, 12)).discards(), []);
    assert_eq!(arm.ask(get_on(MOVE, 0)).words(), ["message [12] from T0 for 8"]);
    // A message without an epoch cannot come from a task that acts under a lease.
    let bare = Packet { contents: Contents::EMPTY, ..order(P, 3, 1, 0) };
    assert_eq!(arm.hear(bare).discards(), [Reason::NotAllowed]);
}

/// The test compares the primary's last epoch before the wrap with the standby's first epoch after the wrap.
#[test]
fn an_actuator_compares_epochs_across_their_wrap() {
    let mut arm = Solo::new(&table(false), ARM);
    arm.hear(order(P, 0, 255, 10));
    assert_eq!(
        arm.hear(order(S, 0, 0, 20)).discards(),
        [Reason::StaleEpoch],
        "what waited of the older epoch"
    );
    assert_eq!(arm.hear(order(P, 1, 255, 11)).discards(), [Reason::StaleEpoch]);
    assert_eq!(arm.ask(get_on(MOVE, 0)).words(), ["message [20] from T1 for 8"]);
    assert_eq!(arm.ask(get_on(MOVE, 0)).words(), ["nothing"]);
}

/// Once the arm hears of a newer epoch of a couple on one port, all ports over which this couple sends drop older messages.
#[test]
fn a_guard_is_of_the_couple_whichever_port_an_order_comes_through() {
    let mut cell = cell(false);
    let port = PortDecl::new("grip", ARM, Usage::Receive, &[P, S], Ticks(8)).bounded_buffer(4).guard(0);
    let grip = cell.port(port);
    let free = cell.port(PortDecl::new("free", ARM, Usage::Receive, &[P], Ticks(8)).bounded_buffer(4));
    let table = Arc::new(CellTable::new(cell).expect("a checked cell"));
    let mut arm = Solo::new(&table, ARM);
    let through = |port, packet: Packet| Packet { port, ..packet };
    arm.hear(through(grip, order(P, 0, 1, 10)));
    arm.hear(through(free, order(P, 1, 1, 11)));
    assert_eq!(
        arm.hear(order(S, 0, 2, 20)).discards(),
        [Reason::StaleEpoch],
        "what waited on the other port"
    );
    assert_eq!(arm.hear(through(grip, order(P, 2, 1, 12))).discards(), [Reason::StaleEpoch]);
    assert_eq!(arm.ask(get_on(grip, 0)).words(), ["nothing"]);
    assert_eq!(arm.ask(get_on(free, 0)).words(), ["message [11, 1] from T0 for 8"]);
    assert_eq!(arm.ask(get_on(MOVE, 0)).words(), ["message [20] from T1 for 8"]);
}

/// The first two bytes of each answer to a heartbeat: the state of the primary, and its epoch.
fn said(seen: &support::Effects) -> Vec<[u8; 2]> {
    let answers = seen.packets.iter().filter(|packet| packet.kind == Kind::Response);
    answers.filter_map(|packet| packet.contents.as_bytes().first_chunk().copied()).collect()
}

/// A standby's heartbeat. It echoes the answer of the primary's incarnation `whose` to the heartbeat `back` numbers before.
fn heartbeat(sequence: u32, back: u8, epoch: u8, whose: u8) -> Packet {
    let contents = Contents::new(&[back, 0, epoch, whose]).expect("short");
    let id = MessageId { sequence: Seq24::new(sequence), ..MessageId::default() };
    let nothing = Solo::new(&table(false), ARM).nothing();
    let packet = Packet { kind: Kind::Query, class: Class::Command, destination: P, source: S, ..nothing };
    Packet { port: ALIVE, id, remaining: Ticks(6), contents, ..packet }
}

#[test]
fn an_echo_of_what_an_earlier_incarnation_answered_gives_no_lease() {
    for (whose, acts) in [(0, true), (1, false)] {
        let mut primary = Solo::new(&table(false), P);
        primary.hear(heartbeat(1, 0, 0, 0));
        primary.pass(1);
        primary.hear(heartbeat(2, 1, 3, whose));
        assert_eq!(primary.task.is_active(), acts, "an echo of life {whose}");
    }
}

#[test]
fn the_epoch_is_said_before_anybody_acts_in_it_and_a_proposal_is_kept_until_a_newer_one_is_heard_of() {
    let mut primary = Solo::new(&table(true), P);
    assert_eq!(said(&primary.hear(heartbeat(1, 0, 0, 0))), [[0, 3]]);
    assert_eq!(said(&primary.hear(heartbeat(2, 0, 3, 0))), [[0, 3]], "heard of, and not begun");
    assert!(!primary.task.is_active());
    // The standby took over in epoch 4 meanwhile, so the echo of an answer with epoch 3 has no effect.
    assert_eq!(said(&primary.hear(heartbeat(3, 1, 4, 0))), [[0, 5]]);
    assert!(!primary.task.is_active());
    assert_eq!(said(&primary.hear(heartbeat(4, 1, 5, 0))), [[1, 5]]);
    assert!(primary.task.is_active());
}

/// A heartbeat from a restarted standby that knows no epoch. It carries the epoch in which that standby would begin.
fn guess(sequence: u32, epoch: u8) -> Packet {
    let contents = Contents::new(&[0, 0, epoch, 0, 1]).expect("short");
    let id = MessageId { incarnation: Incarnation(1), sequence: Seq24::new(sequence) };
    Packet { id, contents, ..heartbeat(sequence, 0, epoch, 0) }
}

#[test]
fn nobody_takes_the_guess_of_a_node_that_started_again_for_news() {
    // From 130 on, epoch 2 compares as the newer epoch.
    for reached in [100, 130, 132, 200] {
        let mut primary = Solo::new(&table(true), P);
        primary.hear(heartbeat(1, 0, reached / 2, 0));
        assert_eq!(said(&primary.hear(heartbeat(2, 0, reached, 0))), [[0, reached + 1]]);
        assert_eq!(
            said(&primary.hear(guess(3, 2))),
            [[0, reached + 7]],
            "counted up, and not from the guess"
        );
    }
}

#[test]
fn a_node_that_started_again_takes_the_epoch_of_one_that_knows_it() {
    for reached in [0, 100, 130, 132, 200] {
        let mut primary = Solo::incarnation(&table(true), P, 1, true);
        assert_eq!(said(&primary.hear(guess(1, 2))), [[0, 7]], "two that guess: the newer, and counted up");
        assert_eq!(said(&primary.hear(heartbeat(2, 0, reached, 0))), [[0; 2]; 0], "earlier incarnation");
        let mut knows = guess(3, reached);
        knows.contents = Contents::new(&[0, 0, reached, 0, 0]).expect("short");
        assert_eq!(said(&primary.hear(knows)), [[0, reached + 1]]);
    }
}

/// The guess equals the known epoch by chance, but is void: an earlier incarnation of the primary may have acted in it.
#[test]
fn what_was_proposed_from_a_guess_is_over_when_the_partner_knows_an_epoch() {
    let mut primary = Solo::incarnation(&table(true), P, 1, true);
    assert_eq!(said(&primary.hear(guess(1, 2))), [[0, 7]]);
    let mut knows = guess(2, 7);
    knows.contents = Contents::new(&[1, 0, 7, 1, 0]).expect("short");
    assert_eq!(said(&primary.hear(knows)), [[0, 9]]);
    assert!(!primary.task.is_active(), "the echo is of an answer that counts for nothing now");
}

#[test]
fn an_order_carries_its_epoch_to_the_arm_and_room_for_it_is_kept() {
    let mut net = leased(false);
    net.ask(P, send(MOVE, ARM, 7));
    net.run(1);
    net.ask(ARM, get_on(MOVE, 0));
    assert_eq!(net.heard(ARM), ["message [7] from T0 for 7"]);
    let contents = Contents::new(&[0; 12]).expect("a whole packet");
    net.ask(P, Request::Send { port: MOVE, to: Target::One(ARM), contents, time_out: None });
    assert_eq!(net.heard(P), ["accepted 1", "fault WrongLength"]);
    net.ask(S, send(MOVE, ARM, 7));
    assert_eq!(net.heard(S), ["fault Fenced"]);
}

#[test]
fn a_lease_survives_packing_at_any_moment() {
    for ticks in 0..80 {
        for mutual in [false, true] {
            let mut net = VirtualCell::new(cell(mutual));
            net.run(ticks.min(20));
            if ticks > 20 {
                net.cut(NP, NS);
                net.run(ticks - 20);
            }
            let sequences: Vec<Seq24> =
                net.nodes.iter().map(|node| node.node.parts().tasks[0].next_sequence()).collect();
            let frame = Frame { rounds: &[Frame::ROUND; 2], sequences: &sequences, incarnations: true };
            for ScriptedNode { node, .. } in &mut net.nodes {
                let table = node.parts().table.clone();
                let task = &mut node.parts_mut().tasks[0];
                task.bury();
                let bytes = Encode::bytes(&frame, |w| task.walk(&table, w)).expect("it fits");
                let mut copy = CommTask::new(&table, task.task(), Incarnation(0), false);
                assert_eq!(Decode::read(&bytes, true, |r| copy.walk(&table, r)), bytes.len());
                let base = [Frame::SEQUENCE; 3];
                let frame = Frame { sequences: &base, ..frame };
                let again = Encode::bytes(&frame, |w| copy.walk(&table, w));
                assert_eq!(again, Ok(bytes), "{} after {ticks}", task.task());
                assert_eq!(copy.next_expiry(), task.next_expiry());
                assert_eq!((copy.is_active(), copy.epoch()), (task.is_active(), task.epoch()));
            }
        }
    }
}

#[test]
fn an_answer_that_is_of_no_use_any_more_counts_as_none_even_before_the_next_heartbeat_drops_it() {
    let mut standby = Solo::new(&table(true), S);
    standby.pass(1);
    let nothing = Solo::new(&table(true), ARM).nothing();
    let contents = Contents::new(&[0, 1, 0, 0]).expect("short");
    let answer = Packet {
        kind: Kind::Response,
        class: Class::Command,
        destination: S,
        port: ALIVE,
        contents,
        ..nothing
    };
    standby.hear(answer);
    // The standby sends one heartbeat while the answer is still valid, and none after that.
    standby.pass(TAKEOVER - 1);
    standby.pass(1);
    let mut other = standby.clone();
    other.task.rebase(&other.table);
    for standby in [&mut standby, &mut other] {
        standby.hear(answer);
        standby.task.rebase(&standby.table);
    }
    assert_eq!(
        format!("{:?}", standby.task),
        format!("{:?}", other.task),
        "a clock set back changes nothing"
    );
}

#[test]
fn a_couple_that_cannot_keep_its_promise_is_no_couple() {
    let errors = |change: fn(&mut Cell)| {
        let mut cell = cell(false);
        change(&mut cell);
        CellTable::new(cell).map(|_| ()).expect_err("a fault")
    };
    let couple = || String::from("p -> s");
    assert_eq!(
        errors(|c| c.couples[0].lease = Ticks(7)),
        [CellError::LeaseTooShort { couple: couple(), lease: Ticks(7), least: Ticks(2 * EVERY + 1 + 1) }]
    );
    // The least takeover time is the sum of the lease, the TTL of the last order, a tick, and the drift rounded up.
    let least = Ticks(LEASE + 8 + 1 + 1);
    assert_eq!(
        errors(|c| c.couples[0].takeover = Ticks(21)),
        [CellError::TakeoverTooSoon { couple: couple(), takeover: Ticks(21), least }]
    );
    assert_eq!(errors(|c| c.couples[0].via = MOVE), [CellError::NotForHeartbeats("move".into())]);
    assert_eq!(errors(|c| c.couples[0].via = PortId(9)), [CellError::Dangling("couple 0".into())]);
    assert_eq!(errors(|c| c.couples[0].standby = P)[0], CellError::Dangling("couple 0".into()));
    let nobody = errors(|c| c.couples[0].standby = TaskId::from_index(c.tasks.len()));
    assert_eq!(nobody[0], CellError::Dangling("couple 0".into()), "the first number that no task has");
    assert_eq!(errors(|c| c.couples.push(c.couples[0].clone())), [CellError::CoupledTwice(couple())]);
    assert_eq!(
        errors(|c| c.ports[1].guard = Some(1)),
        [CellError::Dangling("the guard of port `move`".into())]
    );
    let foreign = errors(|c| {
        let port = PortDecl::new("else", S, Usage::Receive, &[ARM], Ticks(9)).guard(0);
        c.port(port);
    });
    assert_eq!(foreign, [CellError::NotOfTheCouple("else".into())]);
    for error in [foreign, errors(|c| c.couples[0].lease = Ticks(7)), errors(|c| c.couples[0].via = MOVE)] {
        assert!(error[0].to_string().len() > 40, "{error:?}");
    }
}

#[test]
fn an_atomic_section_does_not_put_off_a_fence() {
    let mut net = leased(false);
    net.ask(P, Request::Atomic(true));
    net.ask(P, Request::Work);
    assert_eq!(net.heard(P), ["accepted 0"]);
    net.cut(NP, NS);
    net.run(LEASE + 1);
    assert_eq!(net.heard(P), ["interrupt Fenced"]);
}
