//! Tables that replace others in running nodes (D184): what stays, what follows the new routes, and which tables a node
//! does not take.

mod random;

use crate::support::{get, reply, send, send_for};
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use std::sync::Arc;

const A: NodeId = NodeId(0);
const B: NodeId = NodeId(1);
const C: NodeId = NodeId(2);
const D: NodeId = NodeId(3);
const NODES: [NodeId; 4] = [A, B, C, D];
const ROBOT: TaskId = TaskId(0);
const ARM: TaskId = TaskId(1);
const MOVE: PortId = PortId(0);

/// A robot on `a` commands an arm on `d`: by `b` in 2 + 2 ticks, or by `c` in 3 + 4.
fn diamond(retry: u8) -> Cell {
    let mut cell = Cell::new("diamond", Ticks(1));
    let [a, b, c, d] = ["a", "b", "c", "d"].map(|name| cell.node(name));
    for (from, to, delay) in [(a, b, 2), (b, d, 2), (a, c, 3), (c, d, 4)] {
        cell.link(from, to, Ticks(delay));
    }
    cell.task("robot", a);
    cell.task("arm", d);
    let port = PortDecl::new("move", ARM, Usage::Receive, &[ROBOT], Ticks(60)).command();
    cell.port(if retry > 0 { port.retry(retry, Ticks(12)) } else { port });
    cell
}

fn around(table: &CellTable, epoch: u32, links: &[(NodeId, NodeId)], relays: &[NodeId]) -> Arc<CellTable> {
    let avoid = Avoid { links: links.into(), relays: relays.into() };
    Arc::new(table.around(epoch, avoid).expect("times that cover the longer routes"))
}

/// Lets the arm carry out its commands and wait for more. Returns how many commands it got.
fn serve(net: &mut VirtualCell) -> usize {
    let told = net.told(ARM);
    let messages =
        told.iter().filter_map(|signal| if let Signal::Message(it) = signal { Some(it) } else { None });
    let served = messages.map(|message| {
        net.ask(ARM, reply(message, 7));
        net.ask(ARM, Request::Get { port: None, source: None, time_out: None });
    });
    served.count()
}

fn not_allowed(net: &VirtualCell) -> usize {
    net.count(Event::Discarded(Reason::NotAllowed))
}

#[test]
fn routes_go_around_a_link_a_relay_and_neither_where_there_is_no_other() {
    let table = CellTable::new(diamond(0)).unwrap();
    let next =
        |table: &CellTable| [(A, D), (D, A), (A, B)].map(|(from, to)| table.next_hop(from, to).unwrap());
    assert_eq!((next(&table), table.epoch()), ([B, B, B], 0));
    for (links, relays) in [(&[(D, B)][..], &[][..]), (&[], &[B])] {
        let other = around(&table, 3, links, relays);
        assert_eq!((next(&other), other.epoch(), other.digest()), ([C, C, B], 3, table.digest()));
        assert_eq!(other.path_bound(A, D), Some(Ticks(7)));
    }
    let cut_off = around(&table, 1, &[(A, B), (B, D)], &[C]);
    assert_eq!(next(&cut_off), [C, C, B], "one avoided part is better than two");
    let back = around(&cut_off, 2, &[], &[]);
    assert_eq!(next(&back), [B, B, B]);
}

