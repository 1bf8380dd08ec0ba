//! The observation protocol `imrs-obs/1`: how a running node shows itself to a monitor, a recorder or a test.
//!
//! # A connection
//!
//! 1. The monitor sends a [`Handshake::Hello`]. The node answers with its own, or with a [`Handshake::Refused`].
//!    Both begin with the magic and the version at fixed places, so that programs of different major versions can
//!    still name both versions to their users ([`DecodeError::OtherMajor`]). The minor version in use is the smaller
//!    of the two ([`agree`]).
//! 2. The node sends one [`ServerFrame::Table`]: the names that all later frames refer to by index.
//! 3. The monitor sends [`ClientFrame::Subscribe`] and, from time to time, [`ClientFrame::Credit`].
//! 4. The node sends [`ServerFrame::Snapshot`] once per period and [`ServerFrame::Events`] as they come. Each costs
//!    one credit. Without credit the node sends nothing: it lets snapshots go by and counts the events it cannot
//!    keep in [`Events::lost`], so a slow monitor costs a node a bounded amount of memory and no time.
//! 5. Either side closes. A node that stops in order says [`ServerFrame::Bye`] first.
//!
//! # What version 1.1 adds (D115)
//!
//! Instead of [`ClientFrame::Subscribe`] a monitor says [`ClientFrame::Want`]: then snapshots come as what changed
//! ([`Delta`]), of which only the first is whole; of the ports that are watched it tells what each message has been through
//! ([`Detail`]), and now and then how the process does ([`Vitals`]). [`ClientFrame::Ping`] compares the clocks.
//! [`ServerFrame::Places`] says where the other nodes are. A node that asks for a [`Token`] says nothing but its hello
//! until it has come, and [`Denied`] if it does not. Neither side says any of this to one that speaks 1.0, for whom all is
//! as it was.
//!
//! # What version 1.2 adds (D157)
//!
//! [`ServerFrame::HeldBack`] says which scripts of a restarted node are held back, and for how long. A peer that speaks 1.1 is
//! not told.
//!
//! No message can change a node: the only things a monitor can say are how much it wants to see, and how often.
//!
//! # Encoding
//!
//! A frame is its length (u32, little endian, at most [`MAX_FRAME`]) and that many bytes of postcard. postcard does
//! not describe itself, so the types of one version never change: what is added comes as a further variant of
//! [`ServerFrame`] or [`ClientFrame`] under a higher minor version, is sent only to a peer that speaks it, and reads
//! as [`DecodeError::UnknownKind`] elsewhere. The golden bytes of each version are kept in `tests/obs_golden`.

mod decode;
mod delta;
mod frames;
mod framing;
mod gathering;
mod handshake;
pub mod place;
mod snapshot;
mod told;
mod version;
mod want;

pub use decode::DecodeError;
pub(crate) use decode::whole;
pub use delta::{
    At, Changed, Delta, DeltaError, NodeFacts, PortAnew, PortChange, TaskAnew, TaskChange, TaskParts, Waiting,
};
pub use frames::{
    Bye, ClientFrame, Events, Goodbye, LinkName, NodeName, PartyName, PortName, ServerFrame, Subscribe,
    Table, TaskName, TimedEvent,
};
pub use framing::{FrameError, FrameReader, FrameWriter, MAX_FRAME, MAX_REQUEST};
pub use gathering::Gathering;
pub use handshake::{Handshake, Hello, NodeIdentity, Refusal, Role, SCHEMA, agree};
pub use snapshot::{Count, LinkView, Liveness, RealTime, Snapshot, TaskSnapshot, TimerEntry};
pub use told::{
    Denied, Detail, HeldBack, HeldTask, Lateness, MAX_WATCHED, NodePlace, Places, Pong, PortDetail,
    RecordingFacts, Vitals,
};
pub use version::{VERSION, Version};
pub use want::{EventFilter, Kinds, MAX_TOKEN, Ping, Token, TokenError, Want};
