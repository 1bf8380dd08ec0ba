//! Tests of deltas: they are exact and small, and forged deltas do no harm.

use imrs_protocol::*;
use imrs_wire::obs::*;
use proptest::prelude::*;

const TASKS: u16 = 100;
const PORTS: u16 = 100;

fn port(id: u16, seed: u64) -> PortView {
    let entry = |i: u64| QueueEntry {
        source: TaskId(1),
        id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(i as u32) },
        class: Class::Status,
        remaining: Ticks(100_000 + i * 10_000 + seed),
    };
    PortView {
        port: PortId(id),
        usage: if id.is_multiple_of(3) { Usage::Send } else { Usage::Receive },
        class: Class::Status,
        len: 2,
        capacity: 8,
        min_slack: Some(Ticks(100_000 + seed)),
        queue: (0..seed % 3).map(entry).collect(),
        counters: PortCounters { sent: seed, enqueued: 3, ..PortCounters::default() },
    }
}

fn task(id: u16, ports: u16, seed: u64) -> TaskSnapshot {
    let member = |task: u16| MemberView {
        task: TaskId(task),
        arrived: true,
        confirmed: false,
        remaining: Some(Ticks(300_000 + seed)),
    };
    let meeting = MeetingView {
        port: PortId(9_000),
        round: Round(4),
        released: Round(3),
        state: MeetingState::Gathering,
        remaining: Some(Ticks(250_000)),
        members: vec![member(0), member(1)],
    };
    let state = match seed % 4 {
        0 => TaskState::Running,
        1 => TaskState::Receiving { port: None, remaining: Some(Ticks(90_000)) },
        2 => TaskState::Receiving { port: None, remaining: None },
        _ => TaskState::AwaitingReply { port: PortId(2), from: TaskId(3), remaining: Ticks(70_000) },
    };
    TaskSnapshot {
        liveness: Liveness::Alive,
        age_us: 40,
        view: TaskView {
            task: TaskId(id),
            state,
            ports: (0..ports).map(|i| port(id * ports + i, seed + u64::from(i))).collect(),
            meetings: vec![meeting; usize::from(seed.is_multiple_of(2))],
        },
    }
}

fn snapshot(tasks: u16, ports: u16, seed: u64) -> Snapshot {
    Snapshot {
        mono_us: 50_000_000 + seed,
        uptime_us: 9_000_000,
        tasks: (0..tasks).map(|id| task(id, ports, seed + u64::from(id))).collect(),
        transit: TransitView {
            len: 1,
            capacity: 8,
            min_slack: Some(Ticks(50_000)),
            ..TransitView::default()
        },
        timers: vec![TimerEntry { owner: TaskId(0), id: TimeId(1), remaining: Ticks(400_000) }],
        links: vec![LinkView { peer: NodeId(1), heard_us: Some(900), sent: 10, received: 9 }],
        discards: Reason::ALL.iter().map(|r| Count { name: r.name().into(), count: seed }).collect(),
        ..Snapshot::default()
    }
}

/// The snapshot that follows `passed` microseconds later if nothing happens. Some state machines advance, others do not.
fn later(of: &Snapshot, passed: u64, advanced: impl Fn(usize) -> u64) -> Snapshot {
    let mut new = of.clone();
    (new.mono_us, new.uptime_us) = (of.mono_us + passed, of.uptime_us + passed);
    new.transit_age_us += passed;
    for (i, task) in new.tasks.iter_mut().enumerate() {
        let own = advanced(i).min(passed + task.age_us);
        task.age_us = task.age_us + passed - own;
        let own = Ticks(own);
        let older = |left: Option<Ticks>| left.map(|left| left - own);
        task.view.state = match task.view.state {
            TaskState::Receiving { port, remaining } => {
                TaskState::Receiving { port, remaining: older(remaining) }
            }
            TaskState::AwaitingReply { port, from, remaining } => {
                TaskState::AwaitingReply { port, from, remaining: remaining - own }
            }
            other => other,
        };
        for port in &mut task.view.ports {
            port.min_slack = older(port.min_slack);
            port.queue.iter_mut().for_each(|entry| entry.remaining = entry.remaining - own);
        }
        for meeting in &mut task.view.meetings {
            meeting.remaining = older(meeting.remaining);
            meeting.members.iter_mut().for_each(|member| member.remaining = older(member.remaining));
        }
    }
    new.timers.iter_mut().for_each(|timer| timer.remaining = timer.remaining - Ticks(passed));
    new.links.iter_mut().for_each(|link| link.heard_us = link.heard_us.map(|ago| ago + passed));
    new
}

