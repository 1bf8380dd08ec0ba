//! Tests of the observation protocol: golden frames of every version, total decoding, and framing with slow, broken and
//! hostile peers.

use crate::obs_later::{samples_1_2, samples_1_3, samples_1_4};
use imrs_protocol::*;
use imrs_wire::obs::*;
use proptest::prelude::*;
use std::io::{self, ErrorKind, Read, Write};

fn count(name: &str, count: u64) -> Count {
    Count { name: name.into(), count }
}

/// Every [`Event`] once. The `match` has no wildcard: a new event does not compile until it is listed here.
fn every_event() -> Vec<Event> {
    use Event::*;
    let mut all = vec![
        Sent,
        Resent,
        Enqueued,
        Delivered,
        Replied,
        Answered,
        RefusedByPeer,
        TimedOut,
        TimedOutUnsent,
        PeerRestarted,
    ];
    all.extend(Reason::ALL.map(Discarded));
    all.extend([
        Reached,
        Rejoined,
        PartnerArrived,
        PartnerAborted,
        Confirmed,
        ReleasedComplete,
        ReleasedByConfirm,
        WithinMargin,
        GaveUp,
        Rejected,
        Interrupted,
        Resumed,
        Granted,
        TookOver,
        Fenced,
    ]);
    for event in &all {
        match event {
            Sent | Resent | Enqueued | Delivered | Replied | Answered | RefusedByPeer | TimedOut
            | TimedOutUnsent | PeerRestarted | Discarded(_) | Reached | Rejoined | PartnerArrived
            | PartnerAborted | Confirmed | ReleasedComplete | ReleasedByConfirm | WithinMargin | GaveUp
            | Rejected | Interrupted | Resumed | Granted | TookOver | Fenced => {}
        }
    }
    all
}

fn ports() -> Vec<PortView> {
    let usages = [Usage::Send, Usage::Receive, Usage::Reply, Usage::Query, Usage::Response, Usage::Waitfor];
    let mut ports = Vec::new();
    for (i, usage) in usages.into_iter().enumerate() {
        let n = i as u64;
        let entry = QueueEntry {
            source: TaskId(300),
            id: MessageId { incarnation: Incarnation(200), sequence: Seq24::new(0xabcdef) },
            class: Class::Command,
            remaining: Ticks(123_456 + n),
        };
        let counters = PortCounters {
            sent: n,
            resent: 1,
            enqueued: 2,
            delivered: 3,
            expired: 4,
            refused: 5,
            rejected: 6,
            evicted: 7,
            duplicates: 8,
            timed_out: 9,
            dropped: u64::MAX,
        };
        ports.push(PortView {
            port: PortId(i as u16),
            usage,
            class: if i % 2 == 0 { Class::Status } else { Class::Command },
            len: 1,
            capacity: 8,
            min_slack: (i > 0).then_some(Ticks(7)),
            queue: vec![entry; i],
            counters,
        });
    }
    ports
}

fn tasks() -> Vec<TaskSnapshot> {
    let port = PortId(513);
    let states = [
        TaskState::Running,
        TaskState::Receiving { port: Some(port), remaining: None },
        TaskState::AwaitingReply { port, from: TaskId(2), remaining: Ticks(1000) },
        TaskState::Waiting { port, round: Round(65_535), remaining: Ticks(2_000_000) },
        TaskState::Delaying,
    ];
    let member = |task: u16, arrived, confirmed| MemberView {
        task: TaskId(task),
        arrived,
        confirmed,
        remaining: arrived.then_some(Ticks(380_000)),
    };
    let meeting = |state| MeetingView {
        port,
        round: Round(12),
        released: Round(11),
        state,
        remaining: (state != MeetingState::Away).then_some(Ticks(380_000)),
        members: vec![member(0, true, false), member(1, true, true), member(2, false, false)],
    };
    let states =
        states.into_iter().zip([Liveness::Alive, Liveness::Ended, Liveness::Crashed].into_iter().cycle());
    states
        .enumerate()
        .map(|(i, (state, liveness))| TaskSnapshot {
            liveness,
            age_us: 40 * i as u64,
            view: TaskView {
                task: TaskId(i as u16),
                state,
                ports: if i == 0 { ports() } else { Vec::new() },
                meetings: match i {
                    3 => [MeetingState::Away, MeetingState::Gathering, MeetingState::WithinMargin]
                        .map(meeting)
                        .into(),
                    _ => Vec::new(),
                },
            },
        })
        .collect()
}

