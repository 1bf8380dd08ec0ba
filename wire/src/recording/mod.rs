//! Recordings (D62): one container for two kinds of stream, what went into the communication tasks of a node and what a
//! monitor saw.
//!
//! ```text
//!  0..8   magic "\x9dimrsrec"
//!  8..10  version, little endian        10..12  zero
//! then records, the first a Header:
//!  0..4   length of the contents        4..8  CRC-32/MEF over the length
//!  8..12  CRC-32/MEF over the contents
//!  12..   contents: a Record in postcard
//! ```
//!
//! A file that was cut off at any byte reads up to its last whole record; [`Ending`] tells that from a recording that
//! was ended. The length has a checksum of its own: a damaged one is damage, and not the end of a file that was cut off
//! (D95). Each stream is complete in itself, or says by a [`Record::Gap`] that it is not, so no order between streams
//! is needed.
//!
//! [`Recording`] writes from a thread of its own. Handing something over never blocks and never fails for the node: what
//! finds no room becomes a gap, and after a disk error everything does.

mod background;
mod happened;
mod reader;
mod shown;
mod writer;

pub use background::{Alert, Append, FrameStream, LONGEST, Recording, Source, Status};
pub use happened::{Happened, Happening, Turn};
pub use reader::{Cause, Ending, ReadError, RecordingReader};
pub use shown::{Doing, Place, Shown, ShownError, Step, Story};
pub use writer::{RecordingWriter, WriteError};

use imrs_protocol::{Incarnation, Input, NodeId, TaskId, Ticks};
use serde::{Deserialize, Serialize};

/// The first bytes of every recording.
pub const MAGIC: [u8; 8] = *b"\x9dimrsrec";
/// The format of this library.
pub const VERSION: u16 = 10;
/// The longest contents of a record, in bytes.
pub const MAX_RECORD_BYTES: usize = 2 << 20;

const PROLOGUE_BYTES: usize = 12;
/// Length and two checksums.
const RECORD_HEAD_BYTES: usize = 12;

/// What a recording is about.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// The name of the cell.
    pub cell: String,
    /// The digest of its table: only with this table can inputs be replayed.
    pub digest: u32,
    /// The digest of the statements that the scripts of the node ran; zero where none did, or nobody said.
    pub statements: u32,
    /// The node whose inputs these are; `None` in a recording of observations.
    pub node: Option<NodeId>,
    /// Its life.
    pub incarnation: Incarnation,
    /// Whether an earlier life of it may have taken requests.
    pub restarted: bool,
    /// The program that ran.
    pub build: String,
    /// Whether the links ran without keys.
    pub insecure: bool,
    /// When the recording began, in microseconds since 1970. For people; nothing is computed from it.
    pub began: u64,
}

/// One entry of a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Record {
    /// What the recording is about. The first record, and only that.
    Header(Header),
    /// An input of a communication task. Inputs before the task's first [`Record::Keyframe`] follow the beginning of its
    /// life.
    Input {
        /// The task.
        task: TaskId,
        /// How long after its previous input, in microseconds.
        elapsed: Ticks,
        /// What came.
        input: Input,
        /// A digest of everything it had put out after that.
        outputs: u64,
    },
    /// The state of a communication task between two inputs.
    Keyframe {
        /// The task.
        task: TaskId,
        /// Its state, as the machine stores it.
        state: Vec<u8>,
        /// The digest of its outputs at this point.
        outputs: u64,
    },
    /// Records of a stream are missing here. Until its next keyframe nothing is known of it.
    Gap {
        /// The stream.
        stream: Stream,
        /// How many records.
        lost: u64,
    },
    /// Something that a monitor received, as it came.
    Frame {
        /// From which of its nodes: a number that the recording program gives out.
        source: u16,
        /// When, in microseconds since the recording began.
        at: u64,
        /// What: a [`Shown`].
        bytes: Vec<u8>,
    },
    /// The recording was ended, and is whole but for the gaps it names. The last record.
    End,
    /// What the script of a task took, besides the signals of its communication task: those follow from its inputs. It
    /// comes at the time of the task's previous record.
    Script {
        /// The task.
        task: TaskId,
        /// What it took.
        step: ScriptStep,
        /// A digest of everything that the script had done before.
        done: u64,
    },
    /// The inputs of a task end here: its node has stopped. What was lost just before shows by this.
    Close {
        /// The task.
        task: TaskId,
        /// How many inputs it took since the beginning of its life, those that are missing included.
        inputs: u64,
        /// The digest of everything it put out.
        outputs: u64,
    },
}

/// What a script takes that follows from nothing else.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ScriptStep {
    /// It begins.
    Begin {
        /// The node's monotonic clock, in microseconds: only nodes of one machine have it in common.
        at: u64,
    },
    /// The action of one of its threads has ended.
    Acted {
        /// The thread.
        level: u8,
        /// Whether it succeeded.
        ok: bool,
        /// Its result.
        value: i32,
    },
    /// A choice was made for it.
    Chosen(u16),
    /// It acts no more: its node stops.
    Stopped,
}

/// A stream within a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Stream {
    /// The inputs of a communication task.
    Task(TaskId),
    /// The frames of a source.
    Frames(u16),
}
