//! The sample cell of these tests: three nodes, and two arms and a hoist that meet, with fixed states.

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
pub mod crowd;
pub mod server;

use imrs_monitor::app::{App, Effect, Msg};
use imrs_monitor::name::Name;
use imrs_monitor::replay::Film;
use imrs_monitor::source::{Arrival, Feed, SourceId};
use imrs_monitor::store::Store;
use imrs_monitor::store::health::findings;
use imrs_monitor::theme::Theme;
use imrs_protocol::*;
use imrs_wire::obs::{
    Count, Events, LinkView, Liveness, NodeIdentity, ServerFrame, Snapshot, Table, TaskSnapshot, TimedEvent,
    TimerEntry,
};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use std::path::Path;
use std::time::{Duration, Instant};

/// The name of the sample cell.
pub fn beam() -> Name {
    Name::new("beam-lift")
}

/// The codes of the findings in the sample cell.
pub fn codes(store: &Store, now: Duration) -> Vec<&'static str> {
    findings(store, &beam(), now).iter().map(|f| f.code).collect()
}

pub const LIFT: PortId = PortId(0);
pub const BEAT: PortId = PortId(1);
pub const HALT: PortId = PortId(2);
pub const NODES: [&str; 3] = ["nl", "nr", "nh"];

pub fn cell() -> Cell {
    cell_with(Ticks(200_000))
}

/// The cell in which a message of the port `beat` has this TTL.
pub fn cell_with(beat: Ticks) -> Cell {
    let mut cell = Cell::new("beam-lift", Ticks(1_000));
    let nodes = NODES.map(|n| cell.node(n));
    for (a, b) in [(0, 1), (1, 2), (0, 2)] {
        cell.link(nodes[a], nodes[b], Ticks(5_000));
    }
    let [left, right, hoist] = ["armL", "armR", "hoist"]
        .map(|t| t)
        .into_iter()
        .zip(nodes)
        .map(|(t, n)| cell.task(t, n))
        .collect::<Vec<_>>()[..]
    else {
        unreachable!()
    };
    cell.port(
        PortDecl::new("lift", left, Usage::Waitfor, &[right, hoist], Ticks(1_000_000))
            .resend(Ticks(20_000), 2),
    );
    cell.port(PortDecl::new("beat", left, Usage::Send, &[right], beat).command().bounded_buffer(8));
    cell.port(PortDecl::new("halt", hoist, Usage::Send, &[left, right], Ticks(100_000)).bounded_buffer(2));
    cell
}

pub fn table() -> Table {
    Table::of(&CellTable::new(cell()).unwrap())
}

pub fn identity(node: usize, incarnation: u8) -> NodeIdentity {
    NodeIdentity {
        cell: "beam-lift".into(),
        digest: 0xfeed,
        node: NODES[node].into(),
        id: node as u16,
        incarnation: Incarnation(incarnation),
        tick_us: 1,
    }
}

fn port(port: PortId, usage: Usage, class: Class, capacity: u16, queue: Vec<QueueEntry>) -> PortView {
    let counters =
        PortCounters { sent: 40, enqueued: 30, delivered: 28, expired: 2, ..PortCounters::default() };
    let min_slack = queue.first().map(|e| e.remaining);
    PortView { port, usage, class, len: queue.len() as u16, capacity, min_slack, queue, counters }
}

fn entry(source: u16, sequence: u32, ms: u64, class: Class) -> QueueEntry {
    let id = MessageId { incarnation: Incarnation(1), sequence: Seq24::new(sequence) };
    QueueEntry { source: TaskId(source), id, class, remaining: Ticks(ms * 1000) }
}

/// The state of a node: the arms wait for the hoist in round 12, with 380 and 500 ms left; the hoist receives.
pub fn snapshot(node: usize) -> Snapshot {
    let waiting = node < 2;
    let patience = Ticks([380_000, 500_000, 0][node]);
    let member = |task: usize| MemberView {
        task: TaskId(task as u16),
        arrived: waiting && task < 2,
        confirmed: false,
        remaining: (waiting && task < 2).then_some(Ticks(300_000)),
    };
    let meeting = MeetingView {
        port: LIFT,
        round: Round(12),
        released: Round(11),
        state: if waiting { MeetingState::Gathering } else { MeetingState::Away },
        remaining: waiting.then_some(patience),
        members: (0..3).map(member).collect(),
    };
    let mut ports = vec![port(LIFT, Usage::Waitfor, Class::Command, 0, Vec::new())];
    match node {
        0 => ports.push(port(BEAT, Usage::Send, Class::Command, 0, Vec::new())),
        1 => {
            let queue = vec![
                entry(0, 8812, 7, Class::Command),
                entry(0, 8813, 44, Class::Command),
                entry(0, 8815, 180, Class::Command),
            ];
            ports.push(port(BEAT, Usage::Receive, Class::Command, 8, queue));
        }
        _ => {}
    }
    let halt = if node == 2 { Usage::Send } else { Usage::Receive };
    ports.push(port(HALT, halt, Class::Status, if node == 2 { 0 } else { 2 }, Vec::new()));
    let state = match node {
        2 => TaskState::Receiving { port: Some(HALT), remaining: Some(Ticks(90_000)) },
        _ => TaskState::Waiting { port: LIFT, round: Round(12), remaining: patience },
    };
    let view = TaskView { task: TaskId(node as u16), state, ports, meetings: vec![meeting] };
    Snapshot {
        mono_us: 5_000_000,
        uptime_us: 252_000_000,
        insecure: true,
        tasks: vec![TaskSnapshot { liveness: Liveness::Alive, age_us: 0, view }],
        transit: TransitView { len: u16::from(node == 1), capacity: 16, ..TransitView::default() },
        links: vec![LinkView { peer: NodeId(0), heard_us: Some(100), sent: 10, received: 9 }],
        discards: vec![Count { name: "expired".into(), count: 2 }],
        ..Snapshot::default()
    }
}