/// Changes one field or part of a snapshot.
fn edit(of: &mut Snapshot, (what, at, value): (u8, usize, u64)) {
    let count = of.tasks.len().max(1);
    let narrow = (value % 60_000) as u16;
    let Some(task) = of.tasks.get_mut(at % count) else { return };
    let ports = task.view.ports.len().max(1);
    let port = task.view.ports.get_mut(at / 7 % ports);
    match what {
        0 => task.age_us = value,
        1 => task.liveness = Liveness::Crashed,
        2 => {
            task.view.state =
                TaskState::Waiting { port: PortId(1), round: Round(narrow), remaining: Ticks(value) }
        }
        3 => port
            .into_iter()
            .for_each(|port| port.counters.dropped = port.counters.dropped.wrapping_add(value)),
        4 => port.into_iter().for_each(|port| port.min_slack = (narrow & 1 == 0).then_some(Ticks(value))),
        5 => port.into_iter().for_each(|port| port.queue.truncate(port.queue.len().saturating_sub(1))),
        6 => port.into_iter().for_each(|port| port.port = PortId(narrow)),
        7 => drop(task.view.ports.pop()),
        8 => task.view.meetings.iter_mut().for_each(|meeting| meeting.round = Round(narrow)),
        9 => drop(task.view.meetings.pop()),
        10 => task.view.task = TaskId(narrow),
        11 => drop(of.tasks.remove(at % count)),
        12 => of.mono_us = value,
        13 => of.uptime_us = value,
        14 => of.transit.forwarded = value,
        15 => of.transit_age_us = value,
        16 => of.timers.push(TimerEntry { owner: TaskId(1), id: TimeId(2), remaining: Ticks(value) }),
        17 => of.links.iter_mut().for_each(|link| link.sent = value),
        18 => of.links.clear(),
        19 => of.discards.iter_mut().for_each(|count| count.count = value),
        20 => of.link_discards.push(Count { name: value.to_string(), count: value }),
        21 => (of.insecure, of.real_time) = (true, RealTime::Had),
        _ => port.into_iter().for_each(|port| (port.capacity, port.len) = (narrow, narrow)),
    }
}

fn edits() -> impl Strategy<Value = Vec<(u8, usize, u64)>> {
    proptest::collection::vec((0..23_u8, any::<usize>(), any::<u64>()), 0..8)
}

proptest! {
    #[test]
    fn what_changed_leads_from_any_snapshot_to_any(
        seed in 0..50_u64, before in edits(), after in edits(), passed in 0..1_000_000_u64, own in 0..1_000_000_u64,
    ) {
        let mut old = snapshot(4, 5, seed);
        before.into_iter().for_each(|what| edit(&mut old, what));
        let mut new = if old.mono_us < 1 << 40 && old.uptime_us < 1 << 40 && old.transit_age_us < 1 << 40
            && old.tasks.iter().all(|task| task.age_us < 1 << 40) {
            later(&old, passed, |i| if i % 2 == 0 { own } else { 0 })
        } else {
            snapshot(4, 5, seed)
        };
        after.into_iter().for_each(|what| edit(&mut new, what));
        let delta = Delta::between(&old, &new);
        let bytes = postcard::to_allocvec(&ServerFrame::Delta(delta)).unwrap();
        let Ok(ServerFrame::Delta(delta)) = ServerFrame::decode(&bytes) else { panic!("no delta") };
        let mut got = old.clone();
        prop_assert_eq!(got.apply(&delta), Ok(()));
        prop_assert_eq!(&got, &new);
        prop_assert_eq!(got.apply(&Delta::whole(&old)), Ok(()));
        prop_assert_eq!(&got, &old);
    }

    /// Applies a delta of one snapshot to any other snapshot: `apply` either returns an error and changes nothing, or
    /// gives some snapshot.
    #[test]
    fn what_changed_elsewhere_is_borne(seed in 0..50_u64, after in edits(), damage in (any::<usize>(), any::<u8>()), tasks in 0..5_u16) {
        let (old, mut new) = (snapshot(4, 5, seed), snapshot(4, 5, seed + 1));
        after.into_iter().for_each(|what| edit(&mut new, what));
        let mut bytes = postcard::to_allocvec(&ServerFrame::Delta(Delta::between(&old, &new))).unwrap();
        let at = damage.0 % bytes.len();
        bytes[at] = damage.1;
        let Ok(ServerFrame::Delta(mut delta)) = ServerFrame::decode(&bytes) else { return Ok(()) };
        let mut other = snapshot(tasks, 3, seed);
        if delta.base_us.is_some() {
            delta.base_us = Some(other.mono_us);
        }
        let before = other.clone();
        if other.apply(&delta).is_err() {
            prop_assert_eq!(other, before);
        }
    }
}

