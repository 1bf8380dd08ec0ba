//! Writes a recording from its own thread, so that a slow disk never blocks a node.
//!
//! Records reach that thread in two ways. Streams of few, long records use a queue. Streams of many, short records use
//! [`Source`]s, which the thread drains itself. No producer ever waits for a queue or a source.

use super::{Header, MAX_RECORD_BYTES, Record, RecordingWriter, Stream, WriteError};
use std::io::{BufWriter, Write};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, SyncSender};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{self, JoinHandle, Thread};
use std::time::{Duration, Instant};

/// How long the thread pauses after a pass that found records, unless [`Alert::hurry`] ends the pause. During the pause
/// no producer needs to wake the thread.
const GATHER: Duration = Duration::from_millis(5);
/// How long the thread parks after a pass that found nothing, unless a producer wakes it. A producer reads the thread's
/// state without a fence, so it may miss that the thread is about to park, and not wake it. Then its record is written
/// later, by this time at most. After this time every producer sees [`ASLEEP`], so the next park has no timeout.
const SLEEP: Duration = Duration::from_millis(50);
const BUFFER_BYTES: usize = 64 * 1024;
/// The longest state or frame that can be recorded, in bytes; the other fields of its record fit into the remaining 64.
pub const LONGEST: usize = MAX_RECORD_BYTES - 64;

/// The writing thread makes its next pass by itself, soon.
const AWAKE: u8 = 0;
/// The writing thread found nothing, and is parked or about to park.
const ASLEEP: u8 = 1;
/// The writing thread has ended, and writes nothing any more.
const OVER: u8 = 2;

#[derive(Default)]
struct Shared {
    /// How many records the queue can hold.
    capacity: usize,
    /// The writing thread, which [`Thread::unpark`] wakes.
    writer: OnceLock<Thread>,
    /// [`AWAKE`], [`ASLEEP`] or [`OVER`].
    state: AtomicU8,
    records: AtomicU64,
    bytes: AtomicU64,
    stopping: AtomicBool,
    failure: Mutex<Option<String>>,
    streams: Mutex<Vec<Arc<Losses>>>,
    sources: Mutex<Vec<Box<dyn Source>>>,
}

/// Appends a record to the recording. After an error no further record can be appended.
pub type Append<'a> = dyn FnMut(&Record) -> Result<(), WriteError> + 'a;

/// A buffer that the writing thread drains repeatedly.
pub trait Source: Send {
    /// Appends the records that are in the buffer at the time of the call, and no later ones. Returns whether there were any.
    ///
    /// # Errors
    /// The errors of `append`.
    fn fetch(&mut self, append: &mut Append<'_>) -> Result<bool, WriteError>;

    /// Appends the remaining records, and the losses that no gap record has reported yet.
    ///
    /// # Errors
    /// The errors of `append`.
    fn finish(&mut self, append: &mut Append<'_>) -> Result<(), WriteError>;
}

/// The handle of a producer that feeds a [`Source`] on the writing thread: its state, and the wake-up.
#[derive(Clone)]
pub struct Alert(Arc<Shared>);

impl Alert {
    /// Whether the writing thread must be woken with [`call`](Self::call). Check this after each record put into a source.
    #[must_use]
    pub fn is_due(&self) -> bool {
        self.0.state.load(Ordering::Relaxed) != AWAKE
    }

    /// Wakes the writing thread if it is parked. Returns false if that thread writes nothing any more.
    pub fn call(&self) -> bool {
        self.0.call()
    }

    /// Ends the pause of the writing thread, because a source is filling up.
    pub fn hurry(&self) {
        self.0.unpark();
    }

    /// Whether the writing thread has ended, so that nothing is written any more.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.0.state.load(Ordering::Relaxed) == OVER
    }
}

/// The loss counters of a stream.
struct Losses {
    stream: Stream,
    /// How many records were lost since the stream's last gap record.
    unannounced: AtomicU64,
    total: AtomicU64,
}

impl Losses {
    fn add(&self) {
        self.unannounced.fetch_add(1, Ordering::Relaxed);
        self.total.fetch_add(1, Ordering::Relaxed);
    }

    /// Takes the number of lost records that no gap record has reported yet; the caller must report it.
    fn take(&self) -> Option<u64> {
        let lost = self.unannounced.swap(0, Ordering::Relaxed);
        (lost > 0).then_some(lost)
    }
}

/// The state of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// How many records were written, the header included.
    pub records: u64,
    /// How many bytes were written.
    pub bytes: u64,
    /// How many records were lost: the queue was full, the record was too long, or the medium had failed.
    pub lost: u64,
    /// Why writing stopped, if it failed.
    pub failure: Option<String>,
    /// Whether the recording has an end record and was completely written.
    pub ended: bool,
}

