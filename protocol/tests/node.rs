//! The node (§5.1, D38): routing through relays, the insertion rule, charges, and the parts' common time.

use crate::support::{NextExpiry, get, reply, send, send_for};
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);
const Z: TaskId = TaskId(2);
const N0: NodeId = NodeId(0);
const N1: NodeId = NodeId(1);
const N2: NodeId = NodeId(2);

/// The port for commands from X and Y to Z.
const MOVE: PortId = PortId(0);
/// The port for status messages from X to Z.
const HEARTBEAT: PortId = PortId(1);

/// A cell with a chain of three nodes, whose links delay a packet by at most two and three ticks. X and Y are on the first
/// node, Z on the last.
fn cell() -> Cell {
    let mut cell = Cell::new("chain", Ticks(1));
    let [a, b, c] = ["a", "b", "c"].map(|name| cell.node(name));
    cell.link(a, b, Ticks(2));
    cell.link(b, c, Ticks(3));
    cell.task("x", a);
    cell.task("y", a);
    cell.task("z", c);
    cell.port(PortDecl::new("move", Z, Usage::Receive, &[X, Y], Ticks(30)).command().bounded_buffer(4));
    cell.port(PortDecl::new("beat", X, Usage::Send, &[Z], Ticks(30)));
    cell
}

/// A packet that X sent, as it arrives over a link.
fn packet() -> Packet {
    Packet {
        kind: Kind::Send,
        class: Class::Status,
        more: false,
        resent: false,
        hops: MAX_HOPS,
        fragment: 0,
        destination: Z,
        source: X,
        port: HEARTBEAT,
        id: MessageId::default(),
        remaining: Ticks(30),
        contents: Contents::EMPTY,
        seal: Seal::NONE,
    }
}

#[test]
fn a_relay_passes_packets_on_and_every_hop_is_charged() {
    let mut net = VirtualCell::new(cell());
    net.ask(Z, get(20));
    net.ask(X, send(MOVE, Z, 1));
    net.run(6);
    let message = net.message(Z);
    net.ask(Z, reply(&message, 2));
    net.run(6);
    assert_eq!(
        net.transcript(),
        [
            "0 N0>N1 SEND T0>T2 #0 [1] for 30",
            "2 N1>N2 SEND T0>T2 #0 [1] for 28",
            "5 T2: message [1] from T0 for 20",
            "6 T2: accepted 1",
            "6 N2>N1 REPLY T2>T0 #0 [2] for 24",
            "9 N1>N0 REPLY T2>T0 #0 [2] for 21",
            "11 T0: reply [2]",
        ]
    );
}

#[test]
fn residence_in_a_relay_is_charged() {
    let mut net = VirtualCell::new(cell());
    net.block(&[N2]);
    net.ask(X, send(HEARTBEAT, Z, 1));
    net.run(12);
    net.block(&[]);
    net.pass(N1, 0);
    let left = net.transcript().pop().expect("the packet leaves the relay");
    assert_eq!(left, "12 N1>N2 SEND T0>T2 #0 [1] for 18");
}

#[test]
fn a_relay_drops_what_expires_in_it_and_the_source_cannot_tell() {
    let mut net = VirtualCell::new(cell());
    net.block(&[N2]);
    net.ask(X, send(MOVE, Z, 1));
    net.run(30);
    assert_eq!(net.count(Event::Discarded(Reason::ExpiredInTransit)), 1);
    assert_eq!(net.heard(X), ["TimedOutUnknown"]);
}

