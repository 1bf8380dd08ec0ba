//! A node shows itself, whatever its monitors do.

mod common;

use common::{A, B, LONG, LONG_TICKS, ask, cell, finish, one_node, report, table};
use imrs_protocol::{Event, PortDecl, TaskState, Ticks, Usage};
use imrs_runtime::observer::{MAX_MONITORS, Observer, ObserverError, Place};
use imrs_runtime::{Runtime, Sent};
use imrs_wire::obs::{
    ClientFrame, DecodeError, FrameError, FrameReader, FrameWriter, Goodbye, Handshake, Hello, Liveness,
    MAX_FRAME, Refusal, Role, SCHEMA, ServerFrame, Subscribe, TimedEvent, VERSION, Version,
};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

/// A folder of this test alone.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("imrs-runtime-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }

    fn socket(&self) -> PathBuf {
        self.0.join("node.sock")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A node whose task `b` waits for questions until told to go.
fn node() -> (Runtime, Sender<u8>) {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(16));
    let (tell, told) = report::<u8>();
    let runtime = one_node(&table(cell))
        .task("a", move |ctx| {
            let news = ctx.port("news")?;
            while let Ok(number) = told.recv() {
                assert_eq!(ctx.send(news, &[number])?, Sent::Copies(1));
            }
            Ok(())
        })
        .task("b", |ctx| {
            let ask = ctx.port("ask")?;
            ctx.receive(Some(ask), None).map(|_| ())
        })
        .start()
        .unwrap();
    (runtime, tell)
}

fn socket(observer: &Observer) -> &Path {
    match observer.place() {
        Place::Unix(path) => path,
        Place::Tcp(address) => panic!("at {address}"),
    }
}

struct Monitor {
    reader: FrameReader<UnixStream>,
    writer: FrameWriter<UnixStream>,
}

impl Monitor {
    fn connect(path: &Path) -> Self {
        let stream = UnixStream::connect(path).expect("a listening node");
        stream.set_read_timeout(Some(LONG)).unwrap();
        Self {
            reader: FrameReader::new(stream.try_clone().unwrap(), MAX_FRAME),
            writer: FrameWriter::new(stream),
        }
    }

    fn say_hello(&mut self, version: Version, schema: u32) -> Result<(Version, Handshake), DecodeError> {
        let hello = Hello { schema, pid: 1, build: "test".into(), mono_us: 0, role: Role::Monitor };
        self.writer.push_bytes(&Handshake::Hello(hello).encode(version)).unwrap();
        self.writer.flush().unwrap();
        Handshake::decode(self.reader.read_frame().expect("an answer"))
    }

    fn attach(path: &Path) -> Self {
        let mut monitor = Self::connect(path);
        let (_, answer) = monitor.say_hello(VERSION, SCHEMA).expect("a hello");
        let Handshake::Hello(Hello { role: Role::Node(identity), .. }) = answer else { panic!("{answer:?}") };
        assert_eq!((identity.cell.as_str(), identity.node.as_str(), identity.tick_us), ("test", "n0", 1));
        let ServerFrame::Table(table) = monitor.next() else { panic!("the table comes first") };
        assert_eq!(table.tasks.len(), 2);
        monitor
    }

    fn say(&mut self, frame: ClientFrame) {
        self.writer.push(&frame).unwrap();
        self.writer.flush().unwrap();
    }

    fn subscribe(&mut self, events: bool, credit: u16) {
        self.say(ClientFrame::Subscribe(Subscribe { period_us: 10_000, queue_limit: 8, events, credit }));
    }

    fn next(&mut self) -> ServerFrame {
        ServerFrame::decode(self.reader.read_frame().expect("a frame")).expect("a known frame")
    }
}

