//! Records into a file from a thread of its own. Each communication task puts its steps into a lane of its own, and goes on.

use super::packed::{self, Drain, Entry, Fill};
use super::{Log, OutputDigest, Recorder, Step};
use crate::lock::lock;
use crate::sync::lane::lane;
use imrs_protocol::{CommTask, Incarnation, NodeTable, TaskId};
use imrs_wire::recording::{
    Alert, Append, Header, LONGEST, Record, Recording, ScriptStep, Source, Status, Stream, WriteError,
};
use std::collections::{BTreeMap, VecDeque};
use std::io::Write;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// How many slots the lanes of all tasks of a node have together (16 MiB). A recorded step takes one slot. If a lane
/// is full, steps are lost, and the recording shows a gap. Once the disk keeps up again, the recording goes on with a
/// keyframe.
const SLOTS: usize = 1 << 18;
/// The least and the most slots of one task's lane, whatever the number of tasks: 4 KiB and 2 MiB.
const OF_A_TASK: (usize, usize) = (1 << 6, 1 << 15);

/// Records the inputs of a node's communication tasks as an [`imrs_wire::recording`].
///
/// ```
/// use imrs_protocol::{Cell, CellTable, Incarnation, NodeTable, Ticks};
/// use imrs_runtime::{Runtime, record::{About, FileRecorder}};
/// use std::{sync::Arc, time::Duration};
///
/// let mut cell = Cell::new("one", Ticks(1_000));
/// let here = cell.node("here");
/// let _sleeper = cell.task("sleeper", here);
/// let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
/// let about = About { incarnation: (Incarnation(0), false), insecure: false, build: "an example", statements: 0 };
/// // A program gives a file here.
/// let sink = std::io::sink();
/// let of_node = NodeTable::new(Arc::clone(&table), here);
/// let recorder = FileRecorder::start(sink, &of_node, &about, |error| eprintln!("{error}")).expect("a beginning");
/// let node = Runtime::builder(table, here)
///     .recorder(recorder.clone())
///     .task("sleeper", |ctx| ctx.delay(Duration::from_millis(1)).map(drop))
///     .start()
///     .expect("a node that starts");
/// assert!(node.wait(Duration::from_secs(10)));
/// node.stop(Duration::from_secs(10));
/// let status = recorder.stop(Duration::from_secs(10)).expect("the first stop");
/// assert!(status.ended && status.lost == 0 && status.records > 1, "{status:?}");
/// ```
pub struct FileRecorder {
    recording: Mutex<Option<Recording>>,
    aside: Box<[Arc<Aside>]>,
    /// The logs that have not been handed to their communication tasks yet.
    logs: Mutex<BTreeMap<TaskId, TaskLog>>,
}

/// The data of a task that do not go through its lane.
#[derive(Default)]
struct Aside {
    /// How many records were lost, and how many of them were inputs. The counters are increased in this order.
    lost: AtomicU64,
    lost_inputs: AtomicU64,
    /// The keyframes, one for each keyframe mark in the lane.
    keyframes: Mutex<VecDeque<Vec<u8>>>,
    /// Whether the node has stopped.
    closed: AtomicBool,
}

/// What a recording says about its node.
#[derive(Clone, Copy, Debug)]
pub struct About<'a> {
    /// The incarnation of the node, and whether an earlier one may have taken requests.
    pub incarnation: (Incarnation, bool),
    /// Whether the node's links run without keys.
    pub insecure: bool,
    /// The name of the program.
    pub build: &'a str,
    /// The digest of what the node's scripts do ([`statements`](super::statements)).
    pub statements: u32,
}

