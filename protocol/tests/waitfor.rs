//! `waitfor`: the n-way rendezvous with confirmation (§4.3; D1 to D3, D54, D55).

use crate::support::{Effects, NextExpiry, Solo, arrive};
use imrs_protocol::rules::Confirmation;
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);
const Z: TaskId = TaskId(2);
const LIFT: PortId = PortId(0);

/// `n` tasks, each on its own node; link delay 2 ticks. Arrivals repeat every 6 ticks; the margin covers `losses`.
fn cell_with(n: usize, losses: u8, rules: Rules) -> Cell {
    let mut cell = Cell::new("lift", Ticks(1));
    for i in 0..n {
        let node = cell.node(&format!("n{i}"));
        cell.task(&format!("t{i}"), node);
        for other in 0..i {
            cell.link(NodeId::from_index(other), node, Ticks(2));
        }
    }
    let others: Vec<TaskId> = (1..n).map(TaskId::from_index).collect();
    cell.port(PortDecl::new("lift", X, Usage::Waitfor, &others, Ticks(40)).resend(Ticks(6), losses));
    cell.rules = rules;
    cell
}

fn plain(n: usize) -> Cell {
    cell_with(n, 0, Rules::DEFAULT)
}

fn table(n: usize, losses: u8) -> Arc<CellTable> {
    Arc::new(CellTable::new(cell_with(n, losses, Rules::DEFAULT)).expect("a checked cell"))
}

/// The first packet among the effects for one task.
fn to(effects: &Effects, task: TaskId) -> Packet {
    *effects
        .packets
        .iter()
        .find(|p| p.destination == task)
        .unwrap_or_else(|| panic!("none to {task}: {effects:?}"))
}

#[test]
fn two_meet() {
    let mut net = VirtualCell::new(plain(2));
    net.ask(X, arrive(LIFT));
    net.run(3);
    net.ask(Y, arrive(LIFT));
    net.run(9);
    assert_eq!(
        net.transcript(),
        [
            "0 N0>N1 ARRIVE T0>T1 r1 for 40",
            "3 T1: released r1 complete",
            "3 N1>N0 ARRIVE T1>T0 r1 for 40",
            "3 N1>N0 CONFIRM T1>T0 r1 for 40",
            "4 N0>N1 ARRIVE T0>T1 r1 for 36 again",
            "5 T0: released r1 complete",
            "5 N0>N1 CONFIRM T0>T1 r1 for 40",
            "6 N1>N0 CONFIRM T1>T0 r1 for 40 again",
        ]
    );
}

#[test]
fn three_and_four_meet_in_the_same_round_again_and_again() {
    for n in [3, 4] {
        let mut net = VirtualCell::new(plain(n));
        for round in 1..=5 {
            for i in 0..n {
                net.ask(TaskId::from_index(i), arrive(LIFT));
                net.run(u64::try_from(i).unwrap());
            }
            net.run(4);
            for i in 0..n {
                let told = net.told(TaskId::from_index(i));
                assert!(
                    matches!(told[..], [Signal::Released { round: Round(r), port: LIFT, .. }] if r == round),
                    "n={n} round {round} T{i}: {told:?}"
                );
            }
        }
        assert_eq!(net.count(Event::GaveUp) + net.count(Event::Rejoined), 0);
    }
}

#[test]
fn nobody_is_released_while_one_is_missing_and_all_say_who() {
    let mut net = VirtualCell::new(plain(3));
    net.ask(X, arrive(LIFT));
    net.run(3);
    net.ask(Y, arrive(LIFT));
    net.run(40);
    assert_eq!(net.heard(X), ["gave up r1 missing 0b100"]);
    assert_eq!(net.heard(Y), ["gave up r2 missing 0b101"], "X said that it had gone");
    assert_eq!(net.count(Event::ReleasedComplete) + net.count(Event::ReleasedByConfirm), 0);
}

