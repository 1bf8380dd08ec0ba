//! Recordings: one file format for two kinds of stream, the inputs of a node's communication tasks and the frames that
//! a monitor received.
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
//! A file that is cut off at any byte can be read up to its last whole record. [`Ending`] distinguishes such a file
//! from a recording that has an end record. The length has its own checksum, so that a damaged length is reported as
//! damage and not as the end of a cut-off file. Each stream is complete in itself, or contains a [`Record::Gap`]. So
//! readers need no order between streams.
//!
//! [`Recording`] writes from its own thread. Handing over a record never blocks and never fails for the node. A record
//! that finds no room becomes a gap. After a disk error every record becomes a gap.

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
/// The format version of this library.
pub const VERSION: u16 = 12;
/// The greatest length of a record's contents, in bytes.
pub const MAX_RECORD_BYTES: usize = 2 << 20;

const PROLOGUE_BYTES: usize = 12;
/// How many bytes stand before a record's contents: their length, and two checksums.
const RECORD_HEAD_BYTES: usize = 12;

/// The cell, node and program to which a recording belongs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// The name of the cell.
    pub cell: String,
    /// The digest of the cell's table. Inputs can be replayed only with the same table.
    pub digest: u32,
    /// The digest of the statements that the node's scripts ran; zero if there were no scripts, or if the digest is unknown.
    pub statements: u32,
    /// The node whose inputs the recording has; `None` in a recording of observations.
    pub node: Option<NodeId>,
    /// The incarnation of the node.
    pub incarnation: Incarnation,
    /// Whether an earlier incarnation of the node may have taken requests.
    pub restarted: bool,
    /// The name and version of the program that ran.
    pub build: String,
    /// Whether the links of the node ran without authentication keys. In a recording of observations: whether any node
    /// was known to run without keys when the recording began. Each snapshot has this flag for its own node.
    pub insecure: bool,
    /// When the recording began, in microseconds since 1970. For people; nothing is computed from it.
    pub began: u64,
}

/// One entry of a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Record {
    /// The header. It is the first record, and no other record is a header.
    Header(Header),
    /// An input of a communication task. The inputs before the first [`Record::Keyframe`] of a task continue from the
    /// start of the task's incarnation.
    Input {
        /// The task that took the input.
        task: TaskId,
        /// How long after the task's previous input this input came, in microseconds.
        elapsed: Ticks,
        /// The input of the task.
        input: Input,
        /// A digest of all outputs of the task, including those for this input.
        outputs: u64,
    },
    /// The state of a communication task between two of its inputs.
    Keyframe {
        /// The task whose state the keyframe holds.
        task: TaskId,
        /// The encoded state of the communication task.
        state: Vec<u8>,
        /// The digest of all outputs of the task so far.
        outputs: u64,
    },
    /// Records of a stream are missing here. The state of that stream is unknown until its next keyframe.
    Gap {
        /// The stream of records in which some are missing.
        stream: Stream,
        /// How many records are missing.
        lost: u64,
    },
    /// A frame that a monitor received, unchanged.
    Frame {
        /// The number that the recording program has given to the node.
        source: u16,
        /// The time of arrival, in microseconds since the recording began.
        at: u64,
        /// An encoded [`Shown`].
        bytes: Vec<u8>,
    },
    /// The last record of a recording that was ended. Such a recording is complete except for its gaps.
    End,
    /// An input of a task's script. Signals of the communication task are not recorded here, because they follow from
    /// its inputs. The input has the time of the task's previous record.
    Script {
        /// The task whose script took the step.
        task: TaskId,
        /// The script's step.
        step: ScriptStep,
        /// A digest of everything that the script did before this step.
        done: u64,
    },
    /// The node has stopped, and the task has no further inputs. This record shows whether records were lost right
    /// before the stop.
    Close {
        /// The task whose records end here.
        task: TaskId,
        /// How many inputs the task took since the start of its incarnation, missing ones included.
        inputs: u64,
        /// The digest of all outputs of the task.
        outputs: u64,
    },
}

/// An input of a script that does not follow from other records of the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ScriptStep {
    /// The script begins.
    Begin {
        /// The node's monotonic clock, in microseconds. Only nodes of one machine share it.
        at: u64,
    },
    /// An action of one of the script's threads ended.
    Acted {
        /// The thread of the script that acted.
        level: u8,
        /// Whether the action succeeded.
        ok: bool,
        /// The action's result.
        value: i32,
    },
    /// A nondeterministic choice was made for the script.
    Chosen(u16),
    /// The script does nothing more, because its node stops.
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
