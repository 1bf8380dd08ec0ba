//! The protocol of an Integrated Multi-Robot System as one pure state machine.
//!
//! Every task has a *communication task* ([`CommTask`]) that owns its *ports*. Messages carry the time that remains to
//! them, the most urgent goes first, what expires is discarded, and `waitfor` is an n-way rendezvous with confirmation.
//! Nothing here reads a clock, starts a thread, opens a socket or draws a random number: the model checker, the
//! threaded runtime and the validator of recordings are drivers of the same code.
//!
//! | §5.2 layer | here |
//! |---|---|
//! | user | `task/requests.rs` and `task/machines.rs`: requests of the task, packets for it; and the parts beside them |
//! | mapping | `mapping.rs`: logical names to addressed packets |
//! | route | `route.rs` and `transit.rs`: where a packet goes, and which one goes next |
//! | primitive | the driver's link |
//!
//! Comments cite the paper's sections (`§5.1.1`) and the decisions of `specs/decisions` (`D54`).
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

pub mod aging;
pub mod cell;
mod ids;
mod index;
mod mapping;
pub mod margin;
mod node;
mod observe;
mod packet;
mod task;
// Measured by itself in `benches/`; no part of the interface.
#[doc(hidden)]
pub mod queue;
mod request;
pub mod route;
pub mod rules;
pub mod script;
#[cfg(feature = "checker")]
mod state;
mod table;
mod ticks;
mod timer;
mod transit;

pub use cell::{Cell, CellError, CoupleDecl, MAX_FRAGMENTS, Penalty, PortDecl, Rate, Usage};
pub use ids::{Incarnation, MessageId, NodeId, PortId, Round, Seq24, TaskId};
pub use node::{Node, NodeInput, NodeOutbox, Parts, discarded};
pub use observe::{
    Event, HeldView, MeetingState, MeetingView, MemberView, Observation, PortCounters, PortView, QueueEntry,
    QueueView, Reason, TaskState, TaskView, TransitView,
};
pub use packet::{
    CONTENTS_BYTES, Class, Contents, Control, Kind, MAX_HOPS, Meeting, PACKET_BYTES, PACKET_VERSION, Packet,
    PacketError, Seal, WIRE_STEP_US,
};
pub use request::{
    Answers, Call, Delivery, Fault, Outcome, PUBLISHED_BYTES, Ranked, ReleasedBy, ReplyTo, Request,
    ServiceOrder, Signal, Target, TimeId,
};
pub use rules::Rules;
#[cfg(feature = "checker")]
pub use state::{Decode, Encode, Frame, Overflow, Pass, Walk, mark};
pub use table::{CellTable, NodeTable, Party, Port};
#[cfg(feature = "checker")]
pub use task::Coming;
pub use task::{CommTask, Input, Outbox, invariants};
pub use ticks::{Instant, Ticks};
pub use timer::Timer;
pub use transit::{RouteOutbox, Transit};