#[test]
fn a_full_transit_buffer_refuses_at_once_at_home_only() {
    let mut net = VirtualCell::with_transit(cell(), 1);
    net.block(&[N1]);
    net.ask(X, send_for(MOVE, Z, 1, 20));
    net.ask(Y, send(MOVE, Z, 2));
    assert_eq!(net.heard(Y), ["Refused"], "no copy left this node");
    net.ask(Y, send_for(MOVE, Z, 3, 15));
    assert_eq!(net.heard(X), ["Refused"], "a more urgent one took its place");

    let mut net = VirtualCell::with_transit(cell(), 1);
    net.block(&[N2]);
    net.ask(X, send_for(MOVE, Z, 1, 20));
    net.run(1);
    net.ask(Y, send(MOVE, Z, 2));
    net.run(6);
    assert!(net.count(Event::Discarded(Reason::Refused)) > 0);
    assert_eq!(net.heard(Y), Vec::<String>::new(), "another copy may have arrived");
    net.run(30);
    assert_eq!(net.heard(Y), ["TimedOutUnknown"]);
}

#[test]
fn what_comes_over_a_link_is_sorted_by_the_table_alone() {
    let table = Arc::new(CellTable::new(cell()).expect("a checked cell"));
    let at = |node| NodeTable::new(Arc::clone(&table), node);
    // Each node gets packets from the node before it in the chain.
    let sort = |node: NodeId, p, charge| route::arrived(&at(node), NodeId(node.0 - 1), p, Ticks(charge));
    let p = packet();
    let left = |remaining, hops| Packet { remaining: Ticks(remaining), hops, ..p };

    assert_eq!(sort(N2, p, 3), route::Arrival::Local(Z, left(27, 7)));
    assert_eq!(sort(N1, p, 2), route::Arrival::Relay(left(28, 6)));
    assert_eq!(sort(N1, left(30, 0), 2), route::Arrival::Discard(Reason::HopLimit, left(28, 0)));
    assert_eq!(
        sort(N2, left(30, 0), 3),
        route::Arrival::Local(Z, left(27, 0)),
        "arrived: no relay left to pass"
    );
    assert_eq!(sort(N1, left(2, 7), 2), route::Arrival::Discard(Reason::ExpiredOnTheWay, left(0, 7)));
    assert_eq!(sort(N2, left(3, 7), 3), route::Arrival::Local(Z, left(0, 7)), "its task counts it");
    let word = Packet { kind: Kind::Arrive, ..left(3, 7) };
    let spent = Packet { remaining: Ticks::ZERO, ..word };
    assert_eq!(sort(N2, word, 3), route::Arrival::Discard(Reason::ExpiredOnTheWay, spent));
    let other_way = route::arrived(&at(N1), N2, p, Ticks(2));
    assert_eq!(
        other_way,
        route::Arrival::Discard(Reason::NotAllowed, p),
        "its source lies on the other side"
    );

    let lost = Packet { destination: TaskId(7), ..p };
    assert_eq!(sort(N1, lost, 1), route::Arrival::Discard(Reason::Unroutable, lost));
    for stranger in [
        Packet { source: Y, ..p },
        Packet { source: Z, ..p },
        Packet { source: TaskId(7), ..p },
        Packet { port: PortId(7), ..p },
        Packet { destination: Y, ..p },
    ] {
        assert_eq!(sort(N1, stranger, 1), route::Arrival::Discard(Reason::NotAllowed, stranger));
    }

    assert_eq!(route::departing(&at(N0), &p), route::Departure::Link(N1));
    assert_eq!(route::departing(&at(N2), &p), route::Departure::Local(Z));
    assert_eq!(route::departing(&at(N0), &lost), route::Departure::Unroutable);
}

#[test]
fn a_dropped_packet_is_seen_with_its_reason() {
    let mut net = VirtualCell::new(cell());
    let from = |from, packet, charge| NodeInput::Packet { from, packet, charge: Ticks(charge) };
    net.step(N2, from(N1, Packet { source: Y, ..packet() }, 3));
    net.step(N2, from(N1, packet(), 30));
    let dropped = |at, reason| (at, Event::Discarded(reason));
    assert_eq!(
        net.observed(),
        [dropped(None, Reason::NotAllowed), dropped(Some(Z), Reason::ExpiredOnTheWay)]
    );
    net.step(N1, from(N0, packet(), 30));
    assert_eq!(net.observed(), [dropped(None, Reason::ExpiredOnTheWay)], "no task of a relay counts it");
    assert!(net.transcript().is_empty());
    let ports = net.task(Z).view(&net.nodes[2].node.parts().table, 0).ports;
    let expired: Vec<_> = ports.iter().map(|port| port.counters.expired).collect();
    assert_eq!(expired, [0, 1], "counted at the port it was for");
}