#[test]
fn a_monitor_sees_tasks_queues_and_events() {
    let folder = Folder::new("sees");
    let (runtime, tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mode = std::fs::metadata(socket(&observer)).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    let mut monitor = Monitor::attach(socket(&observer));
    monitor.subscribe(true, u16::MAX);
    let ServerFrame::Snapshot(first) = monitor.next() else { panic!("a snapshot comes at once") };
    assert_eq!(first.tasks.len(), 2);
    assert!(first.tasks.iter().all(|task| task.liveness == Liveness::Alive));
    (0..3).for_each(|number| tell.send(number).unwrap());
    let mut seen: Vec<TimedEvent> = Vec::new();
    let mut waiting = 0;
    let start = Instant::now();
    while waiting < 3 || seen.iter().filter(|e| e.what.event == Event::Enqueued).count() < 3 {
        assert!(start.elapsed() < LONG, "{waiting} waiting, {seen:?}");
        match monitor.next() {
            ServerFrame::Snapshot(snapshot) => {
                let b = &snapshot.tasks[1].view;
                assert!(matches!(b.state, TaskState::Receiving { .. } | TaskState::Running));
                waiting = b.ports.iter().map(|port| port.queue.len()).max().unwrap_or(0);
            }
            ServerFrame::Events(events) => {
                assert_eq!(events.lost, 0);
                seen.extend(events.events);
            }
            // A monitor that subscribes is told what version 1.0 has.
            other => panic!("{other:?}"),
        }
    }
    let enqueued: Vec<_> = seen.iter().filter(|e| e.what.event == Event::Enqueued).collect();
    assert!(enqueued.iter().all(|e| e.task == Some(B) && e.what.peer == A));
    drop(tell);
    drop(observer);
    let bye = std::iter::from_fn(|| Some(monitor.next())).find(|frame| matches!(frame, ServerFrame::Bye(_)));
    assert!(matches!(bye, Some(ServerFrame::Bye(bye)) if bye.reason == Goodbye::Stopping));
    assert!(!folder.socket().exists());
    drop(runtime);
}

#[test]
fn other_versions_and_too_many_are_refused_by_name() {
    let folder = Folder::new("refuses");
    let (runtime, _tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let other = Version { major: 9, minor: 1 };
    let (_, answer) = Monitor::connect(socket(&observer)).say_hello(other, SCHEMA).unwrap();
    assert_eq!(answer, Handshake::Refused(Refusal::OtherMajor { node: VERSION, monitor: other }));
    let (_, answer) = Monitor::connect(socket(&observer)).say_hello(VERSION, SCHEMA ^ 1).unwrap();
    assert_eq!(answer, Handshake::Refused(Refusal::OtherSchema { node: SCHEMA, monitor: SCHEMA ^ 1 }));

    let attached: Vec<_> = (0..MAX_MONITORS).map(|_| Monitor::attach(socket(&observer))).collect();
    let (_, answer) = Monitor::connect(socket(&observer)).say_hello(VERSION, SCHEMA).unwrap();
    assert!(matches!(answer, Handshake::Refused(Refusal::TooMany { .. })), "{answer:?}");
    drop(attached);
    let start = Instant::now();
    while !matches!(
        Monitor::connect(socket(&observer)).say_hello(VERSION, SCHEMA),
        Ok((_, Handshake::Hello(_)))
    ) {
        assert!(start.elapsed() < LONG, "the places of those who left stay taken");
    }
}

#[test]
fn garbage_and_silence_cost_the_sender_only() {
    let folder = Folder::new("garbage");
    let (runtime, tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mut silent = Monitor::attach(socket(&observer));
    // Subscribes with all the credit there is, and never reads.
    silent.subscribe(true, u16::MAX);
    let mut draws = fastrand::Rng::with_seed(11);
    for _ in 0..50 {
        let mut garbage = UnixStream::connect(socket(&observer)).unwrap();
        let bytes: Vec<u8> = (0..draws.usize(0..200)).map(|_| draws.u8(..)).collect();
        let _ = garbage.write_all(&bytes);
    }
    let mut confused = Monitor::attach(socket(&observer));
    confused.writer.push_bytes(&[0xff; 9]).unwrap();
    confused.writer.flush().unwrap();
    assert!(matches!(confused.next(), ServerFrame::Bye(bye) if bye.reason == Goodbye::Misunderstood));
    assert!(matches!(confused.reader.read_frame(), Err(FrameError::Closed)));

    let mut monitor = Monitor::attach(socket(&observer));
    monitor.subscribe(false, 2);
    assert!(matches!(monitor.next(), ServerFrame::Snapshot(_)));
    assert!(matches!(monitor.next(), ServerFrame::Snapshot(_)));
    // Without credit nothing more comes, until there is more.
    monitor.reader.get_ref().set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    assert!(matches!(monitor.reader.read_frame(), Err(FrameError::NotReady)));
    monitor.reader.get_ref().set_read_timeout(Some(LONG)).unwrap();
    monitor.say(ClientFrame::Credit(1));
    assert!(matches!(monitor.next(), ServerFrame::Snapshot(_)));
    tell.send(1).expect("the node still runs");
    drop((silent, observer));
    drop(runtime);
}

#[test]
fn a_socket_nobody_serves_is_taken_over_and_a_served_one_is_not() {
    let folder = Folder::new("stale");
    drop(UnixListener::bind(folder.socket()).unwrap());
    assert!(folder.socket().exists(), "left behind by a process that died");
    let (runtime, tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let second = Observer::start_at(runtime.node().clone(), &folder.socket());
    assert!(matches!(second, Err(ObserverError::Taken(_))), "{second:?}");
    drop(Monitor::attach(socket(&observer)));
    drop((observer, tell));
    drop(runtime);
}

#[test]
fn observing_changes_nothing_and_ends_without_a_trace() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let node = one_node(&table)
        .task("a", |ctx| {
            let ask = ctx.port("ask")?;
            for _ in 0..2_000 {
                assert!(ctx.send(ask, b"?")?.reply().is_some());
            }
            Ok(())
        })
        .task("b", |ctx| {
            for _ in 0..2_000 {
                let question = ctx.receive(None, None)?.expect("only a message ends it");
                ctx.reply(&question.from, b"!")?;
            }
            Ok(())
        })
        .start()
        .unwrap();
    let mut observations = node.node().observe();
    let (mut events, mut lost) = (Vec::new(), 0);
    while !node.wait(Duration::from_millis(1)) {
        lost += observations.drain(100, &mut events);
    }
    while {
        let before = events.len();
        lost += observations.drain(100, &mut events);
        events.len() > before
    } {}
    let sent = events.iter().filter(|e| e.what.event == Event::Sent).count() as u64;
    let answered = events.iter().filter(|e| e.what.event == Event::Answered).count() as u64;
    assert!(sent <= 2_000 && answered <= 2_000);
    // Every question makes two observations at `a` and three at `b`, or four where the message had to wait.
    let all = events.len() as u64 + lost;
    assert!((8_000..=14_000).contains(&all), "{all}, {lost} of them lost");
    let own: Vec<_> = events.iter().filter(|e| e.task == Some(A)).map(|e| e.what.number).collect();
    assert!(own.is_sorted(), "oldest first for each task");
    finish(node);
}

#[test]
fn over_tcp_the_same_is_said() {
    let (runtime, _tell) = node();
    let any = std::net::SocketAddr::from(([127, 0, 0, 1], 0));
    let observer = Observer::start_tcp(runtime.node().clone(), any).unwrap();
    let Place::Tcp(address) = *observer.place() else { panic!("over TCP") };
    let stream = std::net::TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(LONG)).unwrap();
    let mut reader = FrameReader::new(stream.try_clone().unwrap(), MAX_FRAME);
    let mut writer = FrameWriter::new(stream);
    let hello = Hello { schema: SCHEMA, pid: 1, build: "test".into(), mono_us: 0, role: Role::Monitor };
    writer.push_bytes(&Handshake::Hello(hello).encode(VERSION)).unwrap();
    let wanted = Subscribe { period_us: 10_000, queue_limit: 8, events: false, credit: 1 };
    writer.push(&ClientFrame::Subscribe(wanted)).unwrap();
    writer.flush().unwrap();
    let (_, answer) = Handshake::decode(reader.read_frame().unwrap()).unwrap();
    assert!(matches!(answer, Handshake::Hello(Hello { role: Role::Node(_), .. })), "{answer:?}");
    let mut next = || ServerFrame::decode(reader.read_frame().unwrap()).unwrap();
    assert!(matches!(next(), ServerFrame::Table(_)));
    assert!(matches!(next(), ServerFrame::Snapshot(_)));
    let taken = Observer::start_tcp(runtime.node().clone(), address);
    assert!(matches!(taken, Err(ObserverError::Tcp { .. })), "{taken:?}");
    drop(observer);
    assert!(matches!(next(), ServerFrame::Bye(_)));
}