/// X and Y hold all arrivals; Z has X's CONFIRM but not Y's arrival. Returns the released and the confirming tasks.
fn confirmations(rule: Confirmation) -> (Vec<String>, Vec<&'static str>) {
    let rules = Rules { confirmation: rule, ..Rules::DEFAULT };
    let mut net = VirtualCell::new(cell_with(3, 0, rules));
    // All arrivals from Y to Z are lost.
    net.lose(|from, to, p| (from, to) == (NodeId(1), NodeId(2)) && p.kind == Kind::Arrive);
    for task in [X, Y, Z] {
        net.ask(task, arrive(LIFT));
    }
    net.run(12);
    let released = [X, Y, Z].iter().flat_map(|&t| net.heard(t)).collect();
    let confirms = net.transcript().into_iter().filter(|l| l.contains("CONFIRM") && !l.contains("again"));
    let who = |l: String| ["T0>", "T1>", "T2>"].into_iter().find(|w| l.contains(w)).expect("a task");
    let mut from: Vec<&'static str> = confirms.map(who).collect();
    from.dedup();
    (released, from)
}

#[test]
fn the_four_rules_of_confirmation() {
    let complete = "released r1 complete".to_owned();
    let by_x = "released r1 by T0".to_owned();

    let (released, from) = confirmations(Confirmation::None);
    assert_eq!((released, from.len()), (vec![complete.clone(), complete.clone()], 0), "Z is stranded");

    let (released, from) = confirmations(Confirmation::FirstComplete);
    assert_eq!(released, [complete.clone(), complete.clone(), by_x.clone()]);
    assert_eq!(from, ["T0>", "T1>"], "both completed before they heard of the other");

    let (released, from) = confirmations(Confirmation::EveryComplete);
    assert_eq!(released, [complete.clone(), complete.clone(), by_x.clone()]);
    assert_eq!(from, ["T0>", "T1>"], "Z never holds all arrivals");

    let (released, from) = confirmations(Confirmation::PassOn);
    assert_eq!(released, [complete.clone(), complete, by_x]);
    assert_eq!(from, ["T0>", "T1>", "T2>"], "Z passes on what it was told");
}

#[test]
fn one_that_was_released_by_a_confirm_confirms_once_it_holds_all_arrivals() {
    let table = table(3, 0);
    let mut others = [Y, Z].map(|t| Solo::new(&table, t).ask(arrive(LIFT)));
    let mut x = Solo::new(&table, X);
    x.ask(arrive(LIFT));
    let (from_y, from_z) = (to(&others[0], X), to(&others[1], X));
    let mut y = Solo::new(&table, Y);
    others[0] = y.ask(arrive(LIFT));
    y.hear(Packet { destination: Y, ..from_z });
    let x_arrives = Packet { source: X, destination: Y, ..from_y };
    let confirm = to(&y.hear(x_arrives), X);
    assert_eq!(x.hear(confirm).words(), ["released r1 by T1"]);
    assert_eq!(x.hear(from_y).words(), Vec::<String>::new());
    let now_complete = x.hear(from_z);
    assert_eq!(now_complete.words(), ["CONFIRM T0>T1 r1 for 40", "CONFIRM T0>T2 r1 for 40"]);
    assert_eq!(
        x.hear(from_z).words(),
        ["CONFIRM T0>T2 r1 for 40 again"],
        "owed once; late arrivals are answered"
    );
}

#[test]
fn a_late_arrival_is_confirmed_in_the_released_round_and_aborted_in_older_ones() {
    let table = table(2, 0);
    let (mut x, mut y) = (Solo::new(&table, X), Solo::new(&table, Y));
    let mut arrivals = Vec::new();
    for _ in 0..2 {
        let from_x = to(&x.ask(arrive(LIFT)), Y);
        let from_y = y.ask(arrive(LIFT)).packets[0];
        x.hear(from_y);
        y.hear(from_x);
        arrivals.push(from_y);
    }
    let again = x.hear(Packet { resent: true, ..arrivals[1] });
    assert_eq!(again.words(), ["CONFIRM T0>T1 r2 for 40 again"]);
    let older = x.hear(arrivals[0]);
    assert_eq!(older.words(), ["ABORT T0>T1 r1 next r3 for 40"]);
    x.ask(arrive(LIFT));
    assert_eq!(x.hear(arrivals[1]).words(), ["CONFIRM T0>T1 r2 for 40 again"], "while it waits, too");
    assert_eq!(x.hear(arrivals[0]).words(), ["ABORT T0>T1 r1 next r3 for 40"]);
}

