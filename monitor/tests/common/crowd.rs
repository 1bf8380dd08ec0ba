//! A large cell for these tests: twelve nodes with 108 ports.

use super::{Stage, ms};
use imrs_monitor::app::Msg;
use imrs_monitor::source::Feed;
use imrs_monitor::specimen::Specimen;
use imrs_monitor::store::conformance::{Conformance, Verdict};
use imrs_monitor::theme::Theme;
use imrs_protocol::*;
use imrs_wire::obs::{
    Events, NodeIdentity, PartyName, PortName, ServerFrame, Snapshot, Table, TimedEvent, TimerEntry,
};
use std::time::Duration;

/// Twelve nodes with three tasks each, which have three ports each.
pub const CROWD: Specimen = Specimen { nodes: 12, tasks: 3, ports: 3, queue_limit: 6 };

/// When a node of the crowd dies.
pub const CROWD_DEATH: Duration = ms(6_200);
/// When the last states of the crowd arrive.
pub const CROWD_NOW: Duration = ms(9_000);

/// The state of a node of the large cell in which no message waits, so that none can be late.
fn calm(node: u16) -> Snapshot {
    let mut state = CROWD.snapshot(node);
    for port in state.tasks.iter_mut().flat_map(|task| &mut task.view.ports) {
        (port.len, port.min_slack) = (0, None);
        port.queue.clear();
    }
    state
}

/// Adds the events of a tenth of a second at a node of the large cell. Its first task takes messages; nodes with higher
/// numbers take more.
fn go_on(state: &mut Snapshot, node: u16, period: u64) {
    state.mono_us += 100_000;
    state.uptime_us += 100_000;
    let port = &mut state.tasks[0].view.ports[0];
    port.counters.delivered += 1 + (u64::from(node) + period / 10) % 5;
    port.len = u16::try_from((period + u64::from(node)) % 5).unwrap();
    port.min_slack = (port.len > 0).then(|| Ticks(400_000 + 20_000 * ((period * 7) % 11)));
}

impl Stage {
    /// The large cell after eight seconds. Node 3 is then dead, and messages expire and are refused at node 5.
    pub fn crowd(theme: Theme) -> Self {
        Self::crowd_for(theme, 80)
    }

    /// As [`crowd`](Self::crowd), after `tenths` tenths of a second. Node 3 dies at [`CROWD_DEATH`].
    pub fn crowd_for(theme: Theme, tenths: u64) -> Self {
        Self::crowd_that(theme, tenths, false)
    }

    /// The large cell at work, after eight seconds: messages wait, timers run, tasks meet at `gather`, and the validator
    /// judges. Three tasks wait for a task of node 3, which is dead.
    pub fn crowd_at_work(theme: Theme) -> Self {
        let mut stage = Self::crowd_that(theme, 80, true);
        for node in [0, 5, 7] {
            stage.frame(CROWD_NOW, node.into(), ServerFrame::Events(served(node)));
        }
        stage
    }

    fn crowd_that(theme: Theme, tenths: u64, at_work: bool) -> Self {
        let mut stage = Self::new(theme);
        for mut arrival in CROWD.arrivals(ms(1_000)) {
            if let Feed::Frame(frame) = &mut arrival.feed
                && let ServerFrame::Table(table) = &mut **frame
                && at_work
            {
                add_gathering(table);
            }
            stage.app.update(Msg::Feed(arrival), ms(1_000));
        }
        let mut states: Vec<_> = (0..CROWD.nodes).map(calm).collect();
        for period in 0..tenths {
            let now = ms(1_100 + 100 * period);
            if now > CROWD_DEATH && now <= CROWD_DEATH + ms(100) {
                stage.lose(CROWD_DEATH, 3);
            }
            for (node, state) in (0..CROWD.nodes).zip(&mut states) {
                if node == 3 && period >= 50 {
                    continue;
                }
                go_on(state, node, period);
                if node == 5 && period >= 40 {
                    state.tasks[0].view.ports[1].counters.expired += 1;
                    state.tasks[0].view.ports[1].counters.refused += u64::from(period % 10 == 0);
                }
                let mut sent = state.clone();
                if at_work {
                    work(&mut sent, node, period);
                }
                stage.frame(now, node.into(), ServerFrame::Snapshot(sent));
            }
            if at_work && period == 60 {
                stage.judge_crowd(now);
            }
        }
        for node in [1, 5, 8] {
            stage.frame(CROWD_NOW, node.into(), ServerFrame::Events(happened(node)));
        }
        stage
    }

    /// The validator has compared the recordings of most nodes.
    fn judge_crowd(&mut self, now: Duration) {
        for node in (0..CROWD.nodes).filter(|node| ![3, 10].contains(node)) {
            let said = Conformance { verdict: Verdict::Conforms, steps: 4_000 + 7 * u64::from(node) };
            let (cell, node) = ("specimen".to_owned(), format!("node{node}"));
            self.feed(now, 0, Feed::Judged { cell, node, incarnation: 1, said: Box::new(said) });
        }
    }

    /// A new incarnation of a node of the large cell.
    pub fn crowd_again(&mut self, at: Duration, node: u16, incarnation: u8) {
        let identity = NodeIdentity {
            cell: "specimen".into(),
            digest: 1,
            node: format!("node{node}"),
            id: node,
            incarnation: Incarnation(incarnation),
            tick_us: 1,
        };
        let attached = Feed::Attached { identity, pid: 2_000 + u32::from(incarnation), build: "imrs".into() };
        self.feed(at, node.into(), attached);
        self.frame(at, node.into(), ServerFrame::Snapshot(calm(node)));
    }
}

