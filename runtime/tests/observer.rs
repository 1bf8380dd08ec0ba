//! Tests that a node can be observed, whatever its monitors do.

use crate::common::monitor::{Folder, Monitor, NEW, PATIENCE, node, socket, want};
use crate::common::{A, B, LONG, LONG_TICKS, ask, cell, finish, one_node, report, table};
use imrs_protocol::{Event, TaskState, Ticks};
use imrs_runtime::observer::{MAX_MONITORS, Observer, ObserverError, Place, Showing};
use imrs_wire::obs::{
    ClientFrame, EventFilter, FrameError, Goodbye, Handshake, Kinds, Liveness, Refusal, SCHEMA, ServerFrame,
    TimedEvent, Token, VERSION, Version, Want,
};
use std::io::Write;
use std::net::{SocketAddr, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::time::{Duration, Instant};

#[test]
fn a_monitor_sees_tasks_queues_and_events() {
    let folder = Folder::new("sees");
    let (runtime, tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mode = std::fs::metadata(socket(&observer)).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    let mut monitor = Monitor::unix(socket(&observer)).attach(NEW);
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
            // A monitor that uses Subscribe gets only the frames of version 1.0.
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

/// Monitors share what the observer reads from the node. Still, each monitor gets every event exactly once, whenever
/// it subscribed, and however late it reads.
#[test]
fn each_of_many_monitors_gets_every_event_once() {
    const MESSAGES: u8 = 200;
    let folder = Folder::new("shares");
    let (runtime, tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mut monitors: Vec<_> = (0..4).map(|_| Monitor::unix(socket(&observer)).attach(NEW)).collect();
    for (number, monitor) in monitors.iter_mut().enumerate() {
        // The last monitor follows the events of one task alone.
        let tasks = if number == 3 { vec![A] } else { Vec::new() };
        let events = Some(EventFilter { kinds: Kinds::ALL, tasks });
        // The third monitor subscribes to more waiting messages than the others, so it gets other frames.
        let queue_limit = if number == 2 { 3 } else { 0 };
        monitor.say(&ClientFrame::Want(Want { events, queue_limit, ..want() }));
        assert!(matches!(monitor.next(), ServerFrame::Delta(_)), "the state comes at once");
    }
    // A monitor gets its first state only after its subscription, and its events are followed from the subscription
    // on.
    let mut sent = vec![Vec::new(); monitors.len()];
    let mut states = vec![0_u32; monitors.len()];
    for message in 0..MESSAGES {
        tell.send(message).unwrap();
        std::thread::sleep(Duration::from_micros(700));
        // The second monitor does not read until all messages are sent.
        if message % 9 == 0 {
            for number in [0, 2, 3] {
                hear(&mut monitors[number], &mut sent[number], &mut states[number]);
            }
        }
    }
    let start = Instant::now();
    while sent.iter().any(|sent| sent.len() < MESSAGES.into()) {
        assert!(start.elapsed() < PATIENCE, "{:?}", sent.iter().map(Vec::len).collect::<Vec<_>>());
        for (number, monitor) in monitors.iter_mut().enumerate() {
            hear(monitor, &mut sent[number], &mut states[number]);
        }
    }
    for sent in &sent {
        assert!(sent.iter().map(|event| event.what.number).is_sorted_by(|a, b| a < b), "{sent:?}");
    }
    assert_eq!(sent[0], sent[1]);
    assert_eq!(sent[0], sent[2]);
    assert_eq!(sent[0], sent[3]);
    assert!(states.iter().all(|states| *states > 1), "{states:?}");
    drop((tell, observer));
    drop(runtime);
}

/// Reads one frame of the monitor. Adds the messages that task `a` sent to `sent`, or counts a state in `states`.
fn hear(monitor: &mut Monitor, sent: &mut Vec<TimedEvent>, states: &mut u32) {
    match monitor.next() {
        ServerFrame::Delta(_) => *states += 1,
        ServerFrame::Events(events) => {
            assert_eq!(events.lost, 0);
            let is_sent = |event: &TimedEvent| (event.task, event.what.event) == (Some(A), Event::Sent);
            sent.extend(events.events.into_iter().filter(is_sent));
        }
        ServerFrame::Places(_) => {}
        other => panic!("{other:?}"),
    }
}

#[test]
fn other_versions_and_too_many_are_refused_by_name() {
    let folder = Folder::new("refuses");
    let (runtime, _tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let other = Version { major: 9, minor: 1 };
    let answer = Monitor::unix(socket(&observer)).hello((other, SCHEMA));
    assert_eq!(answer, Handshake::Refused(Refusal::OtherMajor { node: VERSION, monitor: other }));
    let answer = Monitor::unix(socket(&observer)).hello((VERSION, SCHEMA ^ 1));
    assert_eq!(answer, Handshake::Refused(Refusal::OtherSchema { node: SCHEMA, monitor: SCHEMA ^ 1 }));

    // A monitor that wants nothing for 5 s makes room for others. Each of these monitors has read everything, and wants
    // its next frame only in an hour.
    let wants = || {
        let mut monitor = Monitor::unix(socket(&observer)).attach(NEW);
        monitor.say(&ClientFrame::Want(Want { period_us: u32::MAX, ..want() }));
        assert!(matches!(monitor.next(), ServerFrame::Delta(_)), "the state comes at once");
        monitor
    };
    let attached: Vec<_> = (0..MAX_MONITORS).map(|_| wants()).collect();
    let answer = Monitor::unix(socket(&observer)).hello((VERSION, SCHEMA));
    assert!(matches!(answer, Handshake::Refused(Refusal::TooMany { .. })), "{answer:?}");
    drop(attached);
    let start = Instant::now();
    while !matches!(Monitor::unix(socket(&observer)).hello(NEW), Handshake::Hello(_)) {
        assert!(start.elapsed() < PATIENCE, "the places of those who left stay taken");
    }
}

/// Eight monitors that want nothing must not keep other monitors out for ever: the monitor that has been idle longest
/// is disconnected.
#[test]
fn idle_monitors_make_room() {
    let folder = Folder::new("crowd");
    let (runtime, tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mut idle: Vec<_> = (0..MAX_MONITORS).map(|_| Monitor::unix(socket(&observer)).attach(NEW)).collect();
    // Only this monitor still wants frames, so it stays connected.
    idle[0].subscribe(false, u16::MAX);
    let start = Instant::now();
    let mut new = loop {
        let mut new = Monitor::unix(socket(&observer));
        if matches!(new.hello(NEW), Handshake::Hello(_)) {
            break new;
        }
        assert!(start.elapsed() < LONG, "the places of those who want nothing stay taken");
        let _ = idle[0].next();
    };
    assert!(matches!(new.next(), ServerFrame::Table(_)));
    assert!(matches!(idle[0].next(), ServerFrame::Snapshot(_)));
    assert!(matches!(idle[1].reader.read_frame(), Err(FrameError::Closed)), "the longest idle one goes");
    drop((tell, observer));
    drop(runtime);
}

/// A client that has not proven its right to look takes no place from clients with that right, even if there are many
/// such clients.
#[test]
fn strangers_lock_nobody_out() {
    let (runtime, tell) = node();
    let token = Token::of("0123456789abcdef").unwrap();
    let showing = Showing::new(runtime.node().clone()).token(Some(token.clone()));
    let observer = showing.start_tcp(SocketAddr::from(([127, 0, 0, 1], 0))).unwrap();
    let Place::Tcp(address) = *observer.place() else { panic!("over TCP") };
    // As many clients as fit into the listener's queue connect first, and the monitor connects after them.
    let silent: Vec<_> = (0..60).map(|_| TcpStream::connect(address).unwrap()).collect();
    let mut greeted = Vec::new();
    for _ in 0..MAX_MONITORS {
        let mut stranger = Monitor::tcp(address);
        assert!(matches!(stranger.hello(NEW), Handshake::Hello(_)), "it takes no place yet");
        assert!(matches!(stranger.next(), ServerFrame::Challenge(_)));
        greeted.push(stranger);
    }
    let mut monitor = Monitor::tcp(address);
    assert!(matches!(monitor.hello(NEW), Handshake::Hello(_)));
    let ServerFrame::Challenge(challenge) = monitor.next() else { panic!("no challenge") };
    monitor.say(&ClientFrame::Proof(token.proof(&challenge)));
    assert!(matches!(monitor.next(), ServerFrame::Table(_)));
    // The node closes the connections of clients that show no token after a while.
    for mut stranger in greeted {
        assert!(matches!(stranger.reader.read_frame(), Err(FrameError::Closed)));
    }
    drop((silent, tell, observer));
    drop(runtime);
}

#[test]
fn garbage_and_silence_cost_the_sender_only() {
    let folder = Folder::new("garbage");
    let (runtime, tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mut silent = Monitor::unix(socket(&observer)).attach(NEW);
    // This monitor subscribes with the largest credit, and never reads.
    silent.subscribe(true, u16::MAX);
    let mut draws = fastrand::Rng::with_seed(11);
    for _ in 0..50 {
        let mut garbage = UnixStream::connect(socket(&observer)).unwrap();
        let bytes: Vec<u8> = (0..draws.usize(0..200)).map(|_| draws.u8(..)).collect();
        let _ = garbage.write_all(&bytes);
    }
    let mut confused = Monitor::unix(socket(&observer)).attach(NEW);
    confused.writer.push_bytes(&[0xff; 9]).unwrap();
    confused.writer.flush().unwrap();
    assert!(matches!(confused.next(), ServerFrame::Bye(bye) if bye.reason == Goodbye::Misunderstood));
    assert!(matches!(confused.reader.read_frame(), Err(FrameError::Closed)));

    let mut monitor = Monitor::unix(socket(&observer)).attach(NEW);
    monitor.subscribe(false, 2);
    assert!(matches!(monitor.next(), ServerFrame::Snapshot(_)));
    assert!(matches!(monitor.next(), ServerFrame::Snapshot(_)));
    // Without credit the monitor gets no frame, until it gives credit again.
    monitor.wait_for(Duration::from_millis(100));
    assert!(matches!(monitor.reader.read_frame(), Err(FrameError::NotReady)));
    monitor.wait_for(PATIENCE);
    monitor.say(&ClientFrame::Credit(1));
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
    drop(Monitor::unix(socket(&observer)).attach(NEW));
    drop((observer, tell));
    drop(runtime);
}

#[test]
fn observing_changes_nothing_and_ends_without_a_trace() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let (tell, told) = report();
    let node = one_node(&table)
        .task("a", move |ctx| {
            let ask = ctx.port("ask")?;
            told.recv().expect("the test observes");
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
    // The test lets the task ask its first question only now, so that the observer misses no observation of a question.
    tell.send(()).expect("the task listens");
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
    // Every question makes two observations at `a`. It makes two at `b`, or three if the message had to wait.
    let all = events.len() as u64 + lost;
    assert!((8_000..=10_000).contains(&all), "{all}, {lost} of them lost");
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
    let mut monitor = Monitor::tcp(address).attach(NEW);
    monitor.subscribe(false, 1);
    assert!(matches!(monitor.next(), ServerFrame::Snapshot(_)));
    let taken = Observer::start_tcp(runtime.node().clone(), address);
    assert!(matches!(taken, Err(ObserverError::Tcp { .. })), "{taken:?}");
    drop(observer);
    assert!(matches!(monitor.next(), ServerFrame::Bye(_)));
}