/// A recording that a thread of its own writes.
///
/// Frames are recorded through one handle for each of their sources ([`frames`](Self::frames)), all other records through
/// [`Source`]s. [`stop`](Self::stop) ends the recording and waits. Dropping this value ends the recording, too, without waiting.
pub struct Recording {
    queue: SyncSender<Record>,
    shared: Arc<Shared>,
    /// The writing thread, which returns whether everything was written.
    thread: Option<JoinHandle<bool>>,
}

impl Recording {
    /// Starts a recording on `sink`, with a queue of `capacity` records. If the medium fails, the writing thread calls
    /// `on_failure`, at most once, and writes nothing more.
    ///
    /// # Errors
    /// If the header cannot be written or no thread can be started.
    pub fn start(
        sink: impl Write + Send + 'static,
        header: &Header,
        capacity: usize,
        on_failure: impl FnOnce(&WriteError) + Send + 'static,
    ) -> Result<Self, WriteError> {
        let mut writer = RecordingWriter::new(BufWriter::with_capacity(BUFFER_BYTES, sink), header)?;
        writer.flush()?;
        let capacity = capacity.max(1);
        let (queue, records) = mpsc::sync_channel(capacity);
        let shared = Arc::new(Shared { capacity, ..Shared::default() });
        shared.count(&writer);
        let for_thread = Arc::clone(&shared);
        let run = move || {
            let written = write(writer, &records, &for_thread);
            for_thread.state.store(OVER, Ordering::Release);
            let Err(error) = written else { return true };
            *for_thread.failure() = Some(error.to_string());
            on_failure(&error);
            false
        };
        let thread = thread::Builder::new().name("recording".into()).spawn(run)?;
        shared.writer.get_or_init(|| thread.thread().clone());
        Ok(Self { queue, shared, thread: Some(thread) })
    }

    /// A handle to check and wake the writing thread.
    #[must_use]
    pub fn alert(&self) -> Alert {
        Alert(Arc::clone(&self.shared))
    }

    /// Adds a source that the writing thread drains from now on.
    pub fn attach(&self, source: Box<dyn Source>) {
        self.shared.sources().push(source);
    }

    /// A handle to record the frames of one source.
    #[must_use]
    pub fn frames(&self, source: u16) -> FrameStream {
        FrameStream { source, outlet: self.outlet(Stream::Frames(source)) }
    }

    /// The present state of the recording.
    #[must_use]
    pub fn status(&self) -> Status {
        self.shared.status(false)
    }

    /// Ends the recording: writes the queued records, the gaps and the end record. Waits at most `patience`; if the
    /// disk is slower, the writing thread finishes alone.
    #[must_use]
    pub fn stop(mut self, patience: Duration) -> Status {
        self.shared.stop();
        let end = Instant::now() + patience;
        let finished = |thread: &JoinHandle<bool>| thread.is_finished();
        while !self.thread.as_ref().is_none_or(finished) && Instant::now() < end {
            thread::sleep(Duration::from_millis(1));
        }
        let ended =
            self.thread.take_if(|thread| thread.is_finished()).is_some_and(|t| t.join().unwrap_or(false));
        self.shared.status(ended)
    }

    fn outlet(&self, stream: Stream) -> Outlet {
        let losses = Losses { stream, unannounced: AtomicU64::new(0), total: AtomicU64::new(0) };
        let losses = Arc::new(losses);
        self.shared.streams().push(Arc::clone(&losses));
        Outlet { queue: self.queue.clone(), shared: Arc::clone(&self.shared), losses }
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        self.shared.stop();
    }
}

impl Shared {
    fn sources(&self) -> MutexGuard<'_, Vec<Box<dyn Source>>> {
        self.sources.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn streams(&self) -> MutexGuard<'_, Vec<Arc<Losses>>> {
        self.streams.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn failure(&self) -> MutexGuard<'_, Option<String>> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn status(&self, ended: bool) -> Status {
        Status {
            records: self.records.load(Ordering::Relaxed),
            bytes: self.bytes.load(Ordering::Relaxed),
            lost: self.streams().iter().map(|losses| losses.total.load(Ordering::Relaxed)).sum(),
            failure: self.failure().clone(),
            ended,
        }
    }

    fn stop(&self) {
        self.stopping.store(true, Ordering::Release);
        self.unpark();
    }

    fn unpark(&self) {
        self.writer.get().into_iter().for_each(Thread::unpark);
    }

    fn call(&self) -> bool {
        match self.state.compare_exchange(ASLEEP, AWAKE, Ordering::Relaxed, Ordering::Relaxed) {
            Ok(_) => self.unpark(),
            Err(state) => return state != OVER,
        }
        true
    }

    fn count<W: Write>(&self, writer: &RecordingWriter<W>) {
        self.records.store(writer.records(), Ordering::Relaxed);
        self.bytes.store(writer.written(), Ordering::Relaxed);
    }
}

