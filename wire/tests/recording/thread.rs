//! Disks that are slow, stuck or full: the node never waits, and the recording says what it lost.

use crate::rig::{header, read};
use imrs_protocol::{Input, TaskId, Ticks};
use imrs_wire::recording::{Ending, Record, Recording, Status, Stream, WriteError};
use std::io::{self, ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Far more than anything here takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(20);

/// A disk: takes bytes when it is let, up to its size.
struct Disk {
    bytes: Arc<Mutex<Vec<u8>>>,
    size: usize,
    /// Where given: one write for each token.
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
        // For the header.
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

const ADVANCE: Input = Input::Advance(Ticks::ZERO);

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
        for task in 0..3 {
            let mut stream = recording.task(TaskId(task));
            s.spawn(move || {
                for n in 0..1_000 {
                    assert!(stream.input(Ticks(n), ADVANCE, n), "there is room for all");
                }
                assert!(stream.keyframe(vec![0; 100], 0));
            });
        }
        assert!(recording.frames(4).frame(1, b"seen".to_vec()));
    });
    let status = recording.stop(PATIENCE);
    let bytes = bytes.lock().unwrap();
    let expected = Status { records: 3_006, bytes: bytes.len() as u64, lost: 0, failure: None, ended: true };
    assert_eq!(status, expected);
    let (records, ending) = read(&bytes);
    assert_eq!(ending.unwrap(), Ending::Ended);
    let mut next = [0; 3];
    for record in records {
        if let Record::Input { task, elapsed, outputs, .. } = record {
            assert_eq!((elapsed.0, outputs), (next[task.index()], next[task.index()]));
            next[task.index()] += 1;
        }
    }
    assert_eq!(next, [1_000; 3]);
}

#[test]
fn what_is_handed_over_is_on_disk_soon_without_a_stop() {
    let (disk, bytes) = Disk::new();
    let recording = Recording::start(disk, &header(), 16, no_failure).unwrap();
    let mut stream = recording.task(TaskId(0));
    for n in 0..3 {
        assert!(stream.input(Ticks(n), ADVANCE, n));
        wait_for("a record on disk", || read(&bytes.lock().unwrap()).0.len() as u64 == n + 1);
    }
}

#[test]
fn a_slow_disk_makes_a_gap_and_never_a_wait() {
    let (disk, bytes) = Disk::new();
    let (disk, give) = disk.held_back();
    let recording = Recording::start(disk, &header(), 8, no_failure).unwrap();
    let mut stream = recording.task(TaskId(0));
    let mut other = recording.task(TaskId(1));
    let mut number = 0;
    let mut taken = Vec::new();
    let start = Instant::now();
    while !stream.needs_keyframe() {
        if stream.input(Ticks(number), ADVANCE, number) {
            taken.push(number);
        }
        number += 1;
    }
    for _ in 0..99 {
        assert!(!stream.input(Ticks(0), ADVANCE, 0));
    }
    assert!(!other.input(Ticks(0), ADVANCE, 0) && other.needs_keyframe());
    assert!(start.elapsed() < PATIENCE && recording.status().lost == 101);
    // The disk takes bytes again.
    drop(give);
    wait_for("room", || stream.keyframe(vec![7], 42));
    assert!(!stream.needs_keyframe());
    wait_for("room", || stream.input(Ticks(5), ADVANCE, 43));
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
    assert_eq!(before.len(), taken.len(), "all that was taken, then the gap");
    let lost = of(Stream::Task(TaskId(0))).sum::<u64>() + of(Stream::Task(TaskId(1))).sum::<u64>();
    assert_eq!(lost, status.lost, "every loss is told, also that of a stream that went silent");
    assert_eq!(of(Stream::Task(TaskId(1))).collect::<Vec<_>>(), [1]);
    let keyframe = records.iter().position(|r| matches!(r, Record::Keyframe { .. })).unwrap();
    assert!(matches!(records[keyframe - 1], Record::Gap { .. }));
}

#[test]
fn a_keyframe_is_wanted_once_the_disk_keeps_up_again_and_nothing_is_recorded_before_it() {
    let (disk, bytes) = Disk::new();
    let (disk, give) = disk.held_back();
    let stuck = Arc::clone(&disk.stuck);
    let recording = Recording::start(disk, &header(), 64, no_failure).unwrap();
    let mut stream = recording.task(TaskId(0));
    assert!(stream.input(Ticks(0), ADVANCE, 0));
    // From here on nothing leaves the queue.
    wait_for("the disk to be stuck", || stuck.load(Ordering::Acquire));
    let mut number = 1;
    while stream.input(Ticks(number), ADVANCE, number) {
        assert!(!stream.wants_keyframe(), "nothing is missing");
        number += 1;
    }
    assert!(
        stream.needs_keyframe() && !stream.wants_keyframe(),
        "the queue is full: it would be lost as well"
    );
    drop(give);
    wait_for("room for a keyframe", || stream.wants_keyframe());
    for _ in 0..5 {
        assert!(!stream.input(Ticks(0), ADVANCE, 0), "there is room, but it could not be replayed");
    }
    assert!(stream.wants_keyframe() && stream.keyframe(vec![7], 42) && !stream.wants_keyframe());
    assert!(stream.input(Ticks(1), ADVANCE, 43));
    assert!(recording.stop(PATIENCE).ended);
    assert!(!stream.input(Ticks(1), ADVANCE, 44) && !stream.wants_keyframe(), "nothing is written any more");
    let (records, _) = read(&bytes.lock().unwrap());
    let after = records.iter().skip_while(|record| matches!(record, Record::Input { .. }));
    let after: Vec<_> = after.cloned().collect();
    let task = TaskId(0);
    let expected = [
        Record::Gap { stream: Stream::Task(task), lost: 6 },
        Record::Keyframe { task, state: vec![7], outputs: 42 },
        Record::Input { task, elapsed: Ticks(1), input: ADVANCE, outputs: 43 },
        Record::End,
    ];
    assert_eq!(after, expected);
}

#[test]
fn a_full_disk_is_reported_once_and_leaves_a_readable_recording() {
    let (mut disk, bytes) = Disk::new();
    disk.size = 1_000;
    let (tell, told) = channel();
    let report = move |error: &WriteError| tell.send(error.to_string()).unwrap();
    let recording = Recording::start(disk, &header(), 1 << 10, report).unwrap();
    let mut stream = recording.task(TaskId(0));
    let end = Instant::now() + PATIENCE;
    let mut handed_over = 0;
    while recording.status().failure.is_none() {
        assert!(Instant::now() < end);
        handed_over += u64::from(stream.input(Ticks(1), ADVANCE, 1));
        std::thread::yield_now();
    }
    wait_for("the queue is given up", || !stream.input(Ticks(1), ADVANCE, 1));
    assert!(stream.needs_keyframe() && !stream.wants_keyframe() && handed_over > 0);
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
    let mut stream = recording.task(TaskId(0));
    while stream.input(Ticks(1), ADVANCE, 1) {}
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