#[test]
fn after_a_give_up_the_members_go_on_in_a_fresher_round_and_meet() {
    let mut net = VirtualCell::new(plain(3));
    net.ask(X, arrive(LIFT));
    net.run(30);
    net.ask(Y, arrive(LIFT));
    net.run(12);
    assert_eq!(net.heard(X), ["gave up r1 missing 0b100"]);
    assert_eq!(net.count(Event::PartnerAborted), 2);
    assert_eq!(net.count(Event::Rejoined), 1, "Y waits in the round that X's ABORT names");
    net.ask(X, arrive(LIFT));
    net.ask(Z, arrive(LIFT));
    net.run(4);
    for task in [X, Y, Z] {
        let told = net.told(task);
        assert!(matches!(told[..], [Signal::Released { round: Round(2), .. }]), "{task}: {told:?}");
    }
}

#[test]
fn a_member_behind_joins_the_fresher_round_it_hears_of() {
    let table = table(3, 0);
    let mut y = Solo::new(&table, Y);
    for _ in 0..3 {
        y.ask(arrive(LIFT));
        y.ask(Request::Cancel);
    }
    let fresher = to(&y.ask(arrive(LIFT)), X);
    let mut x = Solo::new(&table, X);
    x.ask(arrive(LIFT));
    x.pass(5);
    assert_eq!(x.hear(fresher).words(), ["ARRIVE T0>T1 r4 for 35", "ARRIVE T0>T2 r4 for 35"]);
    let mut away = Solo::new(&table, X);
    away.hear(fresher);
    assert_eq!(away.ask(arrive(LIFT)).words(), ["ARRIVE T0>T1 r4 for 40", "ARRIVE T0>T2 r4 for 40"]);
}

#[test]
fn word_that_the_round_was_released_is_a_confirm() {
    let table = table(2, 0);
    let (mut x, mut y) = (Solo::new(&table, X), Solo::new(&table, Y));
    let from_x = to(&x.ask(arrive(LIFT)), Y);
    y.ask(arrive(LIFT));
    assert_eq!(y.hear(from_x).words().last().map(String::as_str), Some("released r1 complete"));
    let next = to(&y.ask(arrive(LIFT)), X);
    assert_eq!(next.meeting(), Meeting { round: Round(2), released: Round(1), arguments: [0; 8] });
    // Y's arrival and CONFIRM of round 1 were lost. Y's arrival in round 2 says that Y was released from round 1.
    assert_eq!(x.hear(next).words(), ["released r1 by T1"]);
    // The arrival in round 2 is kept for the next meeting.
    let words = x.ask(arrive(LIFT)).words();
    assert_eq!(words, ["ARRIVE T0>T1 r2 for 40", "CONFIRM T0>T1 r2 for 40", "released r2 complete"]);
}

#[test]
fn arrivals_are_repeated_counted_back_from_the_deadline() {
    let table = table(2, 0);
    let mut x = Solo::new(&table, X);
    x.ask(arrive(LIFT));
    let mut left = Vec::new();
    for _ in 0..10 {
        let Some(due) = x.task.next_expiry() else { break };
        let out = x.pass(due.0);
        left.extend(out.packets.iter().filter(|p| p.kind == Kind::Arrive).map(|p| p.remaining.0));
    }
    assert_eq!(left, [36, 30, 24, 18, 12, 6]);
}

