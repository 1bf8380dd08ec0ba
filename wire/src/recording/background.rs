//! Writing from a thread of its own, so that no disk ever holds up a node.
//!
//! Two ways lead to that thread: a queue of records, for streams of few and long ones, and [`Source`]s, which it empties
//! itself, for streams of many and short ones. Neither is ever waited for.

use super::{Header, MAX_RECORD_BYTES, Record, RecordingWriter, Stream, WriteError};
use std::io::{BufWriter, Write};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, SyncSender};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{self, JoinHandle, Thread};
use std::time::{Duration, Instant};

/// How long the thread gathers after each look that found something, unless somebody hurries it. Meanwhile handing
/// something over wakes nobody.
const GATHER: Duration = Duration::from_millis(5);
/// How long it sleeps after a look that found nothing, unless somebody wakes it. Who hands something over looks without
/// a fence whether it sleeps, so one that is about to can be missed: then this is how late it comes. Everybody sees after so
/// long that it sleeps, so from then on it sleeps until it is woken.
const SLEEP: Duration = Duration::from_millis(50);
const BUFFER_BYTES: usize = 64 * 1024;
/// The longest state or frame; what else is in its record takes less than the rest.
pub const LONGEST: usize = MAX_RECORD_BYTES - 64;

/// The thread looks again by itself, soon.
const AWAKE: u8 = 0;
/// The thread found nothing and sleeps, or is about to.
const ASLEEP: u8 = 1;
/// Nothing is written any more.
const OVER: u8 = 2;

#[derive(Default)]
struct Shared {
    /// Of the queue.
    capacity: usize,
    /// The thread that writes.
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

/// Where records are written. Once it has failed nothing more can be.
pub type Append<'a> = dyn FnMut(&Record) -> Result<(), WriteError> + 'a;

/// Something that the writing thread empties by itself, again and again.
pub trait Source: Send {
    /// Writes down what is there, and no more than was there when it began. Returns whether anything was.
    ///
    /// # Errors
    /// Those of `append`.
    fn fetch(&mut self, append: &mut Append<'_>) -> Result<bool, WriteError>;

    /// Writes down what is there for the last time, and what was lost that no gap tells of.
    ///
    /// # Errors
    /// Those of `append`.
    fn finish(&mut self, append: &mut Append<'_>) -> Result<(), WriteError>;
}

/// Who feeds a [`Source`] asks here how its writer is doing.
#[derive(Clone)]
pub struct Alert(Arc<Shared>);

impl Alert {
    /// To be asked whenever something was put into a source: whether [`call`](Self::call) has to be told of it.
    #[must_use]
    pub fn is_due(&self) -> bool {
        self.0.state.load(Ordering::Relaxed) != AWAKE
    }

    /// Wakes the writer, where it sleeps. False where nothing is written any more.
    pub fn call(&self) -> bool {
        self.0.call()
    }

    /// Ends the writer's pause: a good part of a source is full.
    pub fn hurry(&self) {
        self.0.unpark();
    }

    /// Whether nothing is written any more.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.0.state.load(Ordering::Relaxed) == OVER
    }
}

/// What a stream has lost.
struct Losses {
    stream: Stream,
    /// Since its last gap record.
    unannounced: AtomicU64,
    total: AtomicU64,
}

impl Losses {
    fn add(&self) {
        self.unannounced.fetch_add(1, Ordering::Relaxed);
        self.total.fetch_add(1, Ordering::Relaxed);
    }

    /// How many records were lost that no gap record tells of; from now on one does.
    fn take(&self) -> Option<u64> {
        let lost = self.unannounced.swap(0, Ordering::Relaxed);
        (lost > 0).then_some(lost)
    }
}

/// How a recording is doing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// Records written, the header included.
    pub records: u64,
    /// Bytes written.
    pub bytes: u64,
    /// Records lost because the queue was full or the medium had failed.
    pub lost: u64,
    /// Why nothing is written any more.
    pub failure: Option<String>,
    /// Whether the recording was ended and written to its end.
    pub ended: bool,
}

/// A recording that is being written by its own thread.
///
/// Frames are handed over through a handle for each of their sources ([`frames`](Self::frames)); the rest comes from
/// [`Source`]s.
/// [`stop`](Self::stop) ends it; one that is dropped is ended too, but nobody waits for that.
pub struct Recording {
    queue: SyncSender<Record>,
    shared: Arc<Shared>,
    /// Says whether everything was written.
    thread: Option<JoinHandle<bool>>,
}

impl Recording {
    /// Begins a recording on `sink`, with room for `capacity` frames between their streams and the disk. `on_failure` is
    /// called at most once, by the writing thread, when the medium fails: from then on nothing is written.
    ///
    /// # Errors
    /// Where not even the header can be written, or no thread can be started.
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

    /// How the writing thread is doing.
    #[must_use]
    pub fn alert(&self) -> Alert {
        Alert(Arc::clone(&self.shared))
    }

    /// From here on the writing thread empties this, too.
    pub fn attach(&self, source: Box<dyn Source>) {
        self.shared.sources().push(source);
    }

    /// The frames of one source.
    #[must_use]
    pub fn frames(&self, source: u16) -> FrameStream {
        FrameStream { source, outlet: self.outlet(Stream::Frames(source)) }
    }

    /// How the recording is doing.
    #[must_use]
    pub fn status(&self) -> Status {
        self.shared.status(false)
    }

    /// Ends the recording: writes what was handed over, the gaps, and the end. Waits for that as long as `patience`; a
    /// disk that takes longer is left behind with the thread that waits for it.
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

/// The writing thread: until it is told to stop, or the medium fails.
fn write<W: Write>(
    mut writer: RecordingWriter<W>,
    queue: &Receiver<Record>,
    shared: &Shared,
) -> Result<(), WriteError> {
    let mut sleeps_since = None;
    loop {
        // Before the last look, so that what was handed over before the stop is written.
        let stopping = shared.stopping.load(Ordering::Acquire);
        // Before the look, too: it is the last one before a sleep without end.
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

/// Until there may be something again. `seen`: when it looked, everybody saw for long that it sleeps.
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

/// What is there now, and no more: the streams may go on.
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

/// A stream's end of the queue.
struct Outlet {
    queue: SyncSender<Record>,
    shared: Arc<Shared>,
    losses: Arc<Losses>,
}

impl Outlet {
    /// Hands a record over that fits, after word of what was lost before it. False where it was lost as well.
    fn hand_over_if(&self, fits: bool, record: Record) -> bool {
        let taken = fits && self.announce() && self.hand_over(record);
        if !taken {
            self.losses.add();
        }
        taken
    }

    /// Says what was lost. False where there is no room even for that.
    fn announce(&self) -> bool {
        let Some(lost) = self.losses.take() else { return true };
        let taken = self.hand_over(Record::Gap { stream: self.losses.stream, lost });
        if !taken {
            self.losses.unannounced.fetch_add(lost, Ordering::Relaxed);
        }
        taken
    }

    /// Puts a record into the queue, if there is room.
    fn hand_over(&self, record: Record) -> bool {
        self.queue.try_send(record).is_ok() && self.shared.call()
    }
}

/// Where the frames of one source go.
pub struct FrameStream {
    source: u16,
    outlet: Outlet,
}

impl FrameStream {
    /// Records a frame that came `at` microseconds after the recording began. Returns whether there was room.
    pub fn frame(&mut self, at: u64, bytes: Vec<u8>) -> bool {
        let fits = bytes.len() <= LONGEST;
        self.outlet.hand_over_if(fits, Record::Frame { source: self.source, at, bytes })
    }
}
