//! M7: ten minutes of ten thousand ports in the memory of one process of its own.

mod common;

use common::{Stage, identity, ms};
use imrs_monitor::history::BUDGET;
use imrs_monitor::source::Feed;
use imrs_monitor::theme::Theme;
use imrs_protocol::*;
use imrs_wire::obs::{Delta, Liveness, ServerFrame, Snapshot, TaskSnapshot};

const TASKS: u16 = 100;
const PORTS: u16 = 100;
/// Ten minutes of ten periods a second.
const PERIODS: u64 = 6_000;

fn snapshot() -> Snapshot {
    let port = |i: u16| PortView {
        port: PortId(i),
        usage: Usage::Receive,
        class: Class::Status,
        len: 1,
        capacity: 8,
        min_slack: Some(Ticks(100_000 + u64::from(i))),
        queue: Vec::new(),
        counters: PortCounters { enqueued: 9_120, delivered: 9_041, ..PortCounters::default() },
    };
    let task = |t: u16| TaskSnapshot {
        liveness: Liveness::Alive,
        age_us: 0,
        view: TaskView {
            task: TaskId(t),
            state: TaskState::Running,
            ports: (t * PORTS..(t + 1) * PORTS).map(port).collect(),
            meetings: Vec::new(),
        },
    };
    Snapshot { tasks: (0..TASKS).map(task).collect(), ..Snapshot::default() }
}

/// One period later: of each task so many ports in a hundred did something.
fn go_on(state: &mut Snapshot, period: u64, dirty: usize) {
    state.mono_us += 100_000;
    state.uptime_us += 100_000;
    for (t, task) in state.tasks.iter_mut().enumerate() {
        task.age_us = 0;
        for (i, port) in task.view.ports.iter_mut().enumerate() {
            port.min_slack = port.min_slack.map(|left| left - Ticks(100_000));
            let draw = (period * 31 + i as u64 * 7 + t as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 33;
            if (i + period as usize).is_multiple_of(100 / dirty) {
                port.counters.enqueued += 20;
                port.counters.delivered += 20;
                port.len = (draw % 8) as u16;
                port.min_slack = Some(Ticks(draw % 200_000));
            }
        }
    }
}

/// The resident memory of this process, in bytes.
fn resident() -> usize {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.split_whitespace().next().unwrap().parse::<usize>().unwrap() * 1024
}

#[test]
fn ten_minutes_of_ten_thousand_ports_fit_the_budget() {
    let mut stage = Stage::new(Theme::MONO);
    let build = "imrs".to_owned();
    stage.feed(ms(0), 0, Feed::Attached { identity: identity(0, 1), pid: 1, build });
    let mut state = snapshot();
    stage.frame(ms(1), 0, ServerFrame::Delta(Delta::whole(&state)));
    for period in 1..=PERIODS {
        let before = state.clone();
        go_on(&mut state, period, 5);
        let frame = ServerFrame::Delta(Delta::between(&before, &state));
        stage.frame(ms(100 * period), 0, frame);
    }
    let memory = resident();
    let film = stage.app.history().film().unwrap();
    let kept = ms(100 * PERIODS) - film.stops()[0].at;
    let weight = stage.app.history().weight();
    println!(
        "10,000 ports, 5 % dirty at 10 Hz: {kept:?} kept in {weight} bytes; the process has {memory} bytes"
    );
    assert!(weight <= BUDGET, "{weight} bytes");
    assert!(memory <= 64 << 20, "{memory} bytes");
}
