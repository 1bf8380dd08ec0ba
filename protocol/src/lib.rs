//! The protocol of an Integrated Multi-Robot System as one pure state machine.
//!
//! Every task has a *communication task* ([`CommTask`]) that owns its *ports*. Each message carries its remaining time: the
//! most urgent message goes first, and expired messages are discarded. `waitfor` is an n-way rendezvous with confirmation.
//! Nothing here reads a clock, starts a thread, opens a socket or draws a random number: the model checker, the
//! threaded runtime and the validator of recordings are drivers of the same code.
//!
//! | §5.2 layer | here |
//! |---|---|
//! | user | `task/requests.rs` and `task/machines.rs`: requests of the task and packets for it, with the parts beside them |
//! | mapping | `mapping.rs`: from logical names to addressed packets |
//! | route | `route.rs` and `transit.rs`: the next hop of each packet, and the order in which packets leave |
//! | primitive | the driver's link |
//!
//! # The run loop
//!
//! A driver decides nothing: it brings each input with its time, carries packets, and sleeps until something is due. This
//! complete driver has two nodes and a link with a delay of two milliseconds; a tick is a microsecond.
//!
//! ```
//! use imrs_protocol::*;
//! use std::sync::Arc;
//!
//! #[derive(Default)]
//! struct Outside {
//!     sent: Vec<(NodeId, Packet)>,
//!     told: Vec<(TaskId, Signal)>,
//! }
//!
//! impl NodeOutbox for Outside {
//!     fn link(&mut self, next: NodeId, packet: Packet) {
//!         self.sent.push((next, packet));
//!     }
//!     fn signal(&mut self, task: TaskId, signal: Signal) {
//!         self.told.push((task, signal));
//!     }
//! }
//!
//! const WAY: Ticks = Ticks(2_000);
//! let mut cell = Cell::new("pair", Ticks(1_000));
//! let (left, right) = (cell.node("left"), cell.node("right"));
//! cell.link(left, right, WAY);
//! let (robot, arm) = (cell.task("robot", left), cell.task("arm", right));
//! let port = cell.port(PortDecl::new("move", robot, Usage::Send, &[arm], Ticks(50_000)).command());
//! let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
//! let node = |node| Node::new(NodeTable::new(Arc::clone(&table), node), Incarnation(0), false, 16);
//! let mut nodes = [left, right].map(|id| (id, node(id), Outside::default()));
//!
//! // The arm waits for a command, and the robot sends one.
//! let mut now = Instant::START;
//! let get = Request::Get { port: None, source: None, time_out: None };
//! let contents = Contents::new(&[7]).expect("short");
//! let send = Request::Send { port, to: Target::All, contents, time_out: None };
//! for (at, task, request) in [(1, arm, get), (0, robot, send)] {
//!     let (_, node, out) = &mut nodes[at];
//!     node.step(now, NodeInput::Request(task, request), out);
//! }
//!
//! let mut flying: Vec<(Instant, NodeId, NodeId, Packet)> = Vec::new();
//! let outcome = loop {
//!     // What was sent is in flight, and a task that got a signal goes on.
//!     for (from, node, out) in &mut nodes {
//!         for (task, signal) in std::mem::take(&mut out.told) {
//!             if let Signal::Message(message) = signal {
//!                 let reply = Request::Reply { to: message.from, contents: message.contents };
//!                 node.step(now, NodeInput::Request(task, reply), out);
//!             } else if task == robot {
//!                 out.told.push((task, signal));
//!             }
//!         }
//!         flying.extend(out.sent.drain(..).map(|(to, packet)| (now + WAY, *from, to, packet)));
//!     }
//!     if let Some((_, Signal::Outcome(outcome))) = nodes[0].2.told.first() {
//!         break *outcome;
//!     }
//!     // Sleep until a packet comes, or time alone makes a node act: here, be there.
//!     let due = nodes.iter().filter_map(|(_, node, _)| Some(node.now() + node.time_left()?));
//!     now = due.chain(flying.iter().map(|flight| flight.0)).min().expect("a command ends");
//!     for (_, node, out) in &mut nodes {
//!         node.step(now, NodeInput::Time, out);
//!     }
//!     let (arrived, rest): (Vec<_>, Vec<_>) = flying.into_iter().partition(|flight| flight.0 <= now);
//!     flying = rest;
//!     for (_, from, to, packet) in arrived {
//!         let (_, node, out) = &mut nodes[to.index()];
//!         node.step(now, NodeInput::Packet { from, packet, charge: WAY }, out);
//!     }
//! };
//! assert_eq!((outcome, now), (Outcome::Reply(contents), Instant(4_000)));
//! ```
//!
//! Comments cite the paper's sections (`§5.1.1`) and the decisions of `specs/decisions` (`D54`).
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;
#[cfg(feature = "checker")]
extern crate std;

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
// This module is public only for the measurements in `benches/`. It is not part of the API.
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
pub use node::{Fusible, Gathering, Members, Node, NodeInput, NodeOutbox, Parts, discarded};
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
pub use table::{Avoid, CellTable, NodeTable, Party, Port, TableError};
#[cfg(feature = "checker")]
pub use task::Coming;
pub use task::{CommTask, Input, Outbox, invariants};
#[cfg(feature = "checker")]
pub use ticks::symbolic;
pub use ticks::{Instant, Ticks};
pub use timer::Timer;
pub use transit::{RouteOutbox, Transit};
