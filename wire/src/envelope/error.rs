//! Why a node drops a datagram.

use super::{MAX_PACKETS, MODE_CHECKSUM, VERSION};
use imrs_protocol::NodeId;
use thiserror::Error;

/// Why a node drops a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum EnvelopeError {
    /// The datagram is shorter than an envelope without packets.
    #[error("{0} bytes are too short for an envelope")]
    TooShort(usize),
    /// The first bytes are not [`MAGIC`](super::MAGIC).
    #[error("not an envelope: the first bytes are others")]
    NotImrs,
    /// Another version of the envelope format made the datagram.
    #[error("envelope version {0}, this node speaks {VERSION}")]
    Version(u8),
    /// The datagram's mode is not one that this node accepts.
    #[error("envelope mode {0}, this node speaks mode {MODE_CHECKSUM}")]
    Mode(u8),
    /// The datagram's length is wrong: not a whole number of packets, more than [`MAX_PACKETS`], another number than the
    /// header says, or no packet where the purpose needs one.
    #[error("{0} bytes are not an envelope of at most {MAX_PACKETS} whole packets, as many as it says")]
    Length(usize),
    /// The checksum does not match: the datagram is damaged.
    #[error("the envelope's checksum is wrong")]
    Checksum,
    /// The datagram is intact, but this version does not know its purpose.
    #[error("an envelope with purpose and flags {0:08b}, which this version does not know")]
    Purpose(u8),
    /// The datagram is from a cell with other declarations.
    #[error("from a cell whose declarations have digest {0:08x}")]
    OtherCell(u32),
    /// The datagram is from a cell with the same declarations and other statements.
    #[error("from a cell whose statements have digest {0:08x}")]
    OtherStatements(u32),
    /// The datagram is for another node.
    #[error("for node {0}, which is not this one")]
    Misdelivered(NodeId),
    /// The datagram is from a node that is no neighbour of the receiver.
    #[error("from node {0}, which is not a neighbour")]
    UnknownNode(NodeId),
}
