//! Tests of what monitors cost a node: a hostile monitor costs hardly any memory (M4), a watched message costs no
//! allocation (M5), and every missing event is counted (M13).

use crate::allocator::{ByThread, live};
use crate::alone;
use crate::common::{A, B, LONG, LONG_TICKS, cell, one_node, table};
use imrs_protocol::{Event, PortDecl, PortId, Ticks, Usage};
use imrs_runtime::observer::Observer;
use imrs_runtime::{Runtime, TaskEnd};
use imrs_wire::obs::{
    ClientFrame, EventFilter, FrameError, FrameReader, FrameWriter, Handshake, Hello, Kinds, MAX_FRAME, Role,
    SCHEMA, ServerFrame, VERSION, Want,
};
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

/// A socket that belongs to this test, and that is removed when this is dropped.
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

/// M5: the data for a monitor are written under the lock that the machine holds anyway, into allocated memory.
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