fn snapshot() -> Snapshot {
    let mut discarded = vec![0; Reason::ALL.len()];
    discarded[2] = 5;
    Snapshot {
        mono_us: 0x0123_4567_89ab_cdef,
        uptime_us: 252_000_000,
        insecure: true,
        real_time: RealTime::Refused { memory: true, scheduler: false, core: true },
        tasks: tasks(),
        transit: TransitView {
            len: 2,
            capacity: 32,
            min_slack: Some(Ticks(25_000)),
            forwarded: 18_204,
            discarded,
            next: vec![NodeId(1), NodeId(1)],
        },
        transit_age_us: 12,
        timers: vec![TimerEntry { owner: TaskId(1), id: TimeId(3), remaining: Ticks(200_000) }],
        links: vec![
            LinkView { peer: NodeId(1), heard_us: Some(900), sent: 10, received: 9 },
            LinkView { peer: NodeId(2), heard_us: None, sent: 4, received: 0 },
        ],
        discards: vec![count("expired", 3), count("duplicate", 1)],
        link_discards: vec![count("checksum", 2)],
    }
}

fn table() -> Table {
    let mut cell = Cell::new("beam-lift", Ticks(1000));
    let nodes = ["nl", "nr"].map(|n| cell.node(n));
    cell.link(nodes[0], nodes[1], Ticks(5000));
    let (left, right) = (cell.task("armL", nodes[0]), cell.task("arm\u{1b}R", nodes[1]));
    cell.port(PortDecl::new("lift", left, Usage::Waitfor, &[right], Ticks(500_000)).resend(Ticks(20_000), 2));
    cell.port(PortDecl::new("halt", left, Usage::Send, &[right], Ticks(100_000)).bounded_buffer(4));
    Table::of(&CellTable::new(cell).unwrap())
}

fn identity() -> NodeIdentity {
    NodeIdentity {
        cell: "beam-lift".into(),
        digest: 0xdead_beef,
        node: "nl".into(),
        id: 0,
        incarnation: Incarnation(3),
        tick_us: 1,
    }
}

/// One frame of every kind; together they contain every variant of every enum.
fn samples() -> Vec<(&'static str, Vec<u8>)> {
    let hello = |role| {
        let hello = Hello { schema: 0x1234_5678, pid: 812, build: "imrs 0.1.0".into(), mono_us: 77, role };
        Handshake::Hello(hello).encode(Version { major: 1, minor: 0 })
    };
    let (old, new) = (Version { major: 1, minor: 0 }, Version { major: 2, minor: 5 });
    let refused = |refusal| Handshake::Refused(refusal).encode(old);
    let server = |frame: ServerFrame| postcard::to_allocvec(&frame).unwrap();
    let client = |frame: ClientFrame| postcard::to_allocvec(&frame).unwrap();
    let event = |(i, event)| TimedEvent {
        mono_us: 1000 + i as u64,
        task: (i % 2 == 0).then_some(TaskId(4)),
        what: Observation { event, port: PortId(1), peer: TaskId(2), number: 70_000, remaining: Ticks(9) },
    };
    let events = Events { lost: 17, events: every_event().into_iter().enumerate().map(event).collect() };
    let subscribe = Subscribe { period_us: 100_000, queue_limit: 16, events: true, credit: 8 };
    vec![
        ("hello_node", hello(Role::Node(identity()))),
        ("hello_monitor", hello(Role::Monitor)),
        ("refused_major", refused(Refusal::OtherMajor { node: old, monitor: new })),
        ("refused_schema", refused(Refusal::OtherSchema { node: 1, monitor: 2 })),
        ("refused_too_many", refused(Refusal::TooMany { limit: 8 })),
        ("refused_role", refused(Refusal::NotAMonitor)),
        ("table", server(ServerFrame::Table(table()))),
        ("snapshot", server(ServerFrame::Snapshot(snapshot()))),
        ("events", server(ServerFrame::Events(events))),
        ("bye_stopping", server(ServerFrame::Bye(Bye { reason: Goodbye::Stopping }))),
        ("bye_misunderstood", server(ServerFrame::Bye(Bye { reason: Goodbye::Misunderstood }))),
        ("subscribe", client(ClientFrame::Subscribe(subscribe))),
        ("credit", client(ClientFrame::Credit(300))),
    ]
}

