//! The observation protocol `imrs-obs/1`: a running node shows its state to a monitor, a recorder or a test.
//!
//! # A connection
//!
//! 1. The monitor sends a [`Handshake::Hello`]. The node answers with a hello of its own, or with a
//!    [`Handshake::Refused`]. Each of these frames begins with the magic bytes and the version at fixed offsets. So
//!    programs of different major versions can still name both versions to their users ([`DecodeError::OtherMajor`]).
//!    Both sides use the smaller of the two minor versions ([`agree`]).
//! 2. The node sends one [`ServerFrame::Table`]: the names that all later frames refer to by index.
//! 3. The monitor sends [`ClientFrame::Subscribe`] and, from time to time, [`ClientFrame::Credit`].
//! 4. The node sends a [`ServerFrame::Snapshot`] once per period, and [`ServerFrame::Events`] as they occur. Each of
//!    these frames costs one credit. Without credit the node sends nothing: it skips snapshots, and counts the events
//!    that it cannot keep in [`Events::lost`]. So a slow monitor costs a node a bounded amount of memory and no time.
//! 5. Either side closes the connection. A node that stops in order sends a [`ServerFrame::Bye`] first.
//!
//! # What version 1.1 adds
//!
//! A monitor sends [`ClientFrame::Want`] instead of [`ClientFrame::Subscribe`]. Then only the first snapshot is whole,
//! and later ones are sent as a [`Delta`]. For watched ports the node sends what each queued message has been through
//! ([`Detail`]). From time to time it sends metrics of its process ([`Vitals`]). [`ClientFrame::Ping`] compares the
//! clocks. [`ServerFrame::Places`] has the addresses of the other nodes. Neither side sends any of these
//! frames to a peer that speaks 1.0.
//!
//! # What version 1.2 adds
//!
//! [`ServerFrame::HeldBack`] lists the scripts of a restarted node that are held back, and for how long. A peer that
//! speaks 1.1 does not receive it.
//!
//! # What version 1.3 adds
//!
//! A node with a [`Token`] sends nothing but its hello and a [`ServerFrame::Challenge`] until the monitor has answered
//! the challenge with a [`ClientFrame::Proof`]; otherwise the node sends [`Denied`]. Until version 1.2 the monitor sent
//! the token itself. A node with a token refuses such a monitor, and a monitor sends no token to such a node.
//!
//! # What version 1.4 adds
//!
//! [`ServerFrame::Links`] says how long datagrams took on each link, and how many were damaged.
//!
//! No frame can change a node: a monitor can only say how much it wants to see, and how often.
//!
//! # Encoding
//!
//! A frame is a length (u32, little endian, at most [`MAX_FRAME`]) and that many bytes of postcard. postcard is not
//! self-describing, so the types of one version never change. An addition is a new variant of [`ServerFrame`] or
//! [`ClientFrame`] under a higher minor version. The new variant is sent only to a peer that speaks that version; other
//! peers decode it as [`DecodeError::UnknownKind`]. `tests/obs_golden` keeps the golden bytes of each version.

mod decode;
mod delta;
mod frames;
mod framing;
mod gathering;
mod handshake;
mod links;
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
pub use links::{Delays, Integrity, LinkReport, LinkReports, LinkSummary, Margin};
pub use snapshot::{Count, LinkView, Liveness, RealTime, Snapshot, TaskSnapshot, TimerEntry};
pub use told::{
    Denied, Detail, HeldBack, HeldTask, Lateness, MAX_WATCHED, NodePlace, Places, Pong, PortDetail,
    RecordingFacts, Vitals,
};
pub use version::{VERSION, Version};
pub use want::{Challenge, EventFilter, Kinds, MAX_TOKEN, Ping, Proof, Token, TokenError, Want};