#[test]
fn a_late_driver_repeats_its_arrival_once() {
    let table = table(2, 0);
    let mut x = Solo::new(&table, X);
    x.ask(arrive(LIFT));
    assert_eq!(x.pass(20).words(), ["ARRIVE T0>T1 r1 for 20 again"]);
    assert_eq!(x.task.next_expiry(), Some(Ticks(2)), "back on the grid that the deadline gives");
    assert_eq!(x.pass(2).words(), ["ARRIVE T0>T1 r1 for 18 again"]);
    assert_eq!(x.pass(90).words(), ["ABORT T0>T1 r1 next r2 for 40", "gave up r1 missing 0b10"]);
}

#[test]
fn a_confirm_is_repeated_as_often_as_packets_may_be_lost_while_the_task_runs() {
    let table = table(2, 2);
    let (mut x, mut y) = (Solo::new(&table, X), Solo::new(&table, Y));
    let from_y = y.ask(arrive(LIFT)).packets[0];
    x.ask(arrive(LIFT));
    assert_eq!(x.hear(from_y).words(), ["CONFIRM T0>T1 r1 for 40", "released r1 complete"]);
    assert!(x.task.is_idle());
    for _ in 0..2 {
        assert!(x.pass(5).is_nothing());
        assert_eq!(x.pass(1).words(), ["CONFIRM T0>T1 r1 for 40 again"]);
    }
    assert_eq!(x.task.next_expiry(), None);
}

#[test]
fn nobody_releases_with_the_margin_or_less_left() {
    let table = table(2, 1);
    let margin = table.port(LIFT).expect("the port").margin;
    assert_eq!(margin, Ticks(2 + 6 + 2), "delay, one more period, a tick for each of two copies");
    let (mut x, mut y) = (Solo::new(&table, X), Solo::new(&table, Y));
    let from_y = y.ask(arrive(LIFT)).packets[0];
    x.ask(arrive(LIFT));
    let within = x.hear(Packet { remaining: margin, ..from_y });
    assert!(within.is_nothing());
    assert_eq!(within.observations.last().map(|o| o.event), Some(Event::WithinMargin));
    let view = &x.task.view(&x.table, 0).meetings[0];
    assert_eq!((view.state, view.members[1].remaining), (MeetingState::WithinMargin, Some(margin)));
    let above = x.hear(Packet { remaining: Ticks(margin.0 + 1), ..from_y });
    assert_eq!(above.words().last().map(String::as_str), Some("released r1 complete"));
}

#[test]
fn an_arrival_is_valid_as_long_as_its_sender_waits() {
    let table = table(2, 0);
    let mut x = Solo::new(&table, X);
    let from_y = Solo::new(&table, Y).ask(arrive(LIFT)).packets[0];
    x.hear(Packet { remaining: Ticks(5), ..from_y });
    x.pass(5);
    assert_eq!(x.ask(arrive(LIFT)).words(), ["ARRIVE T0>T1 r1 for 40"], "Y has gone");
}

#[test]
fn cancelling_a_waitfor_tells_the_others() {
    let table = table(3, 0);
    let mut x = Solo::new(&table, X);
    x.ask(arrive(LIFT));
    let words = x.ask(Request::Cancel).words();
    assert_eq!(words, ["ABORT T0>T1 r1 next r2 for 40", "ABORT T0>T2 r1 next r2 for 40", "cancelled"]);
    assert_eq!(x.task.next_expiry(), None);
    assert!(x.pass(50).is_nothing());
}

#[test]
fn an_arrival_that_was_given_up_does_not_count_and_copies_of_it_are_barred() {
    let table = table(2, 0);
    let (mut x, mut y) = (Solo::new(&table, X), Solo::new(&table, Y));
    let from_y = y.ask(arrive(LIFT)).packets[0];
    let abort = y.ask(Request::Cancel).packets[0];
    x.hear(from_y);
    x.hear(abort);
    x.hear(Packet { resent: true, ..from_y });
    assert_eq!(x.ask(arrive(LIFT)).words(), ["ARRIVE T0>T1 r2 for 40"], "it goes on in Y's next round");
    assert_eq!(y.ask(arrive(LIFT)).words(), ["ARRIVE T1>T0 r2 for 40"]);
}