/// Every kind of frame that version 1.1 added.
fn samples_1_1() -> Vec<(&'static str, Vec<u8>)> {
    let server = |frame: ServerFrame| postcard::to_allocvec(&frame).unwrap();
    let client = |frame: ClientFrame| postcard::to_allocvec(&frame).unwrap();
    let held = HeldView {
        entry: ports()[1].queue[0],
        arrival: 4_417,
        fragments: 2,
        rank: Some(1),
        rejections: 4,
        capped: true,
        back_off: Ticks(80_000),
    };
    let queue = QueueView { handled: true, bypassed: 3, bypass_limit: 9, queue: vec![held] };
    let port = PortDetail { task: TaskId(1), port: PortId(513), age_us: 40, queue };
    let vitals = Vitals {
        mono_us: 77,
        timer: Lateness { count: 9_000, late: 3, p50_us: 64, p99_us: 512, max_us: 801 },
        links: vec![count("clock_set", 1)],
        recording: Some(RecordingFacts {
            path: "/r/run.nl.imrs".into(),
            lost: 2,
            failure: Some("full".into()),
        }),
        cpu_us: 123_456,
        memory: 6 << 20,
        threads: 7,
    };
    let place = NodePlace { node: NodeId(1), address: "tcp:127.0.0.1:7101".into() };
    let want = Want {
        period_us: 100_000,
        queue_limit: 0,
        watched: vec![(TaskId(1), PortId(513))],
        events: Some(EventFilter { kinds: Kinds::NONE.and(Event::GaveUp), tasks: vec![TaskId(4)] }),
        vitals_us: 1_000_000,
        whole_us: 0,
        credit: 8,
    };
    let (changed, other) = deltas();
    vec![
        ("delta_parts", server(ServerFrame::Delta(changed))),
        ("delta_anew", server(ServerFrame::Delta(other))),
        ("delta_whole", server(ServerFrame::Delta(Delta::whole(&snapshot())))),
        ("detail", server(ServerFrame::Detail(Detail { mono_us: 9, ports: vec![port] }))),
        ("vitals", server(ServerFrame::Vitals(vitals))),
        ("pong", server(ServerFrame::Pong(Pong { echo_us: 5, mono_us: 300 }))),
        ("places", server(ServerFrame::Places(Places { nodes: vec![place] }))),
        ("denied_no_token", server(ServerFrame::Denied(Denied::NoToken))),
        ("denied_wrong_token", server(ServerFrame::Denied(Denied::WrongToken))),
        ("want", client(ClientFrame::Want(want))),
        ("ping", client(ClientFrame::Ping(Ping { mono_us: 5 }))),
        ("token", client(ClientFrame::Token(Token::of("0123456789abcdef").unwrap()))),
        ("whole", client(ClientFrame::Whole)),
    ]
}

fn all_samples() -> impl Iterator<Item = (&'static str, Vec<u8>)> {
    let later = [samples_1_1(), samples_1_2(), samples_1_3(), samples_1_4()];
    samples().into_iter().chain(later.into_iter().flatten())
}

/// Two deltas: one with changed parts, and one that has some parts whole.
fn deltas() -> (Delta, Delta) {
    let old = snapshot();
    let mut new = old.clone();
    new.mono_us += 100_000;
    new.real_time = RealTime::Had;
    new.tasks[0].view.ports[1].counters.sent += 300;
    new.tasks[0].view.ports[1].counters.dropped = 0;
    new.tasks[0].view.ports[2].queue.pop();
    new.tasks[1].liveness = Liveness::Crashed;
    new.tasks[3].view.state = TaskState::Running;
    new.tasks[3].view.meetings[1].released = Round(12);
    new.transit.forwarded += 1;
    new.links[1].heard_us = Some(3);
    new.discards[1].count += 2;
    let changed = Delta::between(&old, &new);
    new.tasks[2].view.ports = ports();
    let other = Delta::between(&old, &Snapshot { links: Vec::new(), discards: Vec::new(), ..new });
    (changed, other)
}

fn hex(bytes: &[u8]) -> String {
    let lines =
        bytes.chunks(32).map(|line| line.iter().map(|b| format!("{b:02x}")).collect::<String>() + "\n");
    lines.collect()
}

fn unhex(text: &str) -> Vec<u8> {
    let digits: Vec<u8> = text.bytes().filter(u8::is_ascii_hexdigit).collect();
    digits.chunks(2).map(|d| u8::from_str_radix(std::str::from_utf8(d).unwrap(), 16).unwrap()).collect()
}

fn golden(version: &str, name: &str) -> std::path::PathBuf {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/obs_golden").join(version);
    folder.join(format!("{name}.hex"))
}

/// Compares samples with their golden files. Returns all bytes of the samples. If `write` is true, writes the files first.
fn kept(version: &str, samples: Vec<(&'static str, Vec<u8>)>, write: bool) -> Vec<u8> {
    let mut all = Vec::new();
    for (name, bytes) in samples {
        let path = golden(version, name);
        if write {
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, hex(&bytes)).unwrap();
        }
        let kept = unhex(&std::fs::read_to_string(&path).unwrap());
        assert_eq!(hex(&bytes), hex(&kept), "{name} of {version} changed");
        all.extend(bytes);
    }
    all
}

