//! Tests of the live source and the printing modes with servers on real Unix sockets: good, slow, hostile and dying ones.

mod printed;

use crate::common::server::{Peer, listen};
use crate::common::{LIFT, NODES, events, identity, observed, snapshot, table};
use imrs_monitor::clock::Clock;
use imrs_monitor::source::live::Which;
use imrs_monitor::store::Presence;
use imrs_monitor::{Endpoint, Format, Options, Verdict, Watch, report};
use imrs_protocol::{Event, NodeId};
use imrs_wire::obs::{
    ClientFrame, Delta, Denied, Handshake, NodePlace, Places, Refusal, SCHEMA, ServerFrame, Snapshot,
    VERSION, Version, place,
};
use std::net::Shutdown;
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::{Duration, Instant};

/// A time limit far above what any test needs on a busy machine.
const LIMIT: Duration = Duration::from_secs(120);

fn base() -> (tempfile::TempDir, PathBuf) {
    let temp = tempfile::tempdir().unwrap();
    let base = temp.path().join("imrs");
    (temp, base)
}

/// Starts well-behaved nodes.
fn serve(base: &Path, nodes: std::ops::Range<usize>) {
    for node in nodes {
        listen(base, NODES.get(node).unwrap(), move |mut peer| peer.serve(node));
    }
}

fn watch(base: &Path) -> (Watch, Clock) {
    let clock = Clock::start();
    (Watch::start(Which::Under(base.to_owned()), clock).unwrap(), clock)
}

/// Watches the nodes until `done` returns true.
fn until(watch: &mut Watch, what: &str, done: impl Fn(&Watch) -> bool) {
    let end = Instant::now() + LIMIT;
    while !done(watch) {
        assert!(Instant::now() < end, "{what}: never");
        watch.watch(Duration::from_millis(10));
    }
}

/// Watches until a node has delivered its state, for longer than the monitor itself would wait.
fn settled(watch: &mut Watch) {
    let end = Instant::now() + LIMIT;
    while !watch.settle() {
        assert!(Instant::now() < end, "no node shows itself");
    }
}

/// The error for a server that does not send its hello within three seconds.
const SILENCE: &str = "no answer in 3s; is the node stopped?";

fn first_trouble(watch: &Watch) -> Option<&str> {
    watch.store().troubles().next()
}

/// The reason why attaching fails to a server that does `each` with every connection. On a busy machine any server may
/// be silent too long at first; a later attempt shows the real reason.
fn trouble_with(each: impl Fn(Peer) + Send + Clone + 'static) -> String {
    let (_temp, base) = base();
    listen(&base, "nl", each);
    let (mut watch, _) = watch(&base);
    until(&mut watch, "a trouble", |w| first_trouble(w).is_some_and(|said| !said.contains(SILENCE)));
    first_trouble(&watch).unwrap().to_owned()
}

/// The reason for which the connection is lost to a node that does `each` after the handshake.
fn loss_with(each: impl Fn(&mut Peer) + Send + Clone + 'static) -> String {
    let (_temp, base) = base();
    listen(&base, "nl", move |mut peer| {
        if peer.greet(0).is_ok() {
            peer.say(&ServerFrame::Snapshot(snapshot(0))).unwrap();
            each(&mut peer);
            // The server keeps reading, so that the monitor's reads fail and never its writes.
            let _ = peer.writer.get_ref().shutdown(Shutdown::Write);
            while peer.hear().is_ok() {}
        }
    });
    let (mut watch, _) = watch(&base);
    let dead = |w: &Watch| w.store().journal().lines(false, "dead").last().map(|e| e.detail());
    until(&mut watch, "a death", |w| dead(w).is_some());
    assert!(!watch.store().incarnations()[0].tasks().is_empty(), "the last state is kept");
    dead(&watch).unwrap()
}

