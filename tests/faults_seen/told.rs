//! Tests of faults that no run of this command can cause: a stub node reports them.

use super::scene::Scene;
use crate::support::runtime_dir;
use crate::support::stub::{Stub, Tells};
use imrs_protocol::{
    Cell, CellTable, Class, Event, Incarnation, MeetingState, MeetingView, MemberView, Observation,
    PortCounters, PortDecl, PortId, PortView, Round, TaskId, TaskState, TaskView, Ticks, TransitView, Usage,
};
use imrs_wire::obs::{Count, Liveness, NodeIdentity, Snapshot, Table, TaskSnapshot, TimedEvent};
use std::time::Duration;

const LEFT: TaskId = TaskId(0);
const RIGHT: TaskId = TaskId(1);
const MEET: PortId = PortId(0);
const MOVE: PortId = PortId(1);
const NEWS: PortId = PortId(2);

fn cell() -> Table {
    let mut cell = Cell::new("told", Ticks(50_000));
    let node = cell.node("na");
    let (left, right) = (cell.task("left", node), cell.task("right", node));
    cell.port(PortDecl::new("meet", left, Usage::Waitfor, &[right], Ticks(60_000_000)));
    cell.port(
        PortDecl::new("move", left, Usage::Send, &[right], Ticks(60_000_000)).command().bounded_buffer(8),
    );
    cell.port(PortDecl::new("news", left, Usage::Send, &[right], Ticks(60_000_000)).bounded_buffer(8));
    Table::of(&CellTable::new(cell).expect("a cell"))
}

fn port(port: PortId, usage: Usage, class: Class, capacity: u16) -> PortView {
    let counters = PortCounters { sent: 900, enqueued: 900, delivered: 900, ..PortCounters::default() };
    PortView { port, usage, class, len: 0, capacity, min_slack: None, queue: Vec::new(), counters }
}

/// A node's state in which both tasks run, and no message waits.
fn healthy() -> Snapshot {
    let task = |task: TaskId| {
        let (usage, capacity) = if task == LEFT { (Usage::Send, 0) } else { (Usage::Receive, 8) };
        let member = |task| MemberView { task, arrived: false, confirmed: false, remaining: None };
        let meeting = MeetingView {
            port: MEET,
            round: Round(4),
            released: Round(3),
            state: MeetingState::Away,
            remaining: None,
            members: [LEFT, RIGHT].map(member).into(),
        };
        let ports = vec![
            port(MEET, Usage::Waitfor, Class::Command, 0),
            port(MOVE, usage, Class::Command, capacity),
            port(NEWS, usage, Class::Status, capacity),
        ];
        let view = TaskView { task, state: TaskState::Running, ports, meetings: vec![meeting] };
        TaskSnapshot { liveness: Liveness::Alive, age_us: 0, view }
    };
    Snapshot {
        tasks: [LEFT, RIGHT].map(task).into(),
        transit: TransitView { capacity: 16, ..TransitView::default() },
        ..Snapshot::default()
    }
}

/// A stub node without faults, and a monitor that watches it.
pub fn scene() -> Scene {
    let dir = runtime_dir();
    let identity = NodeIdentity {
        cell: "told".into(),
        digest: 1,
        node: "na".into(),
        id: 0,
        incarnation: Incarnation(1),
        tick_us: 1,
    };
    let tells = Tells { snapshot: healthy(), ..Tells::default() };
    let stub = Stub::start(dir.path(), identity, cell(), tells);
    Scene::watching(dir, stub)
}

/// Reports this fault after a second without faults. It must raise `lint` and nothing else.
fn raises(lint: &str, fault: impl FnOnce(&mut Tells, u64)) {
    let mut scene = scene();
    scene.is_calm_for(Duration::from_secs(1));
    let since = scene.tell(fault);
    scene.raises(since, lint, &[]);
}

fn of(tells: &mut Tells, task: TaskId, port: PortId) -> &mut PortView {
    let ports = &mut tells.snapshot.tasks[task.index()].view.ports;
    ports.iter_mut().find(|view| view.port == port).expect("a port")
}

#[test]
fn a_command_that_gave_way_is_told_and_so_is_any_other_message() {
    raises("command-evicted", |tells, _| of(tells, RIGHT, MOVE).counters.evicted = 1);
    raises("evicted", |tells, _| of(tells, RIGHT, NEWS).counters.evicted = 1);
}

#[test]
fn a_round_that_one_member_left_and_the_other_did_not_is_divergent() {
    raises("divergent-rendezvous", |tells, now| {
        let event = |at: u64, task: TaskId, event: Event| {
            let what = Observation { event, port: MEET, peer: task, number: 4, remaining: Ticks(1) };
            TimedEvent { mono_us: now - 1_000 + at, task: Some(task), what }
        };
        tells.events = vec![
            event(0, LEFT, Event::Reached),
            event(10, RIGHT, Event::Reached),
            event(20, LEFT, Event::ReleasedComplete),
            event(30, RIGHT, Event::GaveUp),
        ];
    });
}

/// All members have arrived, but a CONFIRM is lost, and one member came too late to be released without it.
pub fn lost_confirmation(tells: &mut Tells, _: u64) {
    for task in &mut tells.snapshot.tasks {
        let remaining = Some(Ticks(40_000_000));
        task.view.state = TaskState::Waiting { port: MEET, round: Round(4), remaining: Ticks(40_000_000) };
        let meeting = &mut task.view.meetings[0];
        (meeting.state, meeting.remaining) = (MeetingState::Gathering, remaining);
        for member in &mut meeting.members {
            (member.arrived, member.remaining) = (true, remaining);
        }
    }
    // The left member is about to be released, but the right one must still learn of its arrival.
    let meeting = &mut tells.snapshot.tasks[LEFT.index()].view.meetings[0];
    meeting.state = MeetingState::WithinMargin;
    meeting.members[RIGHT.index()].arrived = false;
}

#[test]
fn who_can_only_be_confirmed_is_within_the_margin() {
    raises("within-margin", lost_confirmation);
}

#[test]
fn a_full_transit_buffer_is_told() {
    raises("transit-full", |tells, _| tells.snapshot.transit.len = 15);
}

#[test]
fn datagrams_that_cannot_be_used_are_told() {
    raises("link-discards", |tells, _| {
        tells.snapshot.link_discards = vec![Count { name: "send_failed".into(), count: 3 }];
    });
}

/// Of thirty timers, twenty ended late.
pub fn late_timers(tells: &mut Tells, _: u64) {
    let timer = &mut tells.vitals.timer;
    (timer.count, timer.late, timer.p50_us) = (30, 20, 70_000);
}

/// A single late timer raises nothing; many late timers do.
#[test]
fn timers_that_are_late_as_a_rule_are_told() {
    raises("timer-late", late_timers);
}
