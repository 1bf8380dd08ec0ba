//! Tests of the frames that version 1.1 of the observation protocol added: changes, watched queues, metrics of the
//! process, the clock, tokens, and the addresses of the other nodes. Monitors of version 1.0 must get none of them.

use crate::common::monitor::{Folder, Monitor, NEW, OLD, PATIENCE, node, socket, want};
use crate::common::{A, B, LONG, LONG_TICKS, ask, cell, network, on, one_node, table};
use imrs_protocol::script::ProgramBuilder;
use imrs_protocol::{Cell, Event, Incarnation, PortDecl, PortId, Ticks, Usage};
use imrs_runtime::Runtime;
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::observer::{AddressBook, Observer, Place, Showing};
use imrs_wire::obs::{
    Challenge, ClientFrame, Denied, EventFilter, FrameError, Handshake, Kinds, NodePlace, Ping,
    RecordingFacts, Refusal, ServerFrame, Snapshot, Token, VERSION, Version, Want,
};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

#[test]
fn what_changed_adds_up_to_the_state_and_watched_queues_tell_more() {
    let folder = Folder::new("changes");
    let (runtime, tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let news = PortId(1);
    let mut monitor = Monitor::unix(socket(&observer)).attach(NEW);
    let kinds = Kinds::NONE.and(Event::Enqueued);
    let events = Some(EventFilter { kinds, tasks: vec![B] });
    monitor.say(&ClientFrame::Want(Want { watched: vec![(B, news)], events, ..want() }));
    let mut state = Snapshot::default();
    let ServerFrame::Delta(first) = monitor.next() else { panic!("a change comes at once") };
    assert!(first.is_whole());
    state.apply(&first).unwrap();
    assert_eq!(state.tasks.len(), 2);
    (0..3).for_each(|number| tell.send(number).unwrap());
    let (mut enqueued, mut seen) = (0, 0);
    monitor.until(&mut state, |frame, state| {
        match frame {
            ServerFrame::Delta(delta) => assert!(!delta.is_whole(), "only the first one is whole"),
            ServerFrame::Events(events) => {
                assert!(events.events.iter().all(|e| e.task == Some(B) && e.what.event == Event::Enqueued));
                enqueued += events.events.len();
            }
            ServerFrame::Detail(detail) => {
                let queue = &detail.ports[0].queue;
                assert!(!queue.handled && queue.queue.iter().all(|held| held.rank.is_none()));
                assert!(queue.queue.is_sorted_by_key(|held| held.entry.remaining));
                seen = queue.queue.len();
            }
            other => panic!("{other:?}"),
        }
        let port = state.tasks[1].view.ports.iter().find(|port| port.port == news)?;
        (port.queue.len() == 3 && enqueued == 3 && seen == 3).then_some(())
    });
    // Except for the time, the applied changes give the node's own snapshot.
    let direct = runtime.node().snapshot(0);
    assert_eq!(state.discards, direct.discards);
    let counters = |state: &Snapshot| -> Vec<_> {
        state.tasks.iter().flat_map(|task| &task.view.ports).map(|port| (port.len, port.counters)).collect()
    };
    assert_eq!(counters(&state), counters(&direct));
    // On request the whole state is sent again, without the queues that are no longer watched.
    monitor.say(&ClientFrame::Want(want()));
    monitor.say(&ClientFrame::Whole);
    monitor
        .until(&mut state, |frame, _| matches!(frame, ServerFrame::Delta(d) if d.is_whole()).then_some(()));
    assert!(state.tasks.iter().flat_map(|task| &task.view.ports).all(|port| port.queue.is_empty()));
    drop((tell, observer));
    drop(runtime);
}

#[test]
fn an_idle_node_says_next_to_nothing() {
    let folder = Folder::new("idle");
    let (runtime, _tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mut monitor = Monitor::unix(socket(&observer)).attach(NEW);
    monitor.say(&ClientFrame::Want(want()));
    let mut state = Snapshot::default();
    monitor.until(&mut state, |frame, _| matches!(frame, ServerFrame::Delta(_)).then_some(()));
    let mut bytes = 0;
    for _ in 0..10 {
        bytes += monitor.reader.read_frame().expect("a frame").len() + 4;
    }
    println!("an idle node says {bytes} bytes in ten periods");
    assert!(bytes <= 1_000, "{bytes} bytes");
}

#[test]
fn monitors_of_version_1_0_see_what_they_always_saw() {
    let folder = Folder::new("old");
    let (runtime, _tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mut monitor = Monitor::unix(socket(&observer)).attach(OLD);
    monitor.subscribe(true, u16::MAX);
    for _ in 0..20 {
        let frame = monitor.next();
        assert_eq!(frame.since(), OLD.0, "{frame:?}");
    }
}

/// The version and schema of programs that speak version 1.1.
const SECOND: (Version, u32) = (Version { major: 1, minor: 1 }, 0x17ad_ceff);

/// A restarted node with a script that is held back. `time_out` belongs to a port to another node.
fn restarted(time_out: Ticks) -> Runtime {
    let mut cell = cell(&[0, 1], Ticks(2_000));
    cell.port(ask(time_out));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let mut script = ProgramBuilder::new("a");
    script.end();
    let script = Arc::new(script.finish().expect("a sound program"));
    on(&network, &table, 0)
        .script("a", script)
        .incarnation(Incarnation(2), true)
        .hold_scripts()
        .start()
        .unwrap()
}

#[test]
fn a_restarted_node_tells_for_how_long_its_scripts_are_held_back() {
    let folder = Folder::new("held");
    let runtime = restarted(LONG_TICKS);
    let next = runtime.begin().expect("it is held back");
    assert!(next > Instant::now() && next <= Instant::now() + LONG + Duration::from_millis(2));
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mut monitor = Monitor::unix(socket(&observer)).attach(NEW);
    monitor.say(&ClientFrame::Want(want()));
    // The frame about scripts that do not begin yet is sent before the first state, for a monitor that looks only once.
    // Then it is sent again, for a monitor that begins to record.
    let ServerFrame::HeldBack(first) = monitor.next() else { panic!("what is held back comes first") };
    assert_eq!(first.tasks.iter().map(|held| held.task).collect::<Vec<_>>(), [A]);
    let mut state = Snapshot::default();
    let again = monitor.until(&mut state, |frame, _| match frame {
        ServerFrame::HeldBack(again) => Some(again.clone()),
        _ => None,
    });
    let [before, after] = [&first, &again].map(|held| held.mono_us + held.tasks[0].remaining.0);
    assert!(again.mono_us > first.mono_us && before == after, "{first:?} {again:?}");
    let mut old = Monitor::unix(socket(&observer)).attach(SECOND);
    old.say(&ClientFrame::Want(want()));
    for _ in 0..120 {
        let frame = old.next();
        assert!(frame.since().minor <= 1, "{frame:?}");
    }
}

#[test]
fn what_is_held_back_begins_once_and_is_then_told_no_more() {
    let folder = Folder::new("begins");
    let runtime = restarted(Ticks(1_500_000));
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mut monitor = Monitor::unix(socket(&observer)).attach(NEW);
    monitor.say(&ClientFrame::Want(want()));
    // The first frame is read before the script begins. A monitor that subscribes when no script is held back any more
    // gets no such frame.
    let ServerFrame::HeldBack(first) = monitor.next() else { panic!("what is held back comes first") };
    let started = Instant::now();
    while let Some(next) = runtime.begin() {
        assert!(started.elapsed() < LONG, "it never begins");
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
    assert_eq!(runtime.node().held_back().tasks, []);
    assert!(runtime.wait(LONG), "the script ends at once");
    let mut told = vec![first.tasks.len()];
    monitor.until(&mut Snapshot::default(), |frame, _| {
        let ServerFrame::HeldBack(held) = frame else { return None };
        told.push(held.tasks.len());
        held.tasks.is_empty().then_some(())
    });
    let (last, before) = told.split_last().expect("a frame");
    assert!(*last == 0 && before.iter().all(|tasks| *tasks == 1), "{told:?}");
}

#[test]
fn the_process_and_its_clock_are_told() {
    let folder = Folder::new("vitals");
    let (runtime, _tell) = node();
    let facts = RecordingFacts { path: "run.imrs".into(), lost: 3, failure: None };
    let told = facts.clone();
    let showing = Showing::new(runtime.node().clone()).recording(Arc::new(move || Some(told.clone())));
    let observer = showing.start_at(&folder.socket()).unwrap();
    let mut monitor = Monitor::unix(socket(&observer)).attach(NEW);
    monitor.say(&ClientFrame::Want(Want { vitals_us: 100_000, ..want() }));
    monitor.say(&ClientFrame::Ping(Ping { mono_us: 4242 }));
    let mut state = Snapshot::default();
    let pong = monitor.until(&mut state, |frame, _| match frame {
        ServerFrame::Pong(pong) => Some(*pong),
        _ => None,
    });
    assert!(pong.echo_us == 4242 && pong.mono_us > 0);
    let vitals = monitor.until(&mut state, |frame, _| match frame {
        ServerFrame::Vitals(vitals) => Some(vitals.clone()),
        _ => None,
    });
    assert_eq!(vitals.recording, Some(facts));
    assert!(vitals.memory > 100_000 && vitals.threads >= 4 && vitals.cpu_us > 0, "{vitals:?}");
    let lateness = vitals.timer;
    assert!(lateness.p50_us <= lateness.p99_us && lateness.p99_us <= lateness.max_us, "{lateness:?}");
}

/// The node has so many tasks that the next state is due before the previous one has been sent, as on a very busy
/// machine.
#[test]
fn a_state_that_takes_longer_than_its_period_leaves_the_rest_its_turn() {
    const TASKS: usize = 24_000;
    let folder = Folder::new("large");
    let mut cell = Cell::new("large", Ticks(1));
    let n0 = cell.node("n0");
    let names: Vec<String> = (0..TASKS).map(|number| format!("t{number}")).collect();
    names.iter().for_each(|name| _ = cell.task(name, n0));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS));
    let mut builder = one_node(&table(cell));
    for name in &names {
        builder = builder.async_task(name, |_| async { Ok(()) });
    }
    let runtime = builder.start().unwrap();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mut monitor = Monitor::unix(socket(&observer));
    assert!(matches!(monitor.hello(NEW), Handshake::Hello(_)));
    assert!(matches!(monitor.next(), ServerFrame::Table(_)));
    monitor.say(&ClientFrame::Want(Want { watched: vec![(B, PortId(0))], vitals_us: 100_000, ..want() }));
    let (mut states, mut vitals) = (0, 0);
    monitor.until(&mut Snapshot::default(), |frame, _| {
        states += usize::from(matches!(frame, ServerFrame::Delta(_)));
        vitals += usize::from(matches!(frame, ServerFrame::Vitals(_)));
        (states >= 3 && vitals >= 3).then_some(())
    });
    assert!(
        states < 1_000,
        "the state keeps what is due every 100 ms from being told: {states} of it came first"
    );
}

#[test]
fn over_tcp_a_token_keeps_others_out() {
    let (runtime, _tell) = node();
    let token = Token::of("a token of this test").unwrap();
    let any = SocketAddr::from(([127, 0, 0, 1], 0));
    let showing = Showing::new(runtime.node().clone()).token(Some(token.clone()));
    let observer = showing.start_tcp(any).unwrap();
    let Place::Tcp(address) = *observer.place() else { panic!("over TCP") };
    let challenged = || {
        let mut monitor = Monitor::tcp(address);
        assert!(matches!(monitor.hello(NEW), Handshake::Hello(_)));
        let ServerFrame::Challenge(challenge) = monitor.next() else {
            panic!("it says more before the proof")
        };
        (monitor, challenge)
    };
    let denied = |said: &dyn Fn(&Challenge) -> ClientFrame| {
        let (mut monitor, challenge) = challenged();
        monitor.say(&said(&challenge));
        let answer = monitor.next();
        assert!(matches!(monitor.reader.read_frame(), Err(FrameError::Closed)));
        answer
    };
    let other = Token::of("a token of another test").unwrap();
    let (wrong, missing) = (ServerFrame::Denied(Denied::WrongToken), ServerFrame::Denied(Denied::NoToken));
    assert_eq!(denied(&|challenge| ClientFrame::Proof(other.proof(challenge))), wrong);
    // A recorded proof is invalid, because it belongs to another connection.
    let recorded = token.proof(&challenged().1);
    assert_eq!(denied(&|_| ClientFrame::Proof(recorded)), wrong);
    assert_eq!(denied(&|_| ClientFrame::Want(want())), missing);
    assert_eq!(denied(&|_| ClientFrame::Token(token.clone())), missing, "the token itself, in clear");
    // Monitors of earlier versions cannot prove anything, so the refusal names the two versions.
    for old in [OLD, (Version { major: 1, minor: 2 }, 0xed49_0a48)] {
        let refused = Handshake::Refused(Refusal::OtherMajor { node: VERSION, monitor: old.0 });
        assert_eq!(Monitor::tcp(address).hello(old), refused);
    }

    let (mut monitor, challenge) = challenged();
    monitor.say(&ClientFrame::Proof(token.proof(&challenge)));
    assert!(matches!(monitor.next(), ServerFrame::Table(_)));
    monitor.say(&ClientFrame::Want(want()));
    assert!(matches!(monitor.next(), ServerFrame::Delta(_)));
}

#[test]
fn one_address_leads_to_the_others() {
    let folder = Folder::new("places");
    let cells = folder.0.join("test");
    std::fs::create_dir_all(&cells).unwrap();
    let (runtime, _tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &cells.join("n0-1.sock")).unwrap();
    let mut monitor = Monitor::unix(socket(&observer)).attach(NEW);
    monitor.say(&ClientFrame::Want(want()));
    let mut state = Snapshot::default();
    // This is the socket of another process of the same node, as after a restart.
    let beside = cells.join("n0-2.sock");
    std::fs::write(&beside, "").unwrap();
    let places = |frame: &ServerFrame, _: &Snapshot| match frame {
        ServerFrame::Places(places) => Some(places.nodes.clone()),
        _ => None,
    };
    let expected =
        NodePlace { node: imrs_protocol::NodeId(0), address: format!("unix:{}", beside.display()) };
    assert_eq!(monitor.until(&mut state, places), [expected]);

    let book = AddressBook::default();
    let elsewhere = SocketAddr::from(([10, 0, 0, 7], 7101));
    book.put(imrs_protocol::NodeId(1), elsewhere);
    let any = SocketAddr::from(([127, 0, 0, 1], 0));
    let observer = Showing::new(runtime.node().clone()).book(book).start_tcp(any).unwrap();
    let Place::Tcp(address) = *observer.place() else { panic!("over TCP") };
    let mut monitor = Monitor::tcp(address).attach(NEW);
    monitor.say(&ClientFrame::Want(want()));
    let told = monitor.until(&mut state, places);
    assert_eq!(told, [NodePlace { node: imrs_protocol::NodeId(1), address: "tcp:10.0.0.7:7101".into() }]);
}

#[test]
fn pings_cost_no_credit_and_nothing_comes_without() {
    let folder = Folder::new("credit");
    let (runtime, _tell) = node();
    let observer = Observer::start_at(runtime.node().clone(), &folder.socket()).unwrap();
    let mut monitor = Monitor::unix(socket(&observer)).attach(NEW);
    monitor.say(&ClientFrame::Want(Want { credit: 1, ..want() }));
    assert!(matches!(monitor.next(), ServerFrame::Delta(_)));
    monitor.say(&ClientFrame::Ping(Ping { mono_us: 1 }));
    assert!(matches!(monitor.next(), ServerFrame::Pong(_)));
    monitor.wait_for(Duration::from_millis(100));
    assert!(matches!(monitor.reader.read_frame(), Err(FrameError::NotReady)));
    monitor.wait_for(PATIENCE);
    monitor.say(&ClientFrame::Credit(1));
    assert!(matches!(monitor.next(), ServerFrame::Delta(_)));
}
