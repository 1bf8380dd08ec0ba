//! Writing from a thread of its own, so that no disk ever holds up a node.

use super::{Header, MAX_RECORD_BYTES, Record, RecordingWriter, ScriptStep, Stream, WriteError};
use imrs_protocol::{Input, TaskId, Ticks};
use std::io::{BufWriter, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver, SyncSender};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{self, JoinHandle, Thread};
use std::time::{Duration, Instant};

/// How long the thread gathers after each batch, unless a good part of the queue fills up before. Meanwhile handing a
/// record over wakes nobody; an idle recording sleeps without end.
const GATHER: Duration = Duration::from_millis(5);
/// How many records are written before the thread looks whether it is to stop.
const BATCH: usize = 4_096;
/// What part of the queue must be full for the thread to be woken while it gathers: one in so many.
const HURRIES_AT: usize = 4;
const BUFFER_BYTES: usize = 64 * 1024;
/// The longest state or frame; what else is in its record takes less than the rest.
const LONGEST: usize = MAX_RECORD_BYTES - 64;

enum Message {
    Record(Record),
    /// Look at [`Shared::stopping`].
    Stop,
}

#[derive(Default)]
struct Shared {
    /// Of the queue.
    capacity: usize,
    /// The thread that writes.
    writer: OnceLock<Thread>,
    /// How many messages are in the queue.
    queued: AtomicUsize,
    records: AtomicU64,
    bytes: AtomicU64,
    stopping: AtomicBool,
    failure: OnceLock<WriteError>,
    streams: Mutex<Vec<Arc<Losses>>>,
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
/// Each stream hands its records over through a handle of its own ([`task`](Self::task), [`frames`](Self::frames)).
/// [`stop`](Self::stop) ends it; one that is dropped is ended too, but nobody waits for that.
pub struct Recording {
    queue: SyncSender<Message>,
    shared: Arc<Shared>,
    /// Says whether everything was written.
    thread: Option<JoinHandle<bool>>,
}

impl Recording {
    /// Begins a recording on `sink`, with room for `capacity` records between the streams and the disk. `on_failure` is
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
            let Err(error) = write(writer, &records, &for_thread) else { return true };
            on_failure(for_thread.failure.get_or_init(|| error));
            false
        };
        let thread = thread::Builder::new().name("recording".into()).spawn(run)?;
        shared.writer.get_or_init(|| thread.thread().clone());
        Ok(Self { queue, shared, thread: Some(thread) })
    }

    /// The inputs of a communication task, from the beginning of its life on. One that has run before gives a keyframe
    /// first.
    #[must_use]
    pub fn task(&self, task: TaskId) -> TaskStream {
        TaskStream { task, outlet: self.outlet(Stream::Task(task)), needs_keyframe: false }
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
        self.shared.stop(&self.queue);
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
        self.shared.stop(&self.queue);
    }
}

impl Shared {
    fn streams(&self) -> MutexGuard<'_, Vec<Arc<Losses>>> {
        self.streams.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn status(&self, ended: bool) -> Status {
        Status {
            records: self.records.load(Ordering::Relaxed),
            bytes: self.bytes.load(Ordering::Relaxed),
            lost: self.streams().iter().map(|losses| losses.total.load(Ordering::Relaxed)).sum(),
            failure: self.failure.get().map(ToString::to_string),
            ended,
        }
    }

    fn stop(&self, queue: &SyncSender<Message>) {
        self.stopping.store(true, Ordering::Release);
        // Where the queue is full the thread is awake, and looks when it has emptied it.
        let _taken = self.hand_over(queue, Message::Stop);
    }

    /// Puts a message into the queue, if there is room.
    fn hand_over(&self, queue: &SyncSender<Message>, message: Message) -> bool {
        // Counted before it can be taken out.
        let before = self.queued.fetch_add(1, Ordering::Relaxed);
        let taken = queue.try_send(message).is_ok();
        if !taken {
            self.queued.fetch_sub(1, Ordering::Relaxed);
        } else if before == self.capacity / HURRIES_AT {
            // Busy nodes fill the queue before the thread has gathered.
            self.writer.get().into_iter().for_each(Thread::unpark);
        }
        taken
    }

    fn count<W: Write>(&self, writer: &RecordingWriter<W>) {
        self.records.store(writer.records(), Ordering::Relaxed);
        self.bytes.store(writer.written(), Ordering::Relaxed);
    }

    /// Whether a good part of the queue is free, and what is put into it will be written.
    fn has_room(&self) -> bool {
        self.queued.load(Ordering::Relaxed) <= self.capacity / 2
            && self.failure.get().is_none()
            && !self.stopping.load(Ordering::Relaxed)
    }
}

