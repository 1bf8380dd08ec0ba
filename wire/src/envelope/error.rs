//! Why a datagram is not taken.

use super::{MAX_PACKETS, MODE_CHECKSUM, VERSION};
use imrs_protocol::NodeId;
use thiserror::Error;

/// Why a datagram is not one for this node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum EnvelopeError {
    /// Shorter than an envelope without packets.
    #[error("{0} bytes are too short for an envelope")]
    TooShort(usize),
    /// The first bytes are not [`MAGIC`](super::MAGIC).
    #[error("not an envelope: the first bytes are others")]
    NotImrs,
    /// Made by another version of the format.
    #[error("envelope version {0}, this node speaks {VERSION}")]
    Version(u8),
    /// Closed in another way than this node is told to accept.
    #[error("envelope mode {0}, this node speaks mode {MODE_CHECKSUM}")]
    Mode(u8),
    /// Cut off, or with trailing bytes: not a whole number of packets, more than [`MAX_PACKETS`], or none where the purpose
    /// asks for one.
    #[error("{0} bytes are not an envelope of at most {MAX_PACKETS} whole packets, as many as it says")]
    Length(usize),
    /// Damaged.
    #[error("the envelope's checksum is wrong")]
    Checksum,
    /// Whole, but for nothing that this version knows.
    #[error("an envelope with purpose and flags {0:08b}, which this version does not know")]
    Purpose(u8),
    /// Of a cell with other declarations.
    #[error("from a cell whose declarations have digest {0:08x}")]
    OtherCell(u32),
    /// Of the same declarations with other statements.
    #[error("from a cell whose statements have digest {0:08x}")]
    OtherStatements(u32),
    /// For another node.
    #[error("for node {0}, which is not this one")]
    Misdelivered(NodeId),
    /// From a node that the receiver does not know.
    #[error("from node {0}, which is not a neighbour")]
    UnknownNode(NodeId),
}
