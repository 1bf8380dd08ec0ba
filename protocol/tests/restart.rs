//! Restarts of a node (D6, D49): a restarted node does not rely on the state that it has lost.

use crate::support::{Solo, arrive, get, reply, send};
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);
const B: NodeId = NodeId(1);

/// The port for commands from X to Y.
const MOVE: PortId = PortId(0);
/// The port of the waitfor of X and Y.
const LIFT: PortId = PortId(1);

/// A cell with X on node A and Y on node B, two ticks away.
fn cell() -> Cell {
    let mut cell = Cell::new("pair", Ticks(1));
    let (a, b) = (cell.node("a"), cell.node("b"));
    cell.link(a, b, Ticks(2));
    let (x, y) = (cell.task("x", a), cell.task("y", b));
    cell.port(PortDecl::new("move", y, Usage::Receive, &[x], Ticks(20)).command());
    cell.port(PortDecl::new("lift", x, Usage::Waitfor, &[y], Ticks(40)).resend(Ticks(6), 0));
    cell
}

fn table() -> Arc<CellTable> {
    Arc::new(CellTable::new(cell()).expect("a checked cell"))
}

/// How long packets for an earlier incarnation of Y may still arrive: X's patience at the waitfor, and the link delay.
const QUARANTINE: u64 = 40 + 2;

#[test]
fn a_restarted_peer_ends_the_wait() {
    let mut net = VirtualCell::new(cell());
    net.ask(X, send(MOVE, Y, 3));
    net.run(1);
    net.restart(B, 1);
    assert_eq!(net.heard(X), ["PeerRestarted"]);
}

#[test]
fn a_restarted_node_runs_no_command_while_copies_of_an_earlier_one_may_live() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let command = x.ask(send(MOVE, Y, 3)).packets[0];
    let mut y = Solo::incarnation(&table, Y, 1, true);
    y.ask(get(90));
    y.pass(QUARANTINE - 1);
    let answer = y.hear(Packet { remaining: Ticks(9), ..command });
    assert_eq!(answer.words(), ["RESTARTED T1>T0 #0 for 9"]);
    assert_eq!(x.hear(answer.packets[0]).words(), ["PeerRestarted"]);
    let next = x.ask(send(MOVE, Y, 4)).packets[0];
    y.pass(1);
    assert_eq!(y.hear(next).words(), ["message [4] from T0 for 18"]);
}

#[test]
fn a_new_incarnation_numbers_its_messages_from_the_beginning() {
    let table = table();
    let mut x = Solo::new(&table, X);
    x.ask(send(MOVE, Y, 1));
    x.pass(20);
    let second = x.ask(send(MOVE, Y, 2)).packets[0];
    let first_of_next = Solo::incarnation(&table, X, 1, true).ask(send(MOVE, Y, 3)).packets[0];
    assert!(second.id.sequence.is_newer_than(first_of_next.id.sequence));
    let mut y = Solo::new(&table, Y);
    y.hear(second);
    assert_eq!(y.ask(get(0)).words(), ["message [2] from T0 for 18"]);
    y.hear(first_of_next);
    assert_eq!(y.ask(get(0)).words(), ["message [3] from T0 for 18"]);
}

#[test]
fn an_answered_command_is_remembered_until_no_copy_can_come() {
    let table = table();
    let command = Solo::new(&table, X).ask(send(MOVE, Y, 1)).packets[0];
    let mut y = Solo::new(&table, Y);
    y.hear(command);
    let message = y.ask(get(0)).delivery().expect("the message");
    y.ask(reply(&message, 9));
    // The quarantine lasts for the time_out of the command and the link delay.
    y.pass(20 + 2 - 1);
    assert_eq!(y.ask(reply(&message, 9)).words(), ["fault NothingToAnswer"]);
    y.pass(1);
    assert_eq!(y.ask(reply(&message, 9)).words(), ["fault Late"]);
}

#[test]
fn what_a_restart_left_behind_is_stale() {
    let table = table();
    let old = Solo::new(&table, X).ask(send(MOVE, Y, 1)).packets[0];
    let new = Solo::incarnation(&table, X, 1, true).ask(send(MOVE, Y, 2)).packets[0];
    let mut y = Solo::new(&table, Y);
    y.hear(old);
    assert_eq!(y.queue(MOVE), [(X, 18)]);
    // The command of the new incarnation replaces the earlier command, for whose answer no task waits any more.
    assert_eq!(y.hear(new).words(), Vec::<String>::new());
    assert_eq!(y.hear(old).discards(), [Reason::StaleIncarnation]);
    assert_eq!(y.ask(get(0)).words(), ["message [2] from T0 for 18"]);
    assert_eq!(y.ask(get(0)).words(), ["nothing"]);
}