#[test]
fn what_only_grew_older_costs_nothing() {
    let old = snapshot(TASKS, PORTS, 0);
    let quiet = later(&old, 100_000, |_| 0);
    let bytes = postcard::to_allocvec(&ServerFrame::Delta(Delta::between(&old, &quiet))).unwrap();
    println!("an idle node of 10,000 ports: {} bytes a period", bytes.len());
    assert!(bytes.len() <= 32, "{} bytes", bytes.len());
    // If time advances in a task, that costs a few bytes for the task, and nothing for its ports.
    let busy = later(&old, 100_000, |i| if i == 7 { 99_000 } else { 0 });
    let one = postcard::to_allocvec(&ServerFrame::Delta(Delta::between(&old, &busy))).unwrap();
    assert!(one.len() <= bytes.len() + 16, "{} bytes", one.len());
}

#[test]
fn a_change_of_another_snapshot_is_told_apart() {
    let (mut old, new) = (snapshot(2, 2, 0), snapshot(2, 2, 4));
    let mut third = snapshot(2, 2, 9);
    let before = third.clone();
    let error = third.apply(&Delta::between(&old, &new));
    assert_eq!(error, Err(DeltaError::OtherBase { wanted: old.mono_us, have: before.mono_us }));
    let mut forged = Delta::between(&old, &new);
    let Changed::Parts(tasks) = &mut forged.tasks else { panic!("in parts") };
    tasks[0].skip = u32::MAX;
    assert_eq!(old.clone().apply(&forged), Err(DeltaError::NoSuchPart));
    let mut forged = Delta::between(&old, &new);
    let Changed::Parts(tasks) = &mut forged.tasks else { panic!("in parts") };
    let TaskChange::Parts(parts) = &mut tasks[0].what else { panic!("in parts") };
    parts.ports[0].what.by.clear();
    assert_eq!(old.apply(&forged), Err(DeltaError::OtherCounters));
    assert_eq!(third, before);
}

/// Ten thousand ports are shown at 10 Hz, while 5 % of the ports of every task change in each period.
#[test]
fn ten_thousand_ports_fit_the_budget() {
    let mut state = snapshot(TASKS, PORTS, 0);
    for port in state.tasks.iter_mut().flat_map(|task| &mut task.view.ports) {
        port.queue.clear();
        port.counters = PortCounters { enqueued: 9_120, delivered: 9_041, ..port.counters };
    }
    let whole = postcard::to_allocvec(&ServerFrame::Delta(Delta::whole(&state))).unwrap().len();
    let (mut bytes, mut draw) = (0, 1_u64);
    for _ in 0..10 {
        let mut new = later(&state, 100_000, |_| 99_000);
        for task in &mut new.tasks {
            for port in task.view.ports.iter_mut().skip(usize::from(draw.is_multiple_of(7))).step_by(20) {
                draw = draw.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                port.counters.enqueued += 20;
                port.counters.delivered += 20;
                port.len = (draw >> 40) as u16 % 8;
                port.min_slack = Some(Ticks((draw >> 30) % 200_000));
            }
        }
        bytes += postcard::to_allocvec(&ServerFrame::Delta(Delta::between(&state, &new))).unwrap().len() + 4;
        state = new;
    }
    println!("10,000 ports: whole {whole} bytes, 5 % dirty at 10 Hz {bytes} bytes a second");
    assert!(whole <= 200_000, "{whole} bytes");
    assert!(bytes <= 100_000, "{bytes} bytes a second");
}

/// The bit of a kind of event is the kind's variant number in the encoding, so that both sides mean the same kind.
#[test]
fn kinds_of_events_are_their_places_in_the_encoding() {
    for event in [Event::Sent, Event::PeerRestarted, Event::Reached, Event::GaveUp, Event::Fenced] {
        let place = postcard::to_allocvec(&event).unwrap()[0];
        let bits = postcard::to_allocvec(&Kinds::NONE.and(event)).unwrap();
        let (bits, _) = postcard::take_from_bytes::<u64>(&bits).unwrap();
        assert_eq!(bits, 1 << place, "{event:?}");
    }
    let drops = Kinds::NONE.and(Event::Discarded(Reason::Expired));
    assert!(Reason::ALL.iter().all(|&reason| drops.has(Event::Discarded(reason))));
    assert!(!drops.has(Event::Sent) && Kinds::ALL.has(Event::Fenced));
}