pub fn observed(event: Event, port: PortId, peer: u16, number: u32) -> Observation {
    Observation { event, port, peer: TaskId(peer), number, remaining: Ticks(1_000) }
}

pub fn events(node: usize, list: &[Observation]) -> Events {
    let event = |(i, what): (usize, &Observation)| TimedEvent {
        mono_us: 1_000 * i as u64,
        task: Some(TaskId(node as u16)),
        what: *what,
    };
    Events { lost: 0, events: list.iter().enumerate().map(event).collect() }
}

/// Events with times of the node's own clock, in milliseconds. The node's snapshot is taken at 5,000 ms.
pub fn at(node: usize, list: &[(u64, Observation)]) -> Events {
    let event = |(ms, what): &(u64, Observation)| TimedEvent {
        mono_us: ms * 1_000,
        task: Some(TaskId(node as u16)),
        what: *what,
    };
    Events { lost: 0, events: list.iter().map(event).collect() }
}

/// An observation with a remaining time of `ms` milliseconds.
pub fn left(event: Event, port: PortId, peer: u16, number: u32, ms: u64) -> Observation {
    Observation { remaining: Ticks(ms * 1_000), ..observed(event, port, peer, number) }
}

/// The events of a busy second: messages of the port `beat` that are queued, taken and answered, one rejection, a round
/// in which the hoist is missing, and seventeen lost events.
pub fn traffic() -> [Events; 3] {
    use Event::*;
    let arm_l = at(
        0,
        &[
            (4_800, left(Sent, BEAT, 1, 8_810, 200)),
            (4_842, left(Answered, BEAT, 1, 8_810, 158)),
            (4_850, left(Reached, LIFT, 0, 12, 1_000)),
            (4_866, left(PartnerArrived, LIFT, 1, 12, 990)),
            (4_870, left(Sent, BEAT, 1, 8_812, 200)),
            (4_880, left(Sent, BEAT, 1, 8_813, 200)),
        ],
    );
    let arm_r = at(
        1,
        &[
            (4_806, left(Enqueued, BEAT, 0, 8_810, 194)),
            (4_830, left(Delivered, BEAT, 0, 8_810, 170)),
            (4_835, left(Replied, BEAT, 0, 8_810, 165)),
            (4_858, left(PartnerArrived, LIFT, 0, 12, 992)),
            (4_860, left(Reached, LIFT, 1, 12, 1_000)),
            (4_875, left(Enqueued, BEAT, 0, 8_812, 195)),
            (4_885, left(Enqueued, BEAT, 0, 8_813, 195)),
            (4_890, left(Rejected, BEAT, 0, 8_813, 190)),
            (4_895, left(Discarded(Reason::Duplicate), BEAT, 0, 8_812, 175)),
        ],
    );
    let mut hoist = at(
        2,
        &[
            (4_700, left(GaveUp, LIFT, 2, 11, 0)),
            (4_880, left(Sent, HALT, 0, 7, 100)),
            (4_990, left(Discarded(Reason::ExpiredOnTheWay), HALT, 0, 6, 0)),
        ],
    );
    hoist.lost = 17;
    [arm_l, arm_r, hoist]
}

pub const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// An app that is given arrivals at chosen moments.
pub struct Stage {
    pub app: App,
}

impl Stage {
    pub fn new(theme: Theme) -> Self {
        Self { app: App::new(theme, None) }
    }

    pub fn feed(&mut self, at: Duration, source: usize, feed: Feed) -> Effect {
        let arrival = Arrival { at, source: SourceId(source as u32), feed };
        self.app.update(Msg::Feed(arrival), at)
    }

    pub fn frame(&mut self, at: Duration, source: usize, frame: ServerFrame) -> Effect {
        self.feed(at, source, Feed::Frame(Box::new(frame)))
    }