/// The frames of a version never change. After a deliberate change of version 1.4, as long as it is unreleased, run with
/// `IMRS_WRITE_GOLDEN=1`. Then set `SCHEMA` to the value in the test's failure.
#[test]
fn golden_bytes_of_every_version_are_kept() {
    let write = std::env::var_os("IMRS_WRITE_GOLDEN").is_some();
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let mut digest = crc.digest();
    for (version, samples, schema) in [
        ("1.0", samples(), 0x3723_afbb),
        ("1.1", samples_1_1(), 0x17ad_ceff),
        ("1.2", samples_1_2(), 0xed49_0a48),
        ("1.3", samples_1_3(), 0x792d_984e),
        ("1.4", samples_1_4(), SCHEMA),
    ] {
        digest.update(&kept(version, samples, write && version == "1.4"));
        let now = digest.clone().finalize();
        assert_eq!(schema, now, "the schema of {version} is {now:#010x}");
    }
}

#[test]
fn golden_bytes_decode_to_the_values_they_were_made_from() {
    let bytes = |name: &str| unhex(&std::fs::read_to_string(golden("1.0", name)).unwrap());
    assert_eq!(ServerFrame::decode(&bytes("table")), Ok(ServerFrame::Table(table())));
    assert_eq!(ServerFrame::decode(&bytes("snapshot")), Ok(ServerFrame::Snapshot(snapshot())));
    let Ok(ServerFrame::Events(events)) = ServerFrame::decode(&bytes("events")) else { panic!("no events") };
    assert_eq!(events.events.iter().map(|e| e.what.event).collect::<Vec<_>>(), every_event());
    assert_eq!(ClientFrame::decode(&bytes("credit")), Ok(ClientFrame::Credit(300)));
    let (version, Handshake::Hello(hello)) = Handshake::decode(&bytes("hello_node")).unwrap() else {
        panic!("no hello")
    };
    assert_eq!((version, hello.role), (Version { major: 1, minor: 0 }, Role::Node(identity())));
}

#[test]
fn another_major_version_is_named_whatever_follows_it() {
    let mut bytes = b"IMOB\x02\x00\x07\x00".to_vec();
    bytes.extend([0xff; 40]);
    let error = Handshake::decode(&bytes).unwrap_err();
    assert_eq!(error, DecodeError::OtherMajor { theirs: Version { major: 2, minor: 7 }, ours: VERSION });
    assert_eq!(error.to_string(), "the other side speaks imrs-obs 2.7, this program 1.4");
    assert_eq!(Handshake::decode(b"GET / HTTP/1.1\r\n"), Err(DecodeError::NotObs));
    assert_eq!(Handshake::decode(b"IMOB\x01"), Err(DecodeError::NotObs));
}

#[test]
fn versions_agree_on_the_smaller_minor_or_say_why_not() {
    let v = |major, minor| Version { major, minor };
    assert_eq!(agree((v(1, 3), 5), (v(1, 1), 9)), Ok(v(1, 1)));
    assert_eq!(agree((v(1, 0), 5), (v(1, 0), 5)), Ok(v(1, 0)));
    assert_eq!(agree((v(1, 0), 5), (v(1, 0), 9)), Err(Refusal::OtherSchema { node: 5, monitor: 9 }));
    assert_eq!(
        agree((v(1, 0), 5), (v(2, 0), 5)),
        Err(Refusal::OtherMajor { node: v(1, 0), monitor: v(2, 0) })
    );
}

#[test]
fn unknown_kinds_and_wrong_lengths_are_told_apart() {
    assert_eq!(ServerFrame::decode(&[99, 1, 2, 3]), Err(DecodeError::UnknownKind(99)));
    assert_eq!(ClientFrame::decode(&[1, 4, 0]), Err(DecodeError::TrailingBytes(1)));
    assert!(matches!(ClientFrame::decode(&[1]), Err(DecodeError::Malformed(_))));
    assert!(matches!(ServerFrame::decode(&[]), Err(DecodeError::Malformed(_))));
}

