//! Variants of the rules, which are literal and naive readings of the paper. Each variant still shows the fault for which
//! it exists.

use crate::support::{NextExpiry, Solo, arrive, get, reply, send};
use imrs_protocol::rules::{JobRequest, Memory, TimeStamp};
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);
const Z: TaskId = TaskId(2);
const N0: NodeId = NodeId(0);
const N1: NodeId = NodeId(1);

/// The port for status messages of X to Z.
const HEARTBEAT: PortId = PortId(0);
/// The port for commands of X to Z.
const MOVE: PortId = PortId(1);
/// The port of the waitfor of X and Z.
const LIFT: PortId = PortId(2);

/// A cell with X and Y on one node, and Z on another, two ticks away.
fn cell(change: impl FnOnce(&mut Rules)) -> Cell {
    let mut cell = Cell::new("variants", Ticks(1));
    let (a, b) = (cell.node("a"), cell.node("b"));
    cell.link(a, b, Ticks(2));
    let (x, _, z) = (cell.task("x", a), cell.task("y", a), cell.task("z", b));
    cell.port(PortDecl::new("beat", x, Usage::Send, &[z], Ticks(30)).bounded_buffer(4));
    cell.port(PortDecl::new("move", x, Usage::Send, &[z], Ticks(30)).command().bounded_buffer(4));
    cell.port(PortDecl::new("lift", x, Usage::Waitfor, &[z], Ticks(40)).resend(Ticks(6), 1));
    change(&mut cell.rules);
    cell
}

fn table(change: impl FnOnce(&mut Rules)) -> Arc<CellTable> {
    Arc::new(CellTable::new(cell(change)).expect("a checked cell"))
}

/// What remains of a message that has waited ten ticks for a link and ten in a receiver's buffer.
fn left_after_waiting(charged: bool) -> (Option<String>, Vec<String>) {
    let mut net = VirtualCell::new(cell(|rules| rules.charge_residence = charged));
    net.block(&[N1]);
    net.ask(X, send(HEARTBEAT, Z, 1));
    net.run(10);
    net.block(&[]);
    net.pass(N0, 0);
    let sent = net.transcript().pop();
    net.run(12);
    net.ask(Z, get(0));
    (sent, net.heard(Z))
}

#[test]
fn time_spent_in_a_buffer_is_taken_from_the_remaining_time_but_where_the_variant_forgets_it() {
    let [charged, free] = [true, false].map(left_after_waiting);
    assert_eq!(charged.0.as_deref(), Some("10 N0>N1 SEND T0>T2 #0 [1] for 20"));
    assert_eq!(charged.1, ["message [1] from T0 for 8"]);
    assert_eq!(free.0.as_deref(), Some("10 N0>N1 SEND T0>T2 #0 [1] for 30"));
    assert_eq!(free.1, ["message [1] from T0 for 28"]);
}

#[test]
fn of_two_commands_that_live_alike_the_earlier_goes_first_whenever_the_state_is_packed() {
    let served = |packed: bool| {
        let table = table(|rules| rules.charge_residence = false);
        let (mut x, mut z) = (Solo::new(&table, X), Solo::new(&table, Z));
        z.hear(x.ask(send(MOVE, Z, 1)).packets[0]);
        // X gives up the first command, and Z drops its dedup entry. The command still waits at Z, and its
        // remaining time does not shrink.
        x.pass(40);
        z.pass(40);
        let second = x.ask(send(MOVE, Z, 2)).packets[0];
        z.hear(Packet { remaining: Ticks(20), ..second });
        assert_eq!(z.queue(MOVE), [(X, 18), (X, 28)]);
        if packed {
            z.repack();
        }
        // A copy of the second command was charged less, so it has more time left.
        z.hear(second);
        assert_eq!(z.queue(MOVE), [(X, 28), (X, 28)]);
        [(), ()].map(|()| z.ask(get(0)).words().remove(0))
    };
    assert_eq!(served(false), ["message [1] from T0 for 28", "message [2] from T0 for 28"]);
    assert_eq!(served(true), served(false));
}

#[test]
fn an_instant_on_the_senders_clock_is_wrong_on_any_other() {
    let heard = |stamp, ahead| {
        let table = table(|rules| rules.time_stamp = stamp);
        let (mut x, mut z) = (Solo::new(&table, X), Solo::new(&table, Z));
        z.task.set_ahead(&z.table, Ticks(ahead));
        let packet = x.ask(send(HEARTBEAT, Z, 1)).packets[0];
        z.hear(packet);
        z.ask(get(0)).words()
    };
    assert_eq!(heard(TimeStamp::Remaining, 40), ["message [1] from T0 for 30"]);
    assert_eq!(heard(TimeStamp::Absolute, 0), ["message [1] from T0 for 30"]);
    assert_eq!(heard(TimeStamp::Absolute, 10), ["message [1] from T0 for 20"], "ten too few");
    assert_eq!(heard(TimeStamp::Absolute, 40), ["nothing"], "it seems to be over");
}

