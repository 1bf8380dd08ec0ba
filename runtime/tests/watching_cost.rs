//! Tests of what monitors cost a node: a hostile monitor costs hardly any memory (M4), a watched message costs no
//! allocation (M5), the updates of a large node are short (M6), and every missing event is counted (M13).

use crate::allocator::{ByThread, live};
use crate::alone;
use crate::common::{A, B, LONG, LONG_TICKS, cell, one_node, table};
use imrs_protocol::{Event, PortDecl, PortId, Ticks, Usage};
use imrs_runtime::observer::Observer;
use imrs_runtime::{Runtime, TaskEnd};
use imrs_wire::obs::{
    ClientFrame, EventFilter, FrameError, FrameReader, FrameWriter, Handshake, Hello, Kinds, MAX_FRAME, Role,
    SCHEMA, ServerFrame, Snapshot, VERSION, Want,
};
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

/// A socket of this test; the drop removes it.
struct Socket(PathBuf);

impl Socket {
    fn new() -> Self {
        static SOCKETS: AtomicU32 = AtomicU32::new(0);
        let number = SOCKETS.fetch_add(1, Ordering::Relaxed);
        Self(std::env::temp_dir().join(format!("imrs-cost-{}-{number}.sock", std::process::id())))
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

const NEWS: PortId = PortId(0);

/// A node whose task `a` sends as many messages as the test orders, and whose task `b` takes as many as it can. Then
/// `a` reports how often the two threads allocated since the order.
fn node() -> (Runtime, Sender<u32>, Receiver<u64>) {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(16));
    let (tell, told) = channel::<u32>();
    let (done, finished) = channel();
    let (begins, began) = channel();
    let runtime = one_node(&table(cell))
        .task("a", move |ctx| {
            while let Ok(count) = told.recv() {
                let counted = ByThread::begin();
                for number in 0..count {
                    let _copies = ctx.send(NEWS, &number.to_le_bytes())?;
                }
                let allocated = counted.end(&["a", "b"]);
                done.send(allocated.iter().map(|(_, times)| times).sum()).expect("the test waits");
            }
            Ok(())
        })
        .task("b", move |ctx| {
            begins.send(()).expect("the test waits");
            while ctx.receive(Some(NEWS), None)?.is_some() {}
            Ok(())
        })
        .start()
        .unwrap();
    // Memory that a thread allocates at its start belongs to no message.
    began.recv_timeout(LONG).expect("b begins");
    (runtime, tell, finished)
}

/// Ends the node with all its threads, so that no other test counts them.
fn stop(runtime: Runtime) {
    let ends = runtime.stop(LONG);
    assert!(ends.iter().all(|(_, end)| *end == TaskEnd::Returned), "{ends:?}");
}

fn want() -> Want {
    Want {
        period_us: 10_000,
        queue_limit: 64,
        watched: Vec::new(),
        events: Some(EventFilter::ALL),
        vitals_us: 0,
        whole_us: 0,
        credit: u16::MAX,
    }
}

/// A connection that has sent its hello and its subscription.
fn attach(socket: &Socket, want: Want) -> UnixStream {
    let stream = UnixStream::connect(&socket.0).expect("the node listens");
    stream.set_read_timeout(Some(LONG)).unwrap();
    let mut writer = FrameWriter::new(stream.try_clone().unwrap());
    let hello = Hello { schema: SCHEMA, pid: 1, build: "test".into(), mono_us: 0, role: Role::Monitor };
    writer.push_bytes(&Handshake::Hello(hello).encode(VERSION)).unwrap();
    writer.push(&ClientFrame::Want(want)).unwrap();
    writer.flush().unwrap();
    stream
}

/// M4: one monitor never reads, one reads a byte at a time, and many send nonsense.
#[test]
fn hostile_monitors_cost_a_bounded_amount_of_memory() {
    let _alone = alone();
    let socket = Socket::new();
    let (runtime, tell, finished) = node();
    let observer = Observer::start_at(runtime.node().clone(), &socket.0).unwrap();
    tell.send(1_000).unwrap();
    finished.recv_timeout(LONG).unwrap();
    let before = live();
    let grows = || live() - before;
    let mut most = [0_i64; 3];
    let traffic = |most: &mut i64| {
        for _ in 0..30 {
            tell.send(2_000).unwrap();
            finished.recv_timeout(LONG).unwrap();
            *most = (*most).max(grows());
        }
    };
    let stopped = attach(&socket, want());
    traffic(&mut most[0]);
    drop(stopped);
    let slow = attach(&socket, want());
    slow.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
    let end = Arc::new(AtomicBool::new(false));
    let ended = Arc::clone(&end);
    let reading = thread::spawn(move || {
        let mut slow = slow;
        while !ended.load(Ordering::Relaxed) {
            let _ = slow.read(&mut [0]);
            thread::sleep(Duration::from_millis(1));
        }
    });
    traffic(&mut most[1]);
    end.store(true, Ordering::Relaxed);
    reading.join().unwrap();
    for round in 0..30_u8 {
        let mut mad = UnixStream::connect(&socket.0).unwrap();
        let _ = mad.write_all(&[round.wrapping_mul(37); 900]);
        most[2] = most[2].max(grows());
    }
    traffic(&mut most[2]);
    println!("memory of the process grew by at most {most:?} bytes (stopped, slow, mad)");
    assert!(most.iter().all(|&most| most <= 256 << 10), "{most:?} bytes");
    drop((observer, tell));
    stop(runtime);
}

/// M5: the lock's holder writes the data for a monitor into memory that is allocated already.
#[test]
fn a_watched_message_allocates_nothing() {
    let _alone = alone();
    let socket = Socket::new();
    let (runtime, tell, finished) = node();
    let observer = Observer::start_at(runtime.node().clone(), &socket.0).unwrap();
    let stream = attach(&socket, want());
    let (seen, sees) = channel();
    let reading = thread::spawn(move || {
        let mut reader = FrameReader::new(stream, MAX_FRAME);
        while reader.read_frame().is_ok() {
            let _ = seen.send(());
        }
    });
    // After a hello, the table and the first change, the node is watched.
    (0..3).for_each(|_| sees.recv_timeout(LONG).expect("a frame"));
    tell.send(2_000).unwrap();
    finished.recv_timeout(LONG).unwrap();
    tell.send(20_000).unwrap();
    let allocated = finished.recv_timeout(LONG).unwrap();
    println!("20,000 watched messages: {allocated} allocations on the tasks' threads");
    assert!(allocated <= 2, "{allocated} allocations");
    drop((observer, tell));
    reading.join().unwrap();
    stop(runtime);
}

/// How many ports each of the two tasks of a large node has.
const PORTS: usize = 5_000;
/// Of this many ports, one has traffic in each period: 5 % of the ports.
const APART: usize = 20;
/// The period of the updates of a large node.
const PERIOD: Duration = Duration::from_millis(100);

/// A large node. Whenever the test orders it, task `a` sends one message through each of the next [`PORTS`] /
/// [`APART`] ports. Task `b` takes these messages.
fn large_node() -> (Runtime, Sender<()>) {
    let mut cell = cell(&[0, 0], Ticks(0));
    for port in 0..PORTS {
        cell.port(PortDecl::new(&format!("p{port}"), A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(2));
    }
    let (tell, told) = channel();
    let runtime = one_node(&table(cell))
        .task("a", move |ctx| {
            let mut ports = (0..PORTS).cycle().map(PortId::from_index);
            while told.recv().is_ok() {
                for port in ports.by_ref().take(PORTS / APART) {
                    let _copies = ctx.send(port, b"news")?;
                }
            }
            Ok(())
        })
        .task("b", |ctx| {
            while ctx.receive(None, None)?.is_some() {}
            Ok(())
        })
        .start()
        .unwrap();
    (runtime, tell)
}

/// Counts the bytes that come through a socket.
struct Counted(UnixStream, Arc<AtomicU64>);

impl Read for Counted {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let read = self.0.read(bytes)?;
        self.1.fetch_add(read as u64, Ordering::Relaxed);
        Ok(read)
    }
}

/// M6: the updates that a real node with 10,000 ports sends: its whole state, updates without changes, and updates in
/// which 5 % of the ports changed, ten times a second. `IMRS_UPDATES` is the number of updates of each kind.
#[test]
fn a_large_node_sends_short_updates() {
    let _alone = alone();
    let updates: u32 = std::env::var("IMRS_UPDATES").map_or(10, |all| all.parse().expect("a number"));
    let socket = Socket::new();
    let (runtime, tell) = large_node();
    let observer = Observer::start_at(runtime.node().clone(), &socket.0).unwrap();
    let period_us = u32::try_from(PERIOD.as_micros()).unwrap();
    let wanted = Want { period_us, queue_limit: 0, events: None, vitals_us: 1_000_000, ..want() };
    let arrived = Arc::new(AtomicU64::new(0));
    let stream = Counted(attach(&socket, wanted), Arc::clone(&arrived));
    let mut reader = FrameReader::new(stream, MAX_FRAME);
    assert!(Handshake::decode(reader.read_frame().expect("an answer")).is_ok());
    let mut state = Snapshot::default();
    // Reads up to the next update. Returns its length and how many ports it changes.
    let mut next = || loop {
        let bytes = reader.read_frame().expect("it goes on");
        let length = bytes.len();
        if let ServerFrame::Delta(delta) = ServerFrame::decode(bytes).expect("a known frame") {
            let views = |state: &Snapshot| {
                let tasks = state.tasks.iter();
                tasks.flat_map(|task| task.view.ports.clone()).map(|port| port.counters).collect::<Vec<_>>()
            };
            let before = views(&state);
            state.apply(&delta).expect("a change of what was told last");
            let after = views(&state);
            return (length, after.iter().zip(&before).filter(|(after, before)| after != before).count());
        }
    };
    let (whole, _) = next();
    let per_second = |bytes: u64, updates: u32| bytes as f64 / f64::from(updates) / PERIOD.as_secs_f64();
    next();
    let begin = arrived.load(Ordering::Relaxed);
    let quiet = (0..updates).map(|_| next().1).sum::<usize>();
    let idle = per_second(arrived.load(Ordering::Relaxed) - begin, updates);
    tell.send(()).unwrap();
    next();
    let (begin, mut changed) = (arrived.load(Ordering::Relaxed), 0);
    for _ in 0..updates {
        tell.send(()).unwrap();
        changed += next().1;
    }
    let busy = per_second(arrived.load(Ordering::Relaxed) - begin, updates);
    let share = 100.0 * changed as f64 / f64::from(updates) / (2 * PORTS) as f64;
    println!(
        "10,000 ports over a socket: whole {whole} bytes; idle {idle:.0} bytes a second; {share:.1} % changed in each \
         period: {busy:.0} bytes a second"
    );
    assert_eq!(quiet, 0, "no message was sent");
    assert!(whole <= 200_000 && idle <= 1_000.0, "{whole}, {idle}");
    assert!(share > 1.0 && busy <= 100_000.0 * f64::max(share / 5.0, 1.0), "{share} %: {busy}");
    drop((tell, observer));
    stop(runtime);
}

/// M13: the number of events that happened equals those shown plus those counted as lost, even if the reader is far too slow.
#[test]
fn no_event_goes_missing_uncounted() {
    let _alone = alone();
    let all: u32 = std::env::var("IMRS_EVENTS").map_or(300_000, |all| all.parse().expect("a number"));
    let socket = Socket::new();
    let (runtime, tell, finished) = node();
    let observer = Observer::start_at(runtime.node().clone(), &socket.0).unwrap();
    let filter = EventFilter { kinds: Kinds::NONE.and(Event::Sent), tasks: vec![A] };
    let stream = attach(&socket, Want { events: Some(filter), ..want() });
    let ((told, hears), (goes_on, stands_still)) = (channel(), channel::<()>());
    let reading = thread::spawn(move || {
        let mut reader = FrameReader::new(stream, MAX_FRAME);
        let hello = reader.read_frame().map(|hello| Handshake::decode(hello).is_ok());
        assert!(matches!(hello, Ok(true)));
        loop {
            match reader.read_frame().map(ServerFrame::decode) {
                Ok(Ok(frame)) => {
                    let is_change = matches!(frame, ServerFrame::Delta(_));
                    if told.send(frame).is_err() {
                        return;
                    }
                    // The node's events are followed from the first change on, and this thread reads no event for a while.
                    if is_change {
                        let _ = stands_still.recv();
                    }
                    // The reader pauses once in a while.
                    if fastrand::u8(..) < 8 {
                        thread::sleep(Duration::from_millis(30));
                    }
                }
                Ok(Err(error)) => panic!("{error}"),
                Err(FrameError::Closed | FrameError::Truncated { .. }) => return,
                Err(error) => panic!("{error}"),
            }
        }
    });
    assert!(matches!(hears.recv_timeout(LONG), Ok(ServerFrame::Table(_))));
    while !matches!(hears.recv_timeout(LONG), Ok(ServerFrame::Delta(_))) {}
    tell.send(all / 2).unwrap();
    finished.recv_timeout(5 * LONG).unwrap();
    drop(goes_on);
    tell.send(all - all / 2).unwrap();
    let (mut shown, mut lost) = (0_u64, 0);
    let start = Instant::now();
    while shown + lost < u64::from(all) {
        assert!(start.elapsed() < 5 * LONG, "{shown} shown, {lost} lost of {all}");
        if let ServerFrame::Events(events) = hears.recv_timeout(LONG).expect("it goes on") {
            shown += events.events.len() as u64;
            lost += events.lost;
        }
    }
    finished.recv_timeout(5 * LONG).unwrap();
    println!("{all} events: {shown} shown, {lost} counted as lost");
    assert_eq!(shown + lost, u64::from(all));
    assert!(lost > 0 && shown > 0, "{shown} shown, {lost} lost");
    drop((observer, tell));
    drop(hears);
    reading.join().unwrap();
    stop(runtime);
}