/// The loop of the writing thread. Ends when the recording is stopped or the medium fails.
fn write<W: Write>(
    mut writer: RecordingWriter<W>,
    queue: &Receiver<Record>,
    shared: &Shared,
) -> Result<(), WriteError> {
    let mut sleeps_since = None;
    loop {
        // The flag is read before the last pass, so that this pass writes all records that were queued before the stop.
        let stopping = shared.stopping.load(Ordering::Acquire);
        // `seen` is computed before the pass, too, because the pass may be the last one before a park without
        // timeout.
        let seen = sleeps_since.is_some_and(|since: Instant| since.elapsed() >= SLEEP);
        let mut found = false;
        for record in queue.try_iter().take(shared.capacity) {
            found = true;
            writer.append(&record)?;
        }
        for source in shared.sources().iter_mut() {
            found |= source.fetch(&mut |record| writer.append(record))?;
        }
        if found {
            writer.flush()?;
            shared.count(&writer);
        }
        if stopping {
            break;
        }
        pause(shared, found, seen, &mut sleeps_since);
    }
    finish(writer, queue, shared)
}

/// Pauses until there may be new records. `seen` says that every producer had seen [`ASLEEP`] before the last pass.
fn pause(shared: &Shared, found: bool, seen: bool, sleeps_since: &mut Option<Instant>) {
    if found {
        shared.state.store(AWAKE, Ordering::Relaxed);
        *sleeps_since = None;
        thread::park_timeout(GATHER);
    } else if shared.state.swap(ASLEEP, Ordering::Relaxed) != ASLEEP {
        *sleeps_since = Some(Instant::now());
        thread::park_timeout(SLEEP);
    } else if seen {
        thread::park();
    } else {
        thread::park_timeout(SLEEP);
    }
}

/// Writes the records that are there now and ends the recording. Later records are ignored, because the streams may continue.
fn finish<W: Write>(
    mut writer: RecordingWriter<W>,
    queue: &Receiver<Record>,
    shared: &Shared,
) -> Result<(), WriteError> {
    for record in queue.try_iter().take(shared.capacity) {
        writer.append(&record)?;
    }
    for source in shared.sources().iter_mut() {
        source.finish(&mut |record| writer.append(record))?;
    }
    let streams = shared.streams().clone();
    for losses in streams {
        if let Some(lost) = losses.take() {
            writer.append(&Record::Gap { stream: losses.stream, lost })?;
        }
    }
    writer.append(&Record::End)?;
    writer.flush()?;
    shared.count(&writer);
    Ok(())
}

/// The sending half of the queue for one stream.
struct Outlet {
    queue: SyncSender<Record>,
    shared: Arc<Shared>,
    losses: Arc<Losses>,
}

impl Outlet {
    /// Queues a record, after a gap record if records were lost before it. Returns false if this record is lost, too.
    /// `fits` is false for a record that is too long.
    fn hand_over_if(&self, fits: bool, record: Record) -> bool {
        let taken = fits && self.announce() && self.hand_over(record);
        if !taken {
            self.losses.add();
        }
        taken
    }

    /// Queues a gap record for the lost records. Returns false if there is no room for the gap record.
    fn announce(&self) -> bool {
        let Some(lost) = self.losses.take() else { return true };
        let taken = self.hand_over(Record::Gap { stream: self.losses.stream, lost });
        if !taken {
            self.losses.unannounced.fetch_add(lost, Ordering::Relaxed);
        }
        taken
    }

    /// Queues a record if there is room, and wakes the writing thread.
    fn hand_over(&self, record: Record) -> bool {
        self.queue.try_send(record).is_ok() && self.shared.call()
    }
}

/// Records the frames of one source.
pub struct FrameStream {
    source: u16,
    outlet: Outlet,
}

impl FrameStream {
    /// Records a frame that arrived `at` microseconds after the recording began. Returns false if the frame was lost.
    pub fn frame(&mut self, at: u64, bytes: Vec<u8>) -> bool {
        let fits = bytes.len() <= LONGEST;
        self.outlet.hand_over_if(fits, Record::Frame { source: self.source, at, bytes })
    }
}