    pub fn attach(&mut self, at: Duration, node: usize, incarnation: u8) {
        let pid = 800 + node as u32 + 10 * u32::from(incarnation);
        self.feed(
            at,
            node,
            Feed::Attached { identity: identity(node, incarnation), pid, build: "imrs 0.1.0".into() },
        );
        self.frame(at, node, ServerFrame::Table(table()));
        self.frame(at, node, ServerFrame::Snapshot(snapshot(node)));
    }

    pub fn lose(&mut self, at: Duration, node: usize) {
        self.feed(at, node, Feed::Lost { why: "the connection was closed".into() });
    }

    /// A stage with all three nodes, attached at 1 s.
    pub fn cell(theme: Theme) -> Self {
        let mut stage = Self::new(theme);
        for node in 0..3 {
            stage.attach(ms(1_000), node, 1);
        }
        stage
    }

    /// A stage with the events of [`traffic`], a running timer and a running delay.
    pub fn busy(theme: Theme) -> Self {
        let mut stage = Self::cell(theme);
        for (node, events) in traffic().into_iter().enumerate() {
            stage.frame(ms(1_000), node, ServerFrame::Events(events));
        }
        for node in 0..3 {
            let mut busy = snapshot(node);
            let timer = |id: u8, ms: u64| TimerEntry {
                owner: TaskId(node as u16),
                id: TimeId(id),
                remaining: Ticks(ms * 1_000),
            };
            busy.timers = if node == 2 { vec![timer(0, 45), timer(255, 600)] } else { Vec::new() };
            busy.mono_us += 100_000;
            stage.frame(ms(1_100), node, ServerFrame::Snapshot(busy));
        }
        stage
    }

    pub fn key(&mut self, now: Duration, code: KeyCode) -> Effect {
        self.app.update(Msg::Key(KeyEvent::new(code, KeyModifiers::NONE)), now)
    }

    pub fn keys(&mut self, now: Duration, text: &str) {
        for c in text.chars() {
            self.key(now, if c == '\n' { KeyCode::Enter } else { KeyCode::Char(c) });
        }
    }

    pub fn ctrl(&mut self, now: Duration, c: char) -> Effect {
        self.app.update(Msg::Key(KeyEvent::new(KeyCode::Char(c), KeyModifiers::CONTROL)), now)
    }

    /// Draws a frame as the main loop does, so that the app learns the frame's layout.
    pub fn draw(&mut self, now: Duration, width: u16, height: u16) -> Buffer {
        let mut buffer = Buffer::empty(Rect::new(0, 0, width, height));
        imrs_monitor::view::show(&mut self.app, now, &mut buffer);
        buffer
    }

    /// Types keys, and draws a frame after each key, as for a person.
    pub fn typed(&mut self, now: Duration, (width, height): (u16, u16), text: &str) -> String {
        for c in text.chars() {
            self.draw(now, width, height);
            self.keys(now, &c.to_string());
        }
        crate::common::text(&self.draw(now, width, height))
    }

    pub fn buffer(&self, now: Duration, width: u16, height: u16) -> Buffer {
        let mut buffer = Buffer::empty(Rect::new(0, 0, width, height));
        imrs_monitor::view::view(&self.app, now, buffer.area, &mut buffer);
        buffer
    }

    /// The rows of the screen as text.
    pub fn text(&self, now: Duration, width: u16, height: u16) -> String {
        text(&self.buffer(now, width, height))
    }
}

pub fn text(buffer: &Buffer) -> String {
    let mut out = String::new();
    for y in 0..buffer.area.height {
        let row: String = (0..buffer.area.width).map(|x| buffer[(x, y)].symbol()).collect();
        out += row.trim_end();
        out.push('\n');
    }
    out
}

/// The screen cells with another style than the default, one run of equal style per line: row, columns, style.
pub fn styles(buffer: &Buffer) -> String {
    let mut out = String::new();
    for y in 0..buffer.area.height {
        let style = |x: u16| {
            let cell = &buffer[(x, y)];
            (cell.fg, cell.bg, cell.modifier)
        };
        let mut x = 0;
        while x < buffer.area.width {
            let run = style(x);
            let end = (x..buffer.area.width).find(|&e| style(e) != run).unwrap_or(buffer.area.width);
            let plain = ratatui::buffer::Cell::default();
            if run != (plain.fg, plain.bg, plain.modifier) {
                out += &format!("{y}:{x}-{} {} {} {:?}\n", end - 1, run.0, run.1, run.2);
            }
            x = end;
        }
    }
    out
}

/// Opens a recording that was stopped, once its end record is on the disk: a busy disk may take longer than the stop waits.
pub fn whole_film(path: &Path) -> Film {
    let end = Instant::now() + Duration::from_secs(120);
    loop {
        let film = Film::open(path).unwrap();
        if film.notice.is_none() {
            return film;
        }
        assert!(Instant::now() < end, "{:?}", film.notice);
        std::thread::sleep(Duration::from_millis(5));
    }
}