#[test]
fn a_cell_is_found_and_shown_and_new_nodes_join() {
    let (_temp, base) = base();
    listen(&base, NODES[0], |mut peer| peer.serve(0));
    let (mut watch, clock) = watch(&base);
    settled(&mut watch);
    assert_eq!(watch.store().incarnations().len(), 1);
    serve(&base, 1..3);
    until(&mut watch, "three nodes", |w| {
        w.store().incarnations().iter().filter(|l| l.last.is_some()).count() == 3
    });
    // On a busy machine a node may have been silent for a second, but all nodes continue.
    until(&mut watch, "all of them up, and nothing critical", |w| {
        let now = clock.now();
        w.store().incarnations().iter().all(|l| l.presence(now) == Presence::Up)
            && !report::is_critical(w.store(), None, now)
    });
    assert_eq!(watch.store().incarnations().len(), 3);
}

#[test]
fn a_node_gets_credit_back_and_is_heard_again_and_again() {
    let (_temp, base) = base();
    let sent = Arc::new(AtomicU32::new(0));
    let count = sent.clone();
    listen(&base, "nl", move |mut peer| {
        let mut credit = peer.greet(0).unwrap();
        while credit > 0 && count.load(Ordering::Relaxed) < 100 {
            peer.say(&ServerFrame::Snapshot(snapshot(0))).unwrap();
            count.fetch_add(1, Ordering::Relaxed);
            credit -= 1;
            while credit == 0 {
                let Ok(ClientFrame::Credit(more)) = peer.hear() else { return };
                credit += more;
            }
        }
        thread::sleep(LIMIT);
    });
    let (mut watch, _) = watch(&base);
    until(&mut watch, "100 snapshots on 8 credits", |_| sent.load(Ordering::Relaxed) == 100);
}

#[test]
fn a_dead_node_is_shown_dead_and_comes_back_after_a_restart() {
    let (_temp, base) = base();
    let incarnations = Arc::new(AtomicU32::new(0));
    let count = incarnations.clone();
    listen(&base, "nl", move |mut peer| {
        // A connection that ends before the handshake is not counted as an incarnation.
        let Ok(credit) = peer.greet(0) else { return };
        if count.fetch_add(1, Ordering::Relaxed) == 0 {
            peer.say(&ServerFrame::Snapshot(snapshot(0))).unwrap();
        } else {
            peer.serve_on(0, credit);
        }
    });
    let (mut watch, clock) = watch(&base);
    // The node may run again before this check, but the journal has its death.
    until(&mut watch, "death", |w| !w.store().journal().lines(false, "dead").is_empty());
    until(&mut watch, "return", |w| w.store().incarnations()[0].presence(clock.now()) == Presence::Up);
    // The monitor shows the new incarnation from its first frame on; the server counts it after the handshake.
    until(&mut watch, "its second life", |_| incarnations.load(Ordering::Relaxed) == 2);
}

#[test]
fn another_version_is_refused_with_both_named() {
    let trouble = trouble_with(|mut peer| drop(peer.hello(0, Version { major: 2, minor: 3 }, SCHEMA)));
    assert!(trouble.contains("it speaks imrs-obs 2.3, this monitor 1.4"), "{trouble}");
    let trouble = trouble_with(|mut peer| drop(peer.hello(0, VERSION, SCHEMA ^ 1)));
    assert!(trouble.contains("other frame types"), "{trouble}");
    let trouble = trouble_with(|mut peer| {
        let _ = peer.reader.read_frame();
        let refused = Handshake::Refused(Refusal::TooMany { limit: 4 });
        let _ = peer.writer.push_bytes(&refused.encode(VERSION));
        let _ = peer.writer.flush();
    });
    assert!(trouble.contains("serves 4 monitors already"), "{trouble}");
}

#[test]
fn strangers_and_silence_are_told_apart() {
    let trouble = trouble_with(|mut peer| {
        // If a connection is closed with unread data, it may be reset before the peer has read anything. So the server
        // reads first.
        let _ = peer.reader.read_frame();
        peer.raw(b"\x20\0\0\0HTTP/1.1 400 Bad Request\r\n\r\nxxxx");
    });
    assert!(trouble.contains("does not speak imrs-obs"), "{trouble}");
    let (_temp, base) = base();
    listen(&base, "nl", |_peer| thread::sleep(LIMIT));
    let (mut watch, _) = watch(&base);
    until(&mut watch, "a trouble", |w| first_trouble(w).is_some());
    assert!(first_trouble(&watch).unwrap().contains(SILENCE), "{:?}", first_trouble(&watch));
    let trouble = trouble_with(drop);
    assert!(trouble.contains("closed"), "{trouble}");
}