#[test]
fn all_parts_of_a_node_have_one_time() {
    let mut net = VirtualCell::new(cell());
    net.block(&[N1]);
    // The route to Z takes 5 ticks.
    net.ask(X, send_for(HEARTBEAT, Z, 1, 14));
    net.ask(X, Request::Delay { id: TimeId(1), length: Ticks(7) });
    net.ask(Y, get(8));
    assert_eq!(net.nodes[0].node.next_expiry(), Some(Ticks(7)));
    net.pass(N0, 7);
    assert_eq!(net.heard(X), ["accepted 1", "time_out 1"]);
    assert_eq!(net.nodes[0].node.next_expiry(), Some(Ticks(1)));
    net.pass(N0, 1);
    assert_eq!(net.heard(Y), ["nothing"]);
    assert_eq!(net.nodes[0].node.next_expiry(), Some(Ticks(1)));
    net.pass(N0, 1);
    assert_eq!(net.count(Event::Discarded(Reason::ExpiredInTransit)), 1);
    assert_eq!(net.nodes[0].node.next_expiry(), None);
}

#[test]
fn a_late_node_still_knows_that_a_command_never_left() {
    let mut net = VirtualCell::new(cell());
    net.block(&[N1]);
    net.ask(X, send(MOVE, Z, 1));
    net.pass(N0, 500);
    assert_eq!(net.heard(X), ["TimedOutUnsent"]);
}

/// The link took the packet, so the node does not know by itself that the packet never left.
#[test]
fn a_command_that_its_link_never_sent_has_not_run() {
    for (reports, outcome) in [(0, "TimedOutUnknown"), (1, "TimedOutUnsent")] {
        let mut net = VirtualCell::new(cell());
        net.ask(X, send(MOVE, Z, 1));
        let id = MessageId::default();
        (0..reports).for_each(|_| net.step(N0, NodeInput::Unsent(X, id)));
        net.pass(N0, 500);
        assert_eq!(net.heard(X), [outcome]);
    }
}

#[test]
fn news_of_a_restart_reaches_every_task_of_a_node() {
    let mut net = VirtualCell::new(cell());
    net.ask(X, send(MOVE, Z, 1));
    net.ask(Y, send(MOVE, Z, 2));
    net.step(N0, NodeInput::PeerRestarted(N1));
    assert_eq!((net.heard(X), net.heard(Y)), (vec![], vec![]), "Z does not run there");
    net.step(N0, NodeInput::PeerRestarted(N2));
    assert_eq!((net.heard(X), net.heard(Y)), (vec!["PeerRestarted".into()], vec!["PeerRestarted".into()]));
}

#[test]
fn a_node_ignores_requests_of_tasks_it_does_not_run() {
    let mut net = VirtualCell::new(cell());
    net.step(N0, NodeInput::Request(Z, get(0)));
    net.step(N0, NodeInput::Request(TaskId(9), get(0)));
    assert!(net.transcript().is_empty() && net.nodes[0].node.task(Z).is_none());
}

#[test]
fn a_node_comes_apart_into_what_a_threaded_driver_locks() {
    let mut net = VirtualCell::new(cell());
    net.ask(X, get(9));
    let Parts { table, tasks, transit, timer } = net.nodes.swap_remove(0).node.into_parts();
    assert_eq!(table.node, N0);
    assert_eq!(tasks.iter().map(CommTask::task).collect::<Vec<_>>(), [X, Y]);
    assert_eq!(tasks[0].state(), TaskState::Receiving { port: None, remaining: Some(Ticks(9)) });
    assert!(transit.is_empty() && timer.entries().is_empty());
}