#[test]
fn members_meet_again_after_one_of_them_restarted() {
    let mut net = VirtualCell::new(cell());
    for _ in 0..3 {
        net.ask(X, arrive(LIFT));
        net.ask(Y, arrive(LIFT));
        net.run(6);
    }
    net.ask(X, arrive(LIFT));
    net.run(1);
    net.restart(B, 1);
    net.run(QUARANTINE);
    net.transcript();
    let mut rounds = Vec::new();
    for _ in 0..3 {
        net.told(X);
        net.told(Y);
        net.ask(X, arrive(LIFT));
        net.ask(Y, arrive(LIFT));
        net.run(40);
        let told = (net.told(X), net.told(Y));
        match (&told.0[..], &told.1[..]) {
            ([Signal::Released { round: x, .. }], [Signal::Released { round: y, .. }]) if x == y => {
                rounds.push(*x);
            }
            other => panic!("{other:?}\n{:#?}", net.transcript()),
        }
    }
    assert!(rounds.windows(2).all(|pair| pair[1].is_newer_than(pair[0])), "{rounds:?}");
}

#[test]
fn an_arrival_that_may_be_meant_for_an_earlier_incarnation_does_not_count() {
    let table = table();
    let from_x = Solo::new(&table, X).ask(arrive(LIFT)).packets[0];
    let mut y = Solo::incarnation(&table, Y, 1, true);
    y.ask(arrive(LIFT));
    y.pass(QUARANTINE - 3);
    let early = y.hear(Packet { remaining: Ticks(30), ..from_x });
    assert!(early.is_nothing() && early.discards() == [Reason::StaleIncarnation], "{early:?}");
    y.pass(3);
    y.ask(arrive(LIFT));
    let now = y.hear(Packet { remaining: Ticks(30), ..from_x });
    assert!(!now.is_nothing());
}

#[test]
fn a_confirm_for_an_earlier_incarnation_releases_nobody() {
    let table = table();
    let (mut x, mut old) = (Solo::new(&table, X), Solo::new(&table, Y));
    x.ask(arrive(LIFT));
    let confirm = x.hear(old.ask(arrive(LIFT)).packets[0]).packets[0];
    assert_eq!(confirm.kind, Kind::Confirm);
    let mut new = Solo::incarnation(&table, Y, 1, true);
    new.ask(arrive(LIFT));
    let out = new.hear(confirm);
    assert_eq!(
        (out.words(), out.discards()),
        (vec![], vec![Reason::OldRound]),
        "the same round number, another life"
    );
    assert_eq!(old.hear(confirm).words(), ["released r1 by T0"]);
}

#[test]
fn the_arrival_of_a_task_whose_node_stopped_in_order_still_counts() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let mut y = Solo::new(&table, Y);
    x.hear(y.ask(arrive(LIFT)).packets[0]);
    x.input(Input::PeerStopped(B));
    assert!(!x.ask(arrive(LIFT)).signals.is_empty(), "all have arrived");
}

#[test]
fn the_arrival_of_an_earlier_incarnation_is_void_once_the_new_one_is_heard_of() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let mut old = Solo::new(&table, Y);
    let stale = old.ask(arrive(LIFT)).packets[0];
    x.hear(stale);
    x.input(Input::PeerRestarted(B));
    assert!(x.ask(arrive(LIFT)).signals.is_empty(), "Y has not arrived in this life");
    let new = Solo::incarnation(&table, Y, 1, true).ask(arrive(LIFT)).packets[0];
    x.ask(Request::Cancel);
    x.hear(new);
    assert_eq!(x.hear(stale).discards(), [Reason::StaleIncarnation]);
}

#[test]
fn after_the_next_release_the_new_incarnation_is_answered_as_any_other() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let mut old = Solo::new(&table, Y);
    x.ask(arrive(LIFT));
    let released = old.ask(arrive(LIFT)).packets[0];
    x.hear(released);
    x.input(Input::PeerRestarted(B));
    let mut new = Solo::incarnation(&table, Y, 1, true);
    let same_number = new.ask(arrive(LIFT)).packets[0];
    assert_eq!(same_number.meeting().round, released.meeting().round);
    assert_eq!(x.hear(same_number).words(), ["ABORT T0>T1 r1 next r2 for 40"], "it was not in that meeting");

    new.ask(Request::Cancel);
    let arrival = new.ask(arrive(LIFT)).packets[0];
    x.ask(arrive(LIFT));
    assert_eq!(x.hear(arrival).words().last().map(String::as_str), Some("released r2 complete"));
    assert_eq!(x.hear(arrival).words(), ["CONFIRM T0>T1 r2 for 40 again"]);
}