#[test]
fn garbage_oversize_and_broken_frames_end_the_connection_with_their_reason() {
    assert!(loss_with(|peer| peer.raw(&[5, 0, 0, 0, 1, 0xff, 0xff, 0xff, 0xff])).contains("malformed frame"));
    assert!(loss_with(|peer| peer.raw(&u32::MAX.to_le_bytes())).contains("4294967295 bytes"));
    assert!(loss_with(|peer| peer.raw(&[9, 0, 0, 0, 1, 2])).contains("closed after 6 of a frame's 13 bytes"));
    assert!(loss_with(|_| {}).contains("the connection was closed"));
}

#[test]
fn a_frame_of_a_later_minor_version_is_passed_over() {
    let (_temp, base) = base();
    listen(&base, "nl", |mut peer| {
        peer.greet(0).unwrap();
        peer.raw(&[3, 0, 0, 0, 77, 1, 2]);
        let frame = ServerFrame::Snapshot(Snapshot { uptime_us: 4242, ..snapshot(0) });
        peer.say(&frame).unwrap();
        thread::sleep(LIMIT);
    });
    let (mut watch, _) = watch(&base);
    let uptime = |w: &Watch| w.store().incarnations().first()?.last.as_ref().map(|s| s.snapshot.uptime_us);
    until(&mut watch, "the frame after it", |w| uptime(w) == Some(4242));
}

#[test]
fn a_byte_at_a_time_is_slow_and_nothing_worse() {
    let (_temp, base) = base();
    listen(&base, "nl", |mut peer| {
        peer.greet(0).unwrap();
        let bytes = postcard::to_allocvec(&ServerFrame::Snapshot(snapshot(0))).unwrap();
        peer.raw(&u32::try_from(bytes.len()).unwrap().to_le_bytes());
        for byte in bytes {
            peer.raw(&[byte]);
            thread::sleep(Duration::from_millis(2));
        }
        thread::sleep(LIMIT);
    });
    let (mut watch, _) = watch(&base);
    until(&mut watch, "a slow snapshot", |w| {
        w.store().incarnations().first().is_some_and(|l| l.last.is_some())
    });
}

#[test]
fn a_socket_that_a_killed_node_left_is_removed_and_remembered() {
    let (_temp, base) = base();
    listen(&base, "nl", |mut peer| peer.serve(0));
    let stale = place::prepare_in(&base, "beam-lift", "nh", 4_194_305).unwrap();
    drop(UnixListener::bind(&stale).unwrap());
    let (mut watch, clock) = watch(&base);
    until(&mut watch, "the node that is there", |w| {
        w.store().incarnations().iter().any(|l| l.last.is_some())
    });
    until(&mut watch, "removal", |_| !stale.exists());
    until(&mut watch, "a finding", |w| report::is_critical(w.store(), None, clock.now()));
    let text = report::text(watch.store(), None, clock.now());
    assert!(text.contains("node nh: DEAD") && text.contains("node nr: not seen here"), "{text}");
}

/// The version and schema of programs that use version 1.0.
const OLD: (Version, u32) = (Version { major: 1, minor: 0 }, 0x3723_afbb);

