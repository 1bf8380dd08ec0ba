//! The contents of a [`Record::Frame`](super::Record::Frame) in a recording of observations.
//!
//! The frames of one source are the frames of one connection (`imrs-obs`), from its hello to its end. A recording of a
//! counterexample also has a [`Story`] before everything else, and [`Step`]s. The frames between one step and the next
//! show the state after it.

use crate::obs::{DecodeError, Hello, Refusal, SCHEMA, ServerFrame, VERSION, Version, agree, whole};
use imrs_protocol::TaskId;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// An event at a monitor: a node's frame, or a part of a counterexample.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Shown {
    /// A node introduced itself.
    Attached {
        /// The version of the node's frames.
        version: Version,
        /// The node's introduction.
        hello: Hello,
    },
    /// The node sent a frame.
    Said(ServerFrame),
    /// The connection to the node was lost.
    Lost {
        /// The reason, as text for people.
        why: String,
    },
    /// The description of the counterexample. The first record after the header, if there is one.
    Story(Story),
    /// The next step of the counterexample.
    Step(Step),
}

/// The description of a counterexample, with its place in the cell's file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Story {
    /// The name of the cell's file.
    pub file: String,
    /// The kind of the finding, in one or two words.
    pub kind: String,
    /// The fault that the counterexample shows, in one line.
    pub cause: String,
    /// The place of the fault in the cell's file.
    pub place: Option<Place>,
    /// The bounds of the search, in one line.
    pub bounds: String,
    /// Microseconds per tick.
    pub tick_us: u64,
    /// The number of steps, without the initial state.
    pub steps: u32,
}

/// A place in a cell's file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// Line number, from 1.
    pub line: u32,
    /// Column, from 1.
    pub column: u32,
    /// The line's statement, or its beginning.
    pub text: String,
}

/// A step of a counterexample.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Step {
    /// Number of the step, from 1; 0 is the initial state.
    pub number: u32,
    /// Ticks since the start.
    pub tick: u64,
    /// Whether a fault occurs in the step, or the finding itself.
    pub odd: bool,
    /// Descriptions of the events of the step, in their order.
    pub happened: Vec<String>,
    /// The activity of each task after the step.
    pub tasks: Vec<Doing>,
}

/// The activity of a task.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Doing {
    /// The task whose activity this is.
    pub task: TaskId,
    /// A description of the activity in words.
    pub text: String,
    /// The line of the task's statement, from 1.
    pub line: Option<u32>,
}

/// Why a frame of a recording cannot be decoded.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ShownError {
    /// The bytes are not a frame of this version.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The recorded node used another version of the protocol.
    #[error("recorded from a node of another version: {0}")]
    Refused(Refusal),
}

impl Shown {
    /// Encodes the contents of a frame.
    ///
    /// # Panics
    /// Never: the encoding can only run out of memory.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        postcard::to_allocvec(self).expect("a Vec takes any length")
    }

    /// Decodes the contents of a frame.
    ///
    /// # Errors
    /// [`ShownError`]. The versions are compared before any field that a version might change.
    pub fn decode(bytes: &[u8]) -> Result<Self, ShownError> {
        if let Ok(((0_u32, version, schema), _)) = postcard::take_from_bytes::<(u32, Version, u32)>(bytes) {
            agree((version, schema), (VERSION, SCHEMA)).map_err(ShownError::Refused)?;
        }
        Ok(whole(bytes, 5)?)
    }
}