#[test]
fn a_bar_and_a_release_of_long_ago_mean_nothing_when_rounds_come_round() {
    let table = table(2, 0);
    let (mut x, mut y) = (Solo::new(&table, X), Solo::new(&table, Y));
    let meet = |x: &mut Solo, y: &mut Solo| {
        let from_x = to(&x.ask(arrive(LIFT)), Y);
        let released = y.ask(arrive(LIFT));
        y.hear(from_x);
        x.hear(released.packets[0]).signals.last().copied()
    };
    meet(&mut x, &mut y);
    y.ask(arrive(LIFT));
    x.hear(y.ask(Request::Cancel).packets[0]);
    for n in 0..70_000_u32 {
        let told = meet(&mut x, &mut y);
        assert!(
            matches!(told, Some(Signal::Released { by: ReleasedBy::AllArrived, .. })),
            "meeting {n}: {told:?}"
        );
    }

    // From here on every meeting fails, until the round number wraps around to that of the last release.
    let last = x.task.view(&x.table, 0).meetings[0].released;
    let mut from_y = None;
    x.pass(50);
    for _ in 0..0x1_0000_u32 {
        from_y = Some(y.ask(arrive(LIFT)).packets[0]);
        y.ask(Request::Cancel);
        x.ask(arrive(LIFT));
        x.ask(Request::Cancel);
    }
    let late = from_y.expect("an arrival");
    assert_eq!(late.meeting().round, last, "the same number");
    let answer = x.hear(late).packets;
    assert!(answer.iter().all(|p| p.kind == Kind::Abort), "a false release: {answer:?}");
}

#[test]
fn rounds_half_the_circle_ahead_are_not_believed() {
    let table = table(2, 0);
    let mut y = Solo::new(&table, Y);
    y.ask(arrive(LIFT));
    let abort = y.ask(Request::Cancel).packets[0];
    let far = |round, next| {
        let arguments = Meeting::abort_arguments(Round(next));
        let meeting = Meeting { round: Round(round), released: Round(round), arguments };
        Packet { contents: meeting.to_contents(), ..abort }
    };
    let mut x = Solo::new(&table, X);
    x.hear(far(0x58, 0x8007));
    assert_eq!(x.ask(arrive(LIFT)).words(), ["ARRIVE T0>T1 r88 for 40"], "the nearer of the two is");
}

#[test]
fn what_members_tell_each_other_reaches_them() {
    let table = table(2, 0);
    let (mut x, mut y) = (Solo::new(&table, X), Solo::new(&table, Y));
    let tell = |arguments| Request::Arrive { port: LIFT, arguments, time_out: Some(Ticks(30)) };
    let from_y = y.ask(tell(*b"speed 40")).packets[0];
    assert_eq!(from_y.remaining, Ticks(30));
    x.ask(arrive(LIFT));
    x.hear(from_y);
    assert_eq!(x.task.meeting_arguments(&x.table, LIFT, Y), Some(*b"speed 40"));
    assert_eq!(x.task.meeting_arguments(&x.table, LIFT, X), None);
}

#[test]
fn a_monitor_sees_how_far_a_meeting_has_come() {
    let mut net = VirtualCell::new(plain(3));
    let look = |net: &VirtualCell| {
        let node = &net.nodes[0].node;
        let view = node.task(X).expect("X").view(&node.parts().table, 0);
        let meeting = &view.meetings[0];
        let arrived: Vec<bool> = meeting.members.iter().map(|member| member.arrived).collect();
        (meeting.state, arrived)
    };
    assert_eq!(look(&net), (MeetingState::Away, vec![false; 3]));
    net.ask(X, arrive(LIFT));
    assert_eq!(look(&net), (MeetingState::Gathering, vec![true, false, false]));
    net.ask(Y, arrive(LIFT));
    net.run(3);
    assert_eq!(look(&net), (MeetingState::Gathering, vec![true, true, false]));
}