#[test]
fn a_detour_that_the_times_do_not_cover_or_of_unknown_parts_is_no_table() {
    let mut cell = diamond(0);
    cell.ports[0].time_out = Ticks(12);
    let table = CellTable::new(cell).unwrap();
    let refused = |links: &[_], relays: &[_]| {
        let avoid = Avoid { links: links.into(), relays: relays.into() };
        table.around(1, avoid).unwrap_err().iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    assert!(refused(&[(A, B)], &[])[0].contains("time_out 12"), "{:?}", refused(&[(A, B)], &[]));
    assert!(refused(&[(B, C)], &[])[0].contains("avoided link"));
    assert!(refused(&[], &[NodeId(9)])[0].contains("avoided relay"));
}

#[test]
fn an_old_epoch_and_other_slots_are_refused_by_name() {
    let mut net = VirtualCell::new(diamond(0));
    let base = CellTable::new(diamond(0)).unwrap();
    let second = around(&base, 2, &[(A, B)], &[]);
    assert_eq!(net.replace_table(A, &second), Ok(()));
    for epoch in [0, 1, 2] {
        let stale = around(&base, epoch, &[], &[]);
        let refused = net.replace_table(A, &stale).unwrap_err();
        assert_eq!(refused, TableError::NotNewer { held: 2, given: epoch });
        assert_eq!(net.learn_table(A, &stale), Err(refused));
        assert_eq!(
            refused.to_string(),
            format!("the table has epoch {epoch}, and the node knows epoch 2: give it a later epoch")
        );
    }
    type Change = fn(&mut Cell);
    let changes: [(&str, Change); 5] = [
        ("nodes", |cell| cell.nodes[0].name = "e".into()),
        ("links", |cell| cell.links[0].delay = Ticks(1)),
        ("tasks", |cell| cell.tasks.swap(0, 1)),
        ("ports", |cell| cell.ports[0].bounded_buffer = 2),
        ("rules", |cell| cell.tick = Ticks(2)),
    ];
    for (what, change) in changes {
        let mut cell = diamond(0);
        change(&mut cell);
        let other = around(&CellTable::new(cell).unwrap(), 9, &[], &[]);
        let refused = net.replace_table(A, &other).unwrap_err();
        assert_eq!(refused, TableError::OtherSlots(what));
        assert!(refused.to_string().starts_with(&format!("the table has other {what}: ")), "{refused}");
    }
    let Parts { table, .. } = net.nodes[0].node.parts();
    assert_eq!((table.epoch(), table.next_hop(A, D)), (2, Some(C)), "refusals change nothing");
}

#[test]
fn a_table_that_comes_after_a_later_one_is_refused() {
    let mut net = VirtualCell::new(diamond(0));
    let base = CellTable::new(diamond(0)).unwrap();
    let [late, third] = [2, 3].map(|epoch| around(&base, epoch, &[(A, B)], &[]));
    assert_eq!(net.learn_table(A, &third), Ok(()));
    let refused = Err(TableError::NotNewer { held: 3, given: 2 });
    assert_eq!((net.learn_table(A, &late), net.replace_table(A, &late)), (refused, refused));
    assert_eq!((net.learn_table(A, &third), net.replace_table(A, &third)), (Ok(()), Ok(())));
}

#[test]
fn a_waiting_packet_leaves_by_the_new_route_and_one_without_time_for_it_is_dropped() {
    for (ttl, left) in [(30, vec!["5 N0>N2 SEND T0>T1 #0 [1] for 25"]), (11, vec![])] {
        let mut net = VirtualCell::new(diamond(0));
        net.block(&[B]);
        net.ask(ROBOT, send_for(MOVE, ARM, 1, ttl));
        net.run(5);
        assert_eq!(net.transcript(), [""; 0]);
        let next = around(net.table(), 1, &[(A, B)], &[]);
        net.replace_table(A, &next).unwrap();
        assert_eq!(net.transcript(), left);
        let expired = net.count(Event::Discarded(Reason::ExpiredInTransit));
        assert_eq!(expired, usize::from(left.is_empty()));
        net.run(30);
        let outcome = if left.is_empty() { Outcome::TimedOutUnsent } else { Outcome::TimedOutUnknown };
        assert_eq!(net.told(ROBOT), [Signal::Outcome(outcome)]);
    }
}

#[test]
fn a_waiting_command_reserves_the_new_way_back() {
    let budget = |switch: bool| {
        let mut net = VirtualCell::new(diamond(0));
        net.ask(ROBOT, send_for(MOVE, ARM, 1, 30));
        net.run(10);
        if switch {
            let next = around(net.table(), 1, &[(D, B)], &[]);
            NODES.into_iter().for_each(|node| net.replace_table(node, &next).unwrap());
        }
        net.ask(ARM, get(0));
        let message = net.message(ARM);
        net.run(message.budget.0 - 1);
        net.ask(ARM, reply(&message, 7));
        net.run(10);
        (message.budget.0, net.heard(ROBOT))
    };
    assert_eq!(budget(false), (16, vec!["reply [7]".into()]));
    assert_eq!(budget(true), (13, vec!["reply [7]".into()]), "the answer is still in time");
}

#[test]
fn a_command_whose_answer_cannot_come_back_in_time_any_more_expires_at_once() {
    let mut net = VirtualCell::new(diamond(0));
    net.ask(ROBOT, send_for(MOVE, ARM, 1, 17));
    net.run(8);
    let next = around(net.table(), 1, &[(D, B)], &[]);
    net.run(3);
    net.replace_table(D, &next).unwrap();
    assert_eq!(net.count(Event::Discarded(Reason::Expired)), 1);
    net.ask(ARM, get(0));
    assert_eq!(net.heard(ARM), ["nothing"]);
}

#[test]
fn a_learnt_route_is_taken_until_it_is_retired() {
    let mut net = VirtualCell::new(diamond(0));
    let next = around(net.table(), 1, &[(A, B)], &[]);
    let goes = |net: &mut VirtualCell| {
        let before = not_allowed(net);
        net.ask(ARM, Request::Cancel);
        net.ask(ARM, get(50));
        net.ask(ROBOT, Request::Cancel);
        net.ask(ROBOT, send(MOVE, ARM, 1));
        net.run(20);
        not_allowed(net) == before && serve(net) == 1
    };
    assert!(goes(&mut net));
    net.replace_table(A, &next).unwrap();
    assert!(!goes(&mut net), "the relay knows the former route alone");
    [C, D].into_iter().for_each(|node| net.learn_table(node, &next).unwrap());
    assert!(goes(&mut net));
    [C, D].into_iter().for_each(|node| net.replace_table(node, &next).unwrap());
    assert!(goes(&mut net));
    NODES.into_iter().for_each(|node| net.retire_table(node));
    assert!(goes(&mut net));
    let forged = |net: &mut VirtualCell| {
        let before = not_allowed(net);
        let id = MessageId { incarnation: Incarnation(0), sequence: Seq24::new(999) };
        let from = NodeInput::Packet {
            from: B,
            packet: Packet {
                kind: Kind::Send,
                class: Class::Command,
                source: ROBOT,
                destination: ARM,
                port: MOVE,
                id,
                remaining: Ticks(40),
                ..Packet::BLANK
            },
            charge: Ticks(2),
        };
        net.step(D, from);
        not_allowed(net) > before
    };
    assert!(forged(&mut net), "the former route");
}

/// Tests every choice of the instants at which the four nodes replace their tables, while a command and its answer are
/// in flight. The command runs exactly once, and its retransmissions make up for packets that were dropped between
/// nodes of two tables.
#[test]
fn a_command_runs_once_whenever_each_node_switches() {
    const INSTANTS: u64 = 7;
    let mut resent = [0; 2];
    for learns in [false, true] {
        for choice in 0..INSTANTS.pow(4) {
            let when = [0, 1, 2, 3].map(|node| 2 * (choice / INSTANTS.pow(node) % INSTANTS));
            let mut net = VirtualCell::new(diamond(4));
            let next = around(net.table(), 1, &[(B, D)], &[]);
            if learns {
                NODES.into_iter().for_each(|node| net.learn_table(node, &next).unwrap());
            }
            net.ask(ARM, Request::Get { port: None, source: None, time_out: None });
            net.ask(ROBOT, send(MOVE, ARM, 1));
            let mut ran = 0;
            for now in 0..60 {
                for node in NODES.into_iter().filter(|node| when[node.index()] == now) {
                    net.replace_table(node, &next).unwrap();
                }
                ran += serve(&mut net);
                net.run(1);
            }
            assert_eq!((ran, net.heard(ROBOT)), (1, vec!["reply [7]".to_owned()]), "at {when:?}");
            assert!(!learns || not_allowed(&net) == 0, "at {when:?}");
            resent[usize::from(learns)] += net.count(Event::Resent);
        }
    }
    assert!(resent[1] < resent[0], "to learn a table first loses fewer packets: {resent:?}");
}