#[test]
fn a_timer_that_waits_for_a_busy_task_stops_the_clock_of_its_node() {
    let delayed = |job_request| {
        let mut net = VirtualCell::new(cell(|rules| rules.job_request = job_request));
        net.ask(Y, Request::Delay { id: TimeId(1), length: Ticks(5) });
        net.ask(X, Request::Work);
        net.run(20);
        assert_eq!(net.nodes[0].node.now(), Instant(20), "what its parts did not count is over for good");
        let while_x_works = net.heard(Y);
        net.ask(X, Request::Done);
        net.ask(X, get(9));
        net.run(5);
        (while_x_works, net.heard(Y))
    };
    assert_eq!(delayed(JobRequest::Standing), (vec!["time_out 1".into()], vec![]));
    assert_eq!(delayed(JobRequest::Blocking), (vec![], vec!["time_out 1".into()]));
}

#[test]
fn a_copy_runs_again_where_commands_are_forgotten_too_soon() {
    let runs = |memory| {
        let table = table(|rules| rules.memory = memory);
        let (mut x, mut z) = (Solo::new(&table, X), Solo::new(&table, Z));
        let command = x.ask(send(MOVE, Z, 7)).packets[0];
        let mut runs = 0;
        for _ in 0..2 {
            z.hear(command);
            if let Some(delivery) = z.ask(get(0)).delivery() {
                runs += 1;
                z.ask(reply(&delivery, 1));
            }
        }
        runs
    };
    assert_eq!([Memory::TtlAndLink, Memory::UntilAnswered, Memory::None].map(runs), [1, 2, 2]);
}

#[test]
fn a_reply_after_the_time_out_is_taken_where_the_sender_does_not_refuse_it() {
    let heard = |refuse| {
        let table = table(|rules| rules.refuse_late_replies = refuse);
        let (mut x, mut z) = (Solo::new(&table, X), Solo::new(&table, Z));
        let command = x.ask(send(MOVE, Z, 7)).packets[0];
        z.hear(command);
        let delivery = z.ask(get(0)).delivery().expect("the command");
        let answer = z.ask(reply(&delivery, 3)).packets[0];
        assert_eq!(x.pass(30).words().last().map(String::as_str), Some("TimedOutUnknown"));
        x.hear(answer).words()
    };
    assert_eq!(heard(true), Vec::<String>::new());
    assert_eq!(heard(false), ["reply [3]"], "the task has handled the exception already");
}

#[test]
fn the_budget_of_a_receiver_ends_before_the_sender_stops_waiting_but_in_the_variant() {
    let budget = |reserve| {
        let table = table(|rules| rules.reserve_way_back = reserve);
        let (mut x, mut z) = (Solo::new(&table, X), Solo::new(&table, Z));
        let command = x.ask(send(MOVE, Z, 7)).packets[0];
        z.hear(command);
        z.ask(get(0)).delivery().expect("the command").budget
    };
    assert_eq!([true, false].map(budget), [Ticks(28), Ticks(30)]);
}

#[test]
fn a_confirm_that_everybody_would_ignore_can_be_forgotten() {
    let table = table(|_| ());
    let (mut x, mut z) = (Solo::new(&table, X), Solo::new(&table, Z));
    x.ask(arrive(LIFT));
    let released = x.hear(z.ask(arrive(LIFT)).packets[0]);
    assert_eq!(released.words().last().map(String::as_str), Some("released r1 complete"));
    // One packet of a meeting may be lost (D2), so the CONFIRM is sent twice.
    assert_eq!((x.task.owes(LIFT), x.task.next_expiry()), (Some(Round(1)), Some(Ticks(6))));
    for port in [MOVE, LIFT] {
        x.task.settle(port);
    }
    assert_eq!((x.task.owes(LIFT), x.task.next_expiry()), (None, None));
    assert!(x.pass(20).is_nothing());
}

#[test]
fn both_ends_must_agree_on_what_a_message_says() {
    let with = |format: &str| {
        let mut cell = cell(|_| ());
        cell.ports[HEARTBEAT.index()] = cell.ports[HEARTBEAT.index()].clone().format(format);
        CellTable::new(cell).expect("a checked cell")
    };
    let (ours, theirs) = (with("height: int16"), with("height: int32"));
    let hash = |table: &CellTable, port: PortId| table.port(port).map(|port| port.hash);
    assert_ne!(hash(&ours, HEARTBEAT), hash(&theirs, HEARTBEAT));
    assert_eq!(hash(&ours, MOVE), hash(&theirs, MOVE));
    assert_ne!(ours.digest(), theirs.digest());
}