/// The nodes whose first tasks meet at the rendezvous of the large cell at work.
const MEETING: [u16; 4] = [0, 2, 3, 7];
/// The rendezvous of the large cell at work: the port after all others.
const GATHER: PortId = PortId(CROWD.nodes * CROWD.tasks * CROWD.ports);
/// The period in which the tasks arrive at the rendezvous, and their time_out in milliseconds.
const ARRIVAL: u64 = 30;
const PATIENCE_MS: u64 = 9_000;

/// Adds a rendezvous to the table of the large cell.
fn add_gathering(table: &mut Table) {
    let party = |node: &u16| PartyName {
        task: TaskId(node * CROWD.tasks),
        usage: Usage::Waitfor,
        time_out: Ticks(1_000 * PATIENCE_MS),
    };
    table.ports.push(PortName {
        name: "gather".into(),
        class: Class::Command,
        capacity: 0,
        margin: Ticks::ZERO,
        parties: MEETING.iter().map(party).collect(),
    });
}

/// Lets the messages of a state have entries, its timers run, and its first task wait at the rendezvous.
fn work(state: &mut Snapshot, node: u16, period: u64) {
    let port = &mut state.tasks[0].view.ports[0];
    let sender = TaskId((node + 1) % CROWD.nodes * CROWD.tasks);
    // The messages of one node have little time left.
    let first = if node == 5 { Ticks(11_000) } else { port.min_slack.unwrap_or(Ticks::ZERO) };
    let entry = |n: u16| QueueEntry {
        source: sender,
        id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(700 + u32::from(n)) },
        class: Class::Status,
        remaining: Ticks(first.0 + 31_000 * u64::from(n)),
    };
    port.queue = (0..port.len).map(entry).collect();
    port.min_slack = port.queue.first().map(|entry| entry.remaining);
    let owner = TaskId(node * CROWD.tasks + 1);
    let timer =
        |id: u8, left_ms: u64| TimerEntry { owner, id: TimeId(id), remaining: Ticks(1_000 * left_ms) };
    state.timers = match node % 4 {
        1 => vec![timer(0, 45), timer(255, 600)],
        2 => vec![timer(2, 20 + u64::from(node))],
        _ => Vec::new(),
    };
    if let Some(own) = MEETING.iter().position(|member| *member == node) {
        gather(state, own, period);
    }
}

/// Lets the first task of a node wait at the rendezvous. The member of the third node never arrives.
fn gather(state: &mut Snapshot, own: usize, period: u64) {
    let waits = period >= ARRIVAL && own != 2;
    let remaining = Ticks(1_000 * PATIENCE_MS.saturating_sub(100 * period.saturating_sub(ARRIVAL)));
    let view = &mut state.tasks[0].view;
    let member = |(i, node): (usize, &u16)| MemberView {
        task: TaskId(node * CROWD.tasks),
        arrived: waits && i != 2,
        confirmed: false,
        remaining: (waits && i != 2).then_some(remaining),
    };
    view.meetings = vec![MeetingView {
        port: GATHER,
        round: Round(4),
        released: Round(3),
        state: if waits { MeetingState::Gathering } else { MeetingState::Away },
        remaining: waits.then_some(remaining),
        members: MEETING.iter().enumerate().map(member).collect(),
    }];
    if waits {
        view.state = TaskState::Waiting { port: GATHER, round: Round(4), remaining };
    }
}

/// Events of a node at work: messages that the first task takes and serves, and copies that it drops. Node 5 serves
/// slowly.
fn served(node: u16) -> Events {
    let step_us = if node == 5 { 25_000 } else { 10_000 };
    let own = TaskId(node * CROWD.tasks);
    let (port, peer) =
        (PortId(own.0 * CROWD.ports), TaskId((own.0 + CROWD.tasks) % (CROWD.nodes * CROWD.tasks)));
    let event = |n: u32| {
        let kinds = [Event::Enqueued, Event::Delivered, Event::Replied, Event::Discarded(Reason::Duplicate)];
        let what = Observation {
            event: kinds[n as usize % 4],
            port,
            peer,
            number: 600 + n / 4,
            remaining: Ticks(150_000 - 1_000 * u64::from(n)),
        };
        TimedEvent { mono_us: 16_300_000 + step_us * u64::from(n) + u64::from(node), task: Some(own), what }
    };
    Events { lost: if node == 7 { 12 } else { 0 }, events: (0..24).map(event).collect() }
}

/// Events of a node of the large cell: messages that are taken, one that expires, one that is rejected.
fn happened(node: u16) -> Events {
    let own = TaskId(node * CROWD.tasks);
    let event = |n: u32| {
        let event = match n {
            7 => Event::Discarded(Reason::Expired),
            11 => Event::Rejected,
            _ => Event::Delivered,
        };
        let port = PortId(own.0 * CROWD.ports);
        let peer = TaskId((own.0 + CROWD.tasks) % (CROWD.nodes * CROWD.tasks));
        let what = Observation { event, port, peer, number: n, remaining: Ticks(90_000) };
        TimedEvent { mono_us: 16_500_000 + 10_000 * u64::from(n) + u64::from(node), task: Some(own), what }
    };
    Events { lost: 0, events: (0..16).map(event).collect() }
}