proptest! {
    #[test]
    fn decoding_is_total(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
        let _ = ServerFrame::decode(&bytes);
        let _ = ClientFrame::decode(&bytes);
        let _ = Handshake::decode(&bytes);
    }

    #[test]
    fn decoding_survives_damage(which in 0..31_usize, at in any::<usize>(), value in any::<u8>(), cut in any::<usize>()) {
        let (_, mut bytes) = all_samples().nth(which).unwrap();
        let (len, place) = (bytes.len(), at % bytes.len());
        bytes[place] = value;
        bytes.truncate(len - cut % 8 % len);
        let _ = ServerFrame::decode(&bytes);
        let _ = ClientFrame::decode(&bytes);
        let _ = Handshake::decode(&bytes);
    }

    #[test]
    fn frames_come_through_any_fragmentation(sizes in proptest::collection::vec(0..40_usize, 1..60)) {
        let frames: Vec<_> = all_samples().map(|(_, bytes)| bytes).collect();
        let mut writer = FrameWriter::new(Dribble::new(&sizes));
        for frame in &frames {
            writer.push_bytes(frame).unwrap();
            while let Err(e) = writer.flush() {
                prop_assert!(matches!(e, FrameError::NotReady), "{e}");
            }
        }
        prop_assert!(writer.is_drained());
        let mut reader = FrameReader::new(Dribble { bytes: writer.get_ref().bytes.clone(), ..Dribble::new(&sizes) }, MAX_FRAME);
        for frame in &frames {
            prop_assert_eq!(&next(&mut reader), frame);
        }
        prop_assert!(matches!(reader.read_frame(), Err(FrameError::Closed)));
    }
}

fn next(reader: &mut FrameReader<Dribble>) -> Vec<u8> {
    loop {
        match reader.read_frame() {
            Ok(frame) => return frame.to_vec(),
            Err(FrameError::NotReady) => {}
            Err(e) => panic!("{e}"),
        }
    }
}

/// A stream that transfers a few bytes at a time, and sometimes is not ready (size 0).
struct Dribble {
    bytes: Vec<u8>,
    at: usize,
    sizes: Vec<usize>,
    turn: usize,
}

impl Dribble {
    fn new(sizes: &[usize]) -> Self {
        let sizes = sizes.iter().copied().chain([1]).collect();
        Self { bytes: Vec::new(), at: 0, sizes, turn: 0 }
    }

    fn size(&mut self) -> io::Result<usize> {
        self.turn += 1;
        let size = self.sizes[self.turn % self.sizes.len()];
        if size == 0 { Err(ErrorKind::WouldBlock.into()) } else { Ok(size) }
    }
}

impl Read for Dribble {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let size = if self.at == self.bytes.len() { 0 } else { self.size()? };
        let count = size.min(buffer.len()).min(self.bytes.len() - self.at);
        buffer[..count].copy_from_slice(&self.bytes[self.at..self.at + count]);
        self.at += count;
        Ok(count)
    }
}

impl Write for Dribble {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let count = self.size()?.min(buffer.len());
        self.bytes.extend_from_slice(&buffer[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A source that records the largest buffer that a reader passes to it: that is the memory that the reader has allocated.
struct Greedy<'a> {
    bytes: &'a [u8],
    most: usize,
}

impl Read for Greedy<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.most = self.most.max(buffer.len());
        self.bytes.read(buffer)
    }
}

#[test]
fn a_length_field_alone_costs_little_memory() {
    let claims = (MAX_FRAME as u32).to_le_bytes();
    let mut reader = FrameReader::new(Greedy { bytes: &claims, most: 0 }, MAX_FRAME);
    let error = reader.read_frame().unwrap_err();
    assert!(matches!(error, FrameError::Truncated { got: 4, of } if of == MAX_FRAME + 4), "{error}");
    assert!(reader.get_ref().most <= 64 * 1024);

    let claims = (MAX_FRAME as u32 + 1).to_le_bytes();
    let mut reader = FrameReader::new(&claims[..], MAX_FRAME);
    for _ in 0..2 {
        let error = reader.read_frame().unwrap_err();
        assert!(matches!(error, FrameError::TooLong { length, limit } if length == limit + 1), "{error}");
    }
    let mut reader = FrameReader::new(&[1, 2][..], MAX_FRAME);
    assert!(matches!(reader.read_frame(), Err(FrameError::Truncated { got: 2, of: 4 })));
}

#[test]
fn a_frame_over_the_limit_is_not_written_and_leaves_the_stream_in_step() {
    let mut writer = FrameWriter::new(Vec::new());
    writer.push(&ClientFrame::Credit(1)).unwrap();
    let long = ServerFrame::Table(Table { cell: "x".repeat(MAX_FRAME), ..Table::default() });
    assert!(matches!(writer.push(&long), Err(FrameError::TooLong { .. })));
    writer.push(&ClientFrame::Credit(2)).unwrap();
    writer.flush().unwrap();
    assert_eq!(writer.get_ref(), &[2, 0, 0, 0, 1, 1, 2, 0, 0, 0, 1, 2]);
}