/// The writing thread: until it is told to stop, or the medium fails.
fn write<W: Write>(
    mut writer: RecordingWriter<W>,
    queue: &Receiver<Message>,
    shared: &Shared,
) -> Result<(), WriteError> {
    while let Ok(first) = queue.recv() {
        let mut taken = 0;
        for message in std::iter::once(first).chain(queue.try_iter()).take(BATCH) {
            taken += 1;
            append(&mut writer, message)?;
        }
        writer.flush()?;
        // Once for all of them: the streams count in the same memory.
        shared.queued.fetch_sub(taken, Ordering::Relaxed);
        shared.count(&writer);
        if shared.stopping.load(Ordering::Acquire) {
            break;
        }
        if taken < BATCH {
            thread::park_timeout(GATHER);
        }
    }
    // What was handed over before the stop, and no more: the streams may go on.
    for message in queue.try_iter().take(shared.capacity) {
        append(&mut writer, message)?;
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

fn append<W: Write>(writer: &mut RecordingWriter<W>, message: Message) -> Result<(), WriteError> {
    match message {
        Message::Record(record) => writer.append(&record),
        Message::Stop => Ok(()),
    }
}

/// A stream's end of the queue.
struct Outlet {
    queue: SyncSender<Message>,
    shared: Arc<Shared>,
    losses: Arc<Losses>,
}

impl Outlet {
    /// Hands a record over that fits, after word of what was lost before it. False where it was lost as well.
    fn hand_over_if(&self, fits: bool, record: Record) -> bool {
        let taken = fits && self.announce() && self.shared.hand_over(&self.queue, Message::Record(record));
        if !taken {
            self.losses.add();
        }
        taken
    }

    /// Says what was lost. False where there is no room even for that.
    fn announce(&self) -> bool {
        let Some(lost) = self.losses.take() else { return true };
        let gap = Record::Gap { stream: self.losses.stream, lost };
        let taken = self.shared.hand_over(&self.queue, Message::Record(gap));
        if !taken {
            self.losses.unannounced.fetch_add(lost, Ordering::Relaxed);
        }
        taken
    }
}

/// Where the inputs of one communication task go. Used under that task's lock: nothing here blocks, allocates or
/// enters the kernel, but for waking the writing thread: once in 5 ms, or whenever a quarter of the queue has filled up.
pub struct TaskStream {
    task: TaskId,
    outlet: Outlet,
    needs_keyframe: bool,
}

impl TaskStream {
    /// The task.
    #[must_use]
    pub const fn task(&self) -> TaskId {
        self.task
    }

    /// Whether inputs were lost: until a keyframe is given nothing that is recorded of this task can be replayed.
    #[must_use]
    pub const fn needs_keyframe(&self) -> bool {
        self.needs_keyframe
    }

    /// Whether a keyframe should be given now: one is needed, and the disk keeps up again. Making one takes time and
    /// memory; while the disk does not keep up it would only be lost as well.
    #[must_use]
    pub fn wants_keyframe(&self) -> bool {
        self.needs_keyframe && self.outlet.shared.has_room()
    }

    /// Records an input that came `elapsed` after the one before; `outputs` is the digest of everything that the task
    /// had put out after it. Returns whether it was taken: where there is no room, and from then on until a keyframe, it
    /// is lost.
    pub fn input(&mut self, elapsed: Ticks, input: Input, outputs: u64) -> bool {
        // What cannot be replayed only takes room from what can.
        let fits = !self.needs_keyframe;
        let record = Record::Input { task: self.task, elapsed, input, outputs };
        let taken = self.outlet.hand_over_if(fits, record);
        self.needs_keyframe |= !taken;
        taken
    }

    /// Records what the task's script took; `done` is the digest of everything that it had done before. Returns whether
    /// it was taken, as for an input.
    pub fn script(&mut self, step: ScriptStep, done: u64) -> bool {
        let fits = !self.needs_keyframe;
        let taken = self.outlet.hand_over_if(fits, Record::Script { task: self.task, step, done });
        self.needs_keyframe |= !taken;
        taken
    }

    /// Records the task's state between two inputs, and the digest of its outputs so far. Returns whether there was
    /// room.
    pub fn keyframe(&mut self, state: Vec<u8>, outputs: u64) -> bool {
        let fits = state.len() <= LONGEST;
        let taken = self.outlet.hand_over_if(fits, Record::Keyframe { task: self.task, state, outputs });
        self.needs_keyframe = !taken;
        taken
    }

    /// Records that the task took `inputs` inputs, and that no more will come; `outputs` is the digest of everything it
    /// put out. Returns whether there was room.
    pub fn close(&mut self, inputs: u64, outputs: u64) -> bool {
        self.outlet.hand_over_if(true, Record::Close { task: self.task, inputs, outputs })
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