impl FileRecorder {
    /// Begins to record a node. If writing to `sink` fails later, the recorder calls `on_failure` once, and the node
    /// goes on without a recording.
    ///
    /// # Errors
    /// [`WriteError`] if not even the beginning of the recording can be written.
    pub fn start(
        sink: impl Write + Send + 'static,
        table: &NodeTable,
        about: &About<'_>,
        on_failure: impl FnOnce(&WriteError) + Send + 'static,
    ) -> Result<Arc<Self>, WriteError> {
        let began = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let header = Header {
            cell: table.cell().name.clone(),
            digest: table.digest(),
            statements: about.statements,
            node: Some(table.node),
            incarnation: about.incarnation.0,
            restarted: about.incarnation.1,
            build: about.build.into(),
            insecure: about.insecure,
            began: u64::try_from(began.as_micros()).unwrap_or(u64::MAX),
        };
        // The queue has one place only, because this recorder puts no frames into it.
        let recording = Recording::start(sink, &header, 1, on_failure)?;
        let tasks: Vec<TaskId> = table.tasks_on(table.node).collect();
        // The number of slots is a power of two, and at most the task's share of the slots.
        let slots = 1 << (SLOTS / tasks.len().max(1)).clamp(OF_A_TASK.0, OF_A_TASK.1).ilog2();
        let (mut aside, mut logs) = (Vec::new(), BTreeMap::new());
        for task in tasks {
            let (log, source) = ends(task, slots, recording.alert());
            aside.push(Arc::clone(&log.aside));
            recording.attach(Box::new(source));
            logs.insert(task, log);
        }
        let (recording, logs) = (Mutex::new(Some(recording)), Mutex::new(logs));
        Ok(Arc::new(Self { recording, aside: aside.into(), logs }))
    }

    /// The status of the recording; `None` once it was stopped.
    #[must_use]
    pub fn status(&self) -> Option<Status> {
        let status = lock(&self.recording).as_ref().map(Recording::status)?;
        Some(self.with_losses(status))
    }

    /// Ends the recording. The node must have stopped before. This waits for the disk, at most for `patience`. Returns
    /// `None` if the recording was stopped before.
    pub fn stop(&self, patience: Duration) -> Option<Status> {
        let recording = lock(&self.recording).take()?;
        self.aside.iter().for_each(|task| task.closed.store(true, Ordering::Release));
        let status = recording.stop(patience);
        Some(self.with_losses(status))
    }

    fn with_losses(&self, mut status: Status) -> Status {
        status.lost += self.aside.iter().map(|task| task.lost.load(Ordering::Relaxed)).sum::<u64>();
        status
    }
}

impl Recorder for FileRecorder {
    fn log(self: Arc<Self>, task: TaskId) -> Option<Box<dyn Log>> {
        let log = lock(&self.logs).remove(&task)?;
        Some(Box::new(log))
    }
}

fn ends(task: TaskId, slots: usize, alert: Alert) -> (TaskLog, TaskSource) {
    let (fill, drain) = lane(slots);
    let aside = Arc::<Aside>::default();
    let source = TaskSource {
        task,
        drain,
        aside: Arc::clone(&aside),
        inputs: 0,
        outputs: OutputDigest::START.0,
        told: 0,
    };
    (TaskLog { fill, alert, aside, needs_keyframe: false, pause: 0, told: 0 }, source)
}

/// The log of one communication task's steps. It is used under that task's lock, so recording a step does not block,
/// allocate or enter the kernel. There is one exception: it wakes the writing thread if that thread sleeps for want
/// of records, and whenever another quarter of the lane has filled up.
struct TaskLog {
    fill: Fill,
    alert: Alert,
    aside: Arc<Aside>,
    /// Whether a record was lost. Until the next keyframe, no record of this task can be replayed.
    needs_keyframe: bool,
    /// After how many more lost steps a keyframe is tried again, if the last state was too long to be recorded. This
    /// is the number of bytes of that state, so these attempts cost at most one byte for each step.
    pause: usize,
    /// How many of the lost records have been reported as gaps.
    told: u64,
}

impl TaskLog {
    /// Handles the rare cases of a step: the writing thread sleeps or has ended, or the lane had no room for the
    /// record.
    #[cold]
    fn attend(&mut self, taken: bool, inputs: u64) {
        // After a loss nothing is recorded until a keyframe: such records could not be replayed, and would only fill
        // the lane.
        if !(taken && self.alert.call()) {
            self.aside.lost.fetch_add(1, Ordering::Relaxed);
            self.aside.lost_inputs.fetch_add(inputs, Ordering::Release);
            self.needs_keyframe = true;
            self.pause = self.pause.saturating_sub(1);
        }
    }
}

