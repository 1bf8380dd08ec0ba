//! Tests of the writing thread with slow, stuck and full disks: the node never waits, and the recording reports its losses.

use super::rig::{header, read};
use imrs_protocol::TaskId;
use imrs_wire::recording::{Append, Ending, Record, Recording, Source, Status, Stream, WriteError};
use std::io::{self, ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// A time limit far above what any test needs on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// A simulated disk of limited size. It may need a token for each write.
struct Disk {
    bytes: Arc<Mutex<Vec<u8>>>,
    size: usize,
    /// If there is a receiver, each write takes one token from it.
    tokens: Option<Receiver<()>>,
    /// Whether a write waits, or has waited, for a token.
    stuck: Arc<AtomicBool>,
}

impl Disk {
    fn new() -> (Self, Arc<Mutex<Vec<u8>>>) {
        let bytes = Arc::default();
        (Self { bytes: Arc::clone(&bytes), size: usize::MAX, tokens: None, stuck: Arc::default() }, bytes)
    }

    fn held_back(mut self) -> (Self, Sender<()>) {
        let (give, tokens) = channel();
        self.tokens = Some(tokens);
        // This token lets the header be written.
        give.send(()).unwrap();
        (self, give)
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Some(tokens) = &self.tokens
            && tokens.try_recv() == Err(TryRecvError::Empty)
        {
            self.stuck.store(true, Ordering::Release);
            let _ = tokens.recv();
        }
        let mut on_disk = self.bytes.lock().unwrap();
        let room = self.size - on_disk.len();
        if room == 0 {
            return Err(ErrorKind::StorageFull.into());
        }
        let taken = room.min(bytes.len());
        on_disk.extend_from_slice(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn no_failure(error: &WriteError) {
    panic!("{error}");
}

fn wait_for(what: &str, mut done: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !done() {
        assert!(Instant::now() < end, "{what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn streams_of_several_threads_are_each_in_order() {
    let (disk, bytes) = Disk::new();
    let recording = Recording::start(disk, &header(), 1 << 14, no_failure).unwrap();
    std::thread::scope(|s| {
        for source in 0..3 {
            let mut stream = recording.frames(source);
            s.spawn(move || {
                for n in 0..1_000 {
                    assert!(stream.frame(n, vec![7]), "there is room for all");
                }
            });
        }
    });
    let status = recording.stop(PATIENCE);
    let bytes = bytes.lock().unwrap();
    let expected = Status { records: 3_002, bytes: bytes.len() as u64, lost: 0, failure: None, ended: true };
    assert_eq!(status, expected);
    let (records, ending) = read(&bytes);
    assert_eq!(ending.unwrap(), Ending::Ended);
    let mut next = [0; 3];
    for record in records {
        if let Record::Frame { source, at, .. } = record {
            assert_eq!(at, next[usize::from(source)]);
            next[usize::from(source)] += 1;
        }
    }
    assert_eq!(next, [1_000; 3]);
}

#[test]
fn what_is_handed_over_is_on_disk_soon_without_a_stop() {
    let (disk, bytes) = Disk::new();
    let recording = Recording::start(disk, &header(), 16, no_failure).unwrap();
    let mut stream = recording.frames(0);
    for n in 0..3 {
        assert!(stream.frame(n, Vec::new()));
        wait_for("a record on disk", || read(&bytes.lock().unwrap()).0.len() as u64 == n + 1);
    }
}

/// A source of numbers. Another thread adds the numbers, and the writing thread takes them.
struct Numbers {
    waiting: Arc<Mutex<Vec<u64>>>,
    /// A number that is added right after the first pass that finds nothing, so that the writing thread parks without
    /// noticing it.
    missed: Option<u64>,
}

impl Source for Numbers {
    fn fetch(&mut self, append: &mut Append<'_>) -> Result<bool, WriteError> {
        let mut waiting = self.waiting.lock().unwrap();
        let numbers = std::mem::take(&mut *waiting);
        for &lost in &numbers {
            append(&Record::Gap { stream: Stream::Task(TaskId(0)), lost })?;
        }
        if numbers.is_empty() {
            waiting.extend(self.missed.take());
        }
        Ok(!numbers.is_empty())
    }

    fn finish(&mut self, append: &mut Append<'_>) -> Result<(), WriteError> {
        self.fetch(append)?;
        append(&Record::Close { task: TaskId(0), inputs: 9, outputs: 9 })
    }
}

#[test]
fn a_source_is_emptied_soon_and_once_more_at_the_end() {
    let (disk, bytes) = Disk::new();
    let recording = Recording::start(disk, &header(), 1, no_failure).unwrap();
    let numbers = Numbers { waiting: Arc::new(Mutex::new(vec![0])), missed: Some(1) };
    let (waiting, alert) = (Arc::clone(&numbers.waiting), recording.alert());
    let on_disk = || read(&bytes.lock().unwrap()).0.len();
    recording.attach(Box::new(numbers));
    // The writing thread may already be parked, from the time when it had no source. This call makes it find the number
    // 0; its next pass then finds nothing.
    assert!(alert.call());
    // The producer does not call the writing thread for the number 1, and that thread finds it nevertheless.
    wait_for("a record on disk", || on_disk() == 2);
    wait_for("the writer to sleep", || alert.is_due());
    waiting.lock().unwrap().push(2);
    assert!(alert.call());
    wait_for("a record on disk", || on_disk() == 3);
    waiting.lock().unwrap().push(3);
    alert.hurry();
    assert!(!alert.is_over() && recording.stop(PATIENCE).ended);
    assert!(alert.is_due() && alert.is_over() && !alert.call(), "nothing is written any more");
    let gap = |lost| Record::Gap { stream: Stream::Task(TaskId(0)), lost };
    let close = Record::Close { task: TaskId(0), inputs: 9, outputs: 9 };
    assert_eq!(read(&bytes.lock().unwrap()).0, [gap(0), gap(1), gap(2), gap(3), close, Record::End]);
}

#[test]
fn a_slow_disk_makes_a_gap_and_never_a_wait() {
    let (disk, bytes) = Disk::new();
    let (disk, give) = disk.held_back();
    let stuck = Arc::clone(&disk.stuck);
    let recording = Recording::start(disk, &header(), 8, no_failure).unwrap();
    let (mut stream, mut other) = (recording.frames(0), recording.frames(1));
    assert!(stream.frame(0, Vec::new()));
    // The writing thread may drain the full queue once more before it waits for the disk.
    wait_for("the writer to be stuck", || stuck.load(Ordering::Acquire));
    let mut number = 1;
    let start = Instant::now();
    while stream.frame(number, Vec::new()) {
        number += 1;
    }
    for _ in 0..99 {
        assert!(!stream.frame(0, Vec::new()));
    }
    assert!(!other.frame(0, Vec::new()));
    assert!(start.elapsed() < PATIENCE && recording.status().lost == 101);
    // The disk takes bytes again.
    drop(give);
    wait_for("room", || stream.frame(number, Vec::new()));
    let status = recording.stop(PATIENCE);
    assert!(status.ended && status.failure.is_none());
    let (records, ending) = read(&bytes.lock().unwrap());
    assert_eq!(ending.unwrap(), Ending::Ended);
    let of = |stream: Stream| {
        records.iter().filter_map(move |r| match r {
            Record::Gap { stream: s, lost } if *s == stream => Some(*lost),
            _ => None,
        })
    };
    let before: Vec<_> = records.iter().take_while(|r| !matches!(r, Record::Gap { .. })).collect();
    assert_eq!(before.len() as u64, number, "all that was taken, then the gap");
    let lost = of(Stream::Frames(0)).sum::<u64>() + of(Stream::Frames(1)).sum::<u64>();
    assert_eq!(lost, status.lost, "every loss is told, also that of a stream that went silent");
    assert_eq!(of(Stream::Frames(1)).collect::<Vec<_>>(), [1]);
}

#[test]
fn a_full_disk_is_reported_once_and_leaves_a_readable_recording() {
    let (mut disk, bytes) = Disk::new();
    disk.size = 1_000;
    let (tell, told) = channel();
    let report = move |error: &WriteError| tell.send(error.to_string()).unwrap();
    let recording = Recording::start(disk, &header(), 1 << 10, report).unwrap();
    let mut stream = recording.frames(0);
    let end = Instant::now() + PATIENCE;
    let mut handed_over = 0;
    while recording.status().failure.is_none() {
        assert!(Instant::now() < end);
        handed_over += u64::from(stream.frame(1, Vec::new()));
        std::thread::yield_now();
    }
    wait_for("the queue is given up", || !stream.frame(1, Vec::new()));
    assert!(handed_over > 0);
    let message = told.recv_timeout(PATIENCE).unwrap();
    assert!(message.starts_with("the recording cannot be written"), "{message}");
    let status = recording.stop(PATIENCE);
    assert!(!status.ended && status.lost > 0);
    assert_eq!(status.failure, Some(message));
    assert!(told.try_recv().is_err(), "once");
    let (records, ending) = read(&bytes.lock().unwrap());
    assert!(records.len() > 10 && matches!(ending, Ok(Ending::Torn { .. } | Ending::Open)));
}

#[test]
fn a_stuck_disk_does_not_hold_up_the_stop() {
    let (disk, _bytes) = Disk::new();
    let (disk, give) = disk.held_back();
    let recording = Recording::start(disk, &header(), 4, |_| ()).unwrap();
    let mut stream = recording.frames(0);
    while stream.frame(1, Vec::new()) {}
    let status = recording.stop(Duration::from_millis(20));
    assert!(!status.ended && status.failure.is_none() && status.lost == 1);
    drop(give);
}

#[test]
fn a_dropped_recording_is_ended_too() {
    let (disk, bytes) = Disk::new();
    let recording = Recording::start(disk, &header(), 4, no_failure).unwrap();
    drop(recording);
    wait_for("the end", || matches!(read(&bytes.lock().unwrap()).1, Ok(Ending::Ended)));
}

#[test]
fn what_is_too_long_is_lost_and_not_the_recording() {
    let (disk, bytes) = Disk::new();
    let recording = Recording::start(disk, &header(), 4, no_failure).unwrap();
    let mut frames = recording.frames(1);
    assert!(!frames.frame(0, vec![0; 3 << 20]));
    assert!(frames.frame(1, vec![0; 1 << 20]), "the longest that a monitor receives");
    assert!(recording.stop(PATIENCE).ended);
    let (records, _) = read(&bytes.lock().unwrap());
    assert_eq!(records[0], Record::Gap { stream: Stream::Frames(1), lost: 1 });
    assert!(matches!(&records[1], Record::Frame { at: 1, bytes, .. } if bytes.len() == 1 << 20));
}