#[test]
fn a_node_of_version_1_0_is_asked_in_its_own_words() {
    let (_temp, base) = base();
    let sent = Arc::new(AtomicU32::new(0));
    let count = sent.clone();
    listen(&base, "nl", move |mut peer| {
        peer.hello(0, OLD.0, OLD.1).unwrap();
        peer.say(&ServerFrame::Table(table())).unwrap();
        let frame = peer.reader.read_frame().unwrap();
        let Ok(ClientFrame::Subscribe(wanted)) = ClientFrame::decode(frame) else { panic!("{frame:?}") };
        assert!(wanted.events && wanted.queue_limit == 64 && wanted.credit > 0);
        let mut credit = wanted.credit;
        while count.load(Ordering::Relaxed) < 30 {
            peer.say(&ServerFrame::Snapshot(snapshot(0))).unwrap();
            count.fetch_add(1, Ordering::Relaxed);
            credit -= 1;
            while credit == 0 {
                // The monitor never sends any other frame to a node of version 1.0.
                let frame = peer.reader.read_frame().unwrap();
                let Ok(ClientFrame::Credit(more)) = ClientFrame::decode(frame) else { panic!("{frame:?}") };
                credit += more;
            }
        }
        thread::sleep(LIMIT);
    });
    let (mut watch, _) = watch(&base);
    until(&mut watch, "30 snapshots", |_| sent.load(Ordering::Relaxed) == 30);
    // The frames that the node has sent may not have reached the store yet.
    until(&mut watch, "its tasks", |w| {
        w.store().incarnations().first().is_some_and(|l| !l.tasks().is_empty())
    });
}

#[test]
fn a_change_that_does_not_follow_is_answered_by_asking_for_all() {
    let (_temp, base) = base();
    listen(&base, "nl", move |mut peer| {
        peer.greet(0).unwrap();
        let later = Snapshot { mono_us: 9_000_000, uptime_us: 1, ..snapshot(0) };
        peer.say(&ServerFrame::Delta(Delta::whole(&snapshot(0)))).unwrap();
        let elsewhere = Snapshot { mono_us: 77, ..snapshot(0) };
        peer.say(&ServerFrame::Delta(Delta::between(&elsewhere, &later))).unwrap();
        while !matches!(peer.hear(), Ok(ClientFrame::Whole)) {}
        peer.say(&ServerFrame::Delta(Delta::whole(&later))).unwrap();
        thread::sleep(LIMIT);
    });
    let (mut watch, _) = watch(&base);
    until(&mut watch, "the later state", |w| {
        w.store().incarnations().iter().any(|l| l.last.as_ref().is_some_and(|s| s.snapshot.uptime_us == 1))
    });
    assert_eq!(watch.store().gaps(), 0, "what does not follow is not passed on");
}

#[test]
fn a_node_that_asks_for_a_token_is_no_dead_node() {
    let trouble = trouble_with(|mut peer| {
        peer.hello(0, VERSION, SCHEMA).unwrap();
        assert!(matches!(peer.hear(), Ok(ClientFrame::Want(_))), "there is no token to show");
        peer.say(&ServerFrame::Denied(Denied::NoToken)).unwrap();
    });
    assert!(trouble.contains("--token FILE"), "{trouble}");
}

#[test]
fn one_address_leads_to_the_whole_cell() {
    let (_temp, base) = base();
    let third = listen(&base, NODES[2], |mut peer| peer.serve(2));
    let first = listen(&base, NODES[0], move |mut peer| {
        peer.hello(0, VERSION, SCHEMA).unwrap();
        peer.say(&ServerFrame::Table(table())).unwrap();
        assert!(matches!(peer.hear(), Ok(ClientFrame::Want(_))));
        let place = |address: String| NodePlace { node: NodeId(2), address };
        let nodes = vec![place("tcp:nowhere".into()), place(format!("unix:{}", third.display()))];
        for _ in 0..3 {
            // The monitor connects only once to an address that is reported twice.
            peer.say(&ServerFrame::Places(Places { nodes: nodes.clone() })).unwrap();
        }
        peer.say(&ServerFrame::Snapshot(snapshot(0))).unwrap();
        thread::sleep(LIMIT);
    });
    let named = Which::Named(vec![Endpoint::Unix(first)]);
    let mut watch = Watch::start(named, Clock::start()).unwrap();
    settled(&mut watch);
    let shown = |w: &Watch| w.store().incarnations().iter().filter(|l| l.last.is_some()).count();
    until(&mut watch, "two nodes", |w| shown(w) == 2);
    assert_eq!(shown(&watch), 2);
}