impl Log for TaskLog {
    fn step(&mut self, step: &Step, digest: OutputDigest) -> bool {
        let crowded = || self.alert.hurry();
        let taken = !self.needs_keyframe && packed::step(&mut self.fill, step, digest.0, crowded);
        if !taken || self.alert.is_due() {
            self.attend(taken, 1);
            return self.wants_keyframe();
        }
        false
    }

    fn script(&mut self, step: ScriptStep, done: OutputDigest) {
        let crowded = || self.alert.hurry();
        let taken = !self.needs_keyframe && packed::script(&mut self.fill, step, done.0, crowded);
        if !taken || self.alert.is_due() {
            self.attend(taken, 0);
        }
    }

    /// Whether to make a keyframe: one is needed, and the disk keeps up again. Before that, a keyframe would be lost,
    /// too, and making it takes time and memory.
    fn wants_keyframe(&self) -> bool {
        self.needs_keyframe && self.pause == 0 && self.fill.is_half_free() && !self.alert.is_over()
    }

    /// Writes the state machine's state after a gap of lost steps. Unlike all other code on the message path it
    /// allocates, once for each gap.
    fn keyframe(&mut self, machine: &CommTask, digest: OutputDigest) {
        // If the state cannot be serialised, there is no keyframe here, and steps stay missing until the next attempt
        // succeeds.
        let Ok(state) = postcard::to_allocvec(machine) else { return };
        if state.len() > LONGEST {
            self.pause = state.len();
            return;
        }
        let lost = self.aside.lost.load(Ordering::Relaxed);
        let mut keyframes = lock(&self.aside.keyframes);
        if packed::keyframe(&mut self.fill, lost - self.told, digest.0) {
            keyframes.push_back(state);
            self.told = lost;
            self.needs_keyframe = false;
        }
    }
}

/// The source from which the writing thread takes the records of one task.
struct TaskSource {
    task: TaskId,
    drain: Drain,
    aside: Arc<Aside>,
    /// The number of recorded inputs so far, and the digest after the last of them.
    inputs: u64,
    outputs: u64,
    /// How many of the lost records have been reported as gaps.
    told: u64,
}

impl TaskSource {
    fn record(&mut self, entry: Entry) -> Option<Record> {
        let task = self.task;
        Some(match entry {
            Entry::Input { step: Step { elapsed, input }, outputs } => {
                (self.inputs, self.outputs) = (self.inputs + 1, outputs);
                Record::Input { task, elapsed, input, outputs }
            }
            Entry::Script { step, done } => Record::Script { task, step, done },
            Entry::Gap { lost } => {
                self.told += lost;
                Record::Gap { stream: Stream::Task(task), lost }
            }
            Entry::Keyframe { outputs } => {
                let state = lock(&self.aside.keyframes).pop_front()?;
                Record::Keyframe { task, state, outputs }
            }
            Entry::Unreadable => {
                self.inputs += 1;
                Record::Gap { stream: Stream::Task(task), lost: 1 }
            }
        })
    }
}

impl Source for TaskSource {
    fn fetch(&mut self, append: &mut Append<'_>) -> Result<bool, WriteError> {
        let (until, mut found) = (self.drain.filled(), false);
        while let Some(entry) = packed::take(&mut self.drain, until) {
            found = true;
            if let Some(record) = self.record(entry) {
                append(&record)?;
            }
        }
        Ok(found)
    }

    fn finish(&mut self, append: &mut Append<'_>) -> Result<(), WriteError> {
        self.fetch(append)?;
        // `lost_inputs` is read first: this acquire pairs with the release in `attend`, so that `lost` includes all
        // inputs that `lost_inputs` counts.
        let lost_inputs = self.aside.lost_inputs.load(Ordering::Acquire);
        let untold = self.aside.lost.load(Ordering::Relaxed) - self.told;
        let task = self.task;
        if untold > 0 {
            append(&Record::Gap { stream: Stream::Task(task), lost: untold })?;
        }
        if self.aside.closed.load(Ordering::Acquire) {
            append(&Record::Close { task, inputs: self.inputs + lost_inputs, outputs: self.outputs })?;
        }
        Ok(())
    }
}
