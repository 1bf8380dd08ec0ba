//! A large cell for these tests: twelve nodes with 108 ports.

use super::{Stage, ms};
use imrs_monitor::app::Msg;
use imrs_monitor::source::Feed;
use imrs_monitor::specimen::Specimen;
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, Incarnation, Observation, PortId, Reason, TaskId, Ticks};
use imrs_wire::obs::{Events, NodeIdentity, ServerFrame, Snapshot, TimedEvent};
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

    /// The same after so many tenths of a second. Node 3 dies at [`CROWD_DEATH`].
    pub fn crowd_for(theme: Theme, tenths: u64) -> Self {
        let mut stage = Self::new(theme);
        for arrival in CROWD.arrivals(ms(1_000)) {
            stage.app.update(Msg::Feed(arrival), ms(1_000));
        }
        let mut states: Vec<_> = (0..CROWD.nodes).map(calm).collect();
        for period in 0..tenths {
            let now = ms(1_100 + 100 * period);
            for (node, state) in (0..CROWD.nodes).zip(&mut states) {
                if node == 3 && period >= 50 {
                    continue;
                }
                go_on(state, node, period);
                if node == 5 && period >= 40 {
                    state.tasks[0].view.ports[1].counters.expired += 1;
                    state.tasks[0].view.ports[1].counters.refused += u64::from(period % 10 == 0);
                }
                stage.frame(now, node.into(), ServerFrame::Snapshot(state.clone()));
            }
        }
        stage.lose(CROWD_DEATH, 3);
        for node in [1, 5, 8] {
            stage.frame(CROWD_NOW, node.into(), ServerFrame::Events(happened(node)));
        }
        stage
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
