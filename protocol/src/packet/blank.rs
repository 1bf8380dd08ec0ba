//! What packets say that nobody has filled in.

use super::{Class, Contents, Kind, MAX_HOPS, Packet, Seal};
use crate::ids::{MessageId, PortId, TaskId};
use crate::ticks::Ticks;

impl Packet {
    /// A packet that says nothing.
    pub const BLANK: Self = Self {
        kind: Kind::Send,
        class: Class::Command,
        more: false,
        resent: false,
        urgent: false,
        hops: MAX_HOPS,
        fragment: 0,
        destination: TaskId(0),
        source: TaskId(0),
        port: PortId(0),
        id: MessageId::BLANK,
        remaining: Ticks::ZERO,
        contents: Contents::EMPTY,
        seal: Seal::NONE,
    };
}