#[test]
fn a_copy_runs_once_however_much_an_earlier_one_was_charged() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let command = x.ask(send(MOVE, Y, 7)).packets[0];
    let mut y = Solo::new(&table, Y);
    y.ask(get(90));
    // A link may charge more than its real delay: this copy seems to have five ticks left, but more time really remains.
    let first = y.hear(Packet { remaining: Ticks(5), ..command });
    assert_eq!(first.words(), ["message [7] from T0 for 3"]);
    y.ask(reply(&first.delivery().expect("the command"), 1));
    y.ask(get(90));
    y.pass(10);
    let copy = y.hear(Packet { remaining: Ticks(8), resent: true, ..command });
    assert!(copy.delivery().is_none(), "{:?}", copy.words());
}

#[test]
fn patience_beyond_the_declared_one_is_cut_to_it() {
    let table = table();
    let mut x = Solo::new(&table, X);
    let arrival = x.ask(Request::Arrive { port: LIFT, arguments: [0; 8], time_out: Some(Ticks(900)) });
    assert_eq!(arrival.packets[0].remaining, Ticks(40), "a restarted partner waits only so long");
    let command =
        Request::Send { port: MOVE, to: Target::All, contents: Contents::EMPTY, time_out: Some(Ticks(900)) };
    let mut x = Solo::new(&table, X);
    assert_eq!(x.ask(command).packets[0].remaining, Ticks(20));
}

/// A cell with X on node A, and Y and Z on node B, which restarts. All three meet; X and Z command Y.
fn three() -> Arc<CellTable> {
    let mut cell = Cell::new("three", Ticks(1));
    let (a, b) = (cell.node("a"), cell.node("b"));
    cell.link(a, b, Ticks(2));
    let (x, y, z) = (cell.task("x", a), cell.task("y", b), cell.task("z", b));
    cell.port(PortDecl::new("move", y, Usage::Receive, &[x, z], Ticks(20)).command());
    cell.port(PortDecl::new("lift", x, Usage::Waitfor, &[y, z], Ticks(40)).resend(Ticks(6), 0));
    Arc::new(CellTable::new(cell).expect("a checked cell"))
}

#[test]
fn what_comes_from_the_own_node_is_of_its_present_incarnation() {
    const Z: TaskId = TaskId(2);
    let table = three();
    let mut x = Solo::new(&table, X);
    let (mut y, mut z) = (Solo::incarnation(&table, Y, 1, true), Solo::incarnation(&table, Z, 1, true));
    y.ask(get(90));
    let theirs = x.ask(send(MOVE, Y, 3)).packets[0];
    assert_eq!(y.hear(Packet { remaining: Ticks(9), ..theirs }).words(), ["RESTARTED T1>T0 #0 for 9"]);
    let own = z.ask(send(MOVE, Y, 4)).packets[0];
    assert_eq!(y.hear(own).words(), ["message [4] from T2 for 20"]);
    z.ask(Request::Cancel);
    y.ask(arrive(LIFT));
    let arrival = z.ask(arrive(LIFT)).packets;
    let to_y = arrival.iter().find(|packet| packet.destination == Y).expect("an arrival for Y");
    assert_eq!(y.hear(*to_y).discards(), []);
    x.ask(Request::Cancel);
    let theirs = x.ask(arrive(LIFT)).packets[0];
    assert_eq!(y.hear(Packet { destination: Y, ..theirs }).discards(), [Reason::StaleIncarnation]);
}

/// Shows why a script is also held back for the commands that its earlier incarnation sent: otherwise such a command may be
/// carried out after a command of the new incarnation.
#[test]
fn a_task_is_held_back_until_nobody_can_carry_out_a_command_of_its_earlier_incarnation() {
    let mut cell = Cell::new("two arms", Ticks(1));
    let (a, b) = (cell.node("a"), cell.node("b"));
    cell.link(a, b, Ticks(2));
    let (x, y, z) = (cell.task("x", a), cell.task("y", b), cell.task("z", b));
    cell.port(PortDecl::new("left", y, Usage::Receive, &[x], Ticks(20)).command());
    cell.port(PortDecl::new("right", z, Usage::Receive, &[x], Ticks(9)).command());
    let table = Arc::new(CellTable::new(cell).expect("a checked cell"));
    let (left, right) = (PortId(0), PortId(1));
    let late = Solo::new(&table, x).ask(send(left, y, 1)).packets[0];
    let (mut y, mut z) = (Solo::new(&table, y), Solo::new(&table, z));
    y.ask(get(90));
    z.ask(get(90));
    let new = Solo::incarnation(&table, x, 1, true).ask(send(right, TaskId(2), 2)).packets[0];
    assert_eq!(z.hear(new).words(), ["message [2] from T0 for 7"]);
    // The packet has waited in a relay for nearly all of its remaining time.
    let late = Packet { remaining: Ticks(3), ..late };
    assert_eq!(y.hear(late).words(), ["message [1] from T0 for 1"], "that is not to be");
    assert_eq!(table.held_back(x), Ticks(20 + 2));
}
