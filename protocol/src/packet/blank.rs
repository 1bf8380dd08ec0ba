//! The blank packet, from which others are built.

use super::{Class, Contents, Kind, MAX_HOPS, Packet, Seal};
use crate::ids::{MessageId, PortId, TaskId};
use crate::ticks::Ticks;

impl Packet {
    /// A packet whose fields all have their default values.
    pub const BLANK: Self = Self {
        kind: Kind::Send,
        class: Class::Command,
        more: false,
        resent: false,
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
