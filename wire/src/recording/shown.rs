//! What a recording of observations holds: the contents of each [`Record::Frame`](super::Record::Frame).
//!
//! The frames of one source are those of a connection (`imrs-obs`), from its introduction to its end. A recording of a
//! counterexample has besides a [`Story`] before everything else, and a [`Step`] before the frames that show what came
//! of it: all that comes before the next one belongs to it.

use crate::obs::{DecodeError, Hello, Refusal, SCHEMA, ServerFrame, VERSION, Version, agree, whole};
use imrs_protocol::TaskId;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Something that a monitor was shown.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Shown {
    /// A node introduced itself.
    Attached {
        /// The version that its frames are of.
        version: Version,
        /// What it said.
        hello: Hello,
    },
    /// It said something.
    Said(ServerFrame),
    /// It is no longer attached.
    Lost {
        /// Why, for people.
        why: String,
    },
    /// What the recording tells. The first record after the header, if any.
    Story(Story),
    /// What happened next.
    Step(Step),
}

/// What a counterexample shows, and where it stands in the cell's file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Story {
    /// The cell's file.
    pub file: String,
    /// The kind of finding, in one or two words.
    pub kind: String,
    /// What is wrong, in one line.
    pub cause: String,
    /// Where.
    pub place: Option<Place>,
    /// What was searched, in one line.
    pub bounds: String,
    /// Microseconds in one tick.
    pub tick_us: u64,
    /// How many steps there are, the state before the first not counted.
    pub steps: u32,
}

/// A place in a cell's file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// From 1.
    pub line: u32,
    /// From 1.
    pub column: u32,
    /// The line's statement, or its beginning.
    pub text: String,
}

/// A step of a counterexample.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Step {
    /// From 1; 0 is the state before the first.
    pub number: u32,
    /// Ticks since the start.
    pub tick: u64,
    /// Whether something goes wrong in it: a fault, or what was found.
    pub odd: bool,
    /// What happened, in words, in its order.
    pub happened: Vec<String>,
    /// What each task does after it.
    pub tasks: Vec<Doing>,
}

/// What a task does.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Doing {
    /// The task.
    pub task: TaskId,
    /// In words.
    pub text: String,
    /// The line of its statement, from 1.
    pub line: Option<u32>,
}

/// Why a frame of a recording cannot be shown.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ShownError {
    /// It is none of this version.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The recorded node spoke another version of the protocol.
    #[error("recorded from a node of another version: {0}")]
    Refused(Refusal),
}

impl Shown {
    /// The contents of a frame.
    ///
    /// # Panics
    /// Never: memory is the only thing that this encoding can run out of.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        postcard::to_allocvec(self).expect("a Vec takes any length")
    }

    /// What the contents of a frame show.
    ///
    /// # Errors
    /// [`ShownError`]. Whether the versions fit is decided before anything that a version might change.
    pub fn decode(bytes: &[u8]) -> Result<Self, ShownError> {
        if let Ok(((0_u32, version, schema), _)) = postcard::take_from_bytes::<(u32, Version, u32)>(bytes) {
            agree((version, schema), (VERSION, SCHEMA)).map_err(ShownError::Refused)?;
        }
        Ok(whole(bytes, 5)?)
    }
}
