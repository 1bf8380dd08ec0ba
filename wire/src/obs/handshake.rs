//! The first frame in each direction.

use super::decode::{DecodeError, whole};
use super::version::{VERSION, Version};
use imrs_protocol::Incarnation;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The CRC-32 of the golden frames of [`VERSION`] and of the minor versions before it: two builds of one version that differ in it were made from
/// different types and would misread each other.
pub const SCHEMA: u32 = 0xed49_0a48;

const MAGIC: [u8; 4] = *b"IMOB";
/// The magic, the major and the minor version: the part that no version changes.
const HEADER: usize = 8;

/// A node, as it introduces itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeIdentity {
    /// The name of its cell.
    pub cell: String,
    /// The digest of its cell's table; nodes that differ in it do not talk to each other (D48).
    pub digest: u32,
    /// Its own name.
    pub node: String,
    /// Its position in the cell's list of nodes.
    pub id: u16,
    /// Which life of the node this is (D49).
    pub incarnation: Incarnation,
    /// Microseconds in one tick of the remaining times it will report.
    pub tick_us: u64,
}

/// Who introduces itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Role {
    /// A running node.
    Node(NodeIdentity),
    /// Somebody who looks.
    Monitor,
}

/// The introduction that both sides begin with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// The types this program was built from: [`SCHEMA`].
    pub schema: u32,
    /// The process.
    pub pid: u32,
    /// Name and version of the program, for people.
    pub build: String,
    /// The sender's monotonic clock, in microseconds from an arbitrary start.
    pub mono_us: u64,
    /// Who this is.
    pub role: Role,
}

/// Why a node does not serve a monitor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Error)]
pub enum Refusal {
    /// The major versions differ; both are named so that a person can act.
    #[error("the node speaks imrs-obs {node}, this program {monitor}: use programs of one release")]
    OtherMajor {
        /// The node's version.
        node: Version,
        /// The monitor's version.
        monitor: Version,
    },
    /// Same version, but built from different types.
    #[error(
        "the node was built from other frame types (schema {node:08x}, this program {monitor:08x}): use programs of one release"
    )]
    OtherSchema {
        /// The node's schema.
        node: u32,
        /// The monitor's schema.
        monitor: u32,
    },
    /// As many monitors as it serves are connected.
    #[error("the node serves {limit} monitors already: close one")]
    TooMany {
        /// How many it serves.
        limit: u16,
    },
    /// The first frame was a node's, not a monitor's.
    #[error("the node expected a monitor's hello")]
    NotAMonitor,
}

/// The first frame in each direction.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Handshake {
    /// Go ahead.
    Hello(Hello),
    /// No. The connection is closed after this.
    Refused(Refusal),
}

impl Handshake {
    /// The frame's contents, as spoken by `version` ([`VERSION`], except in tests).
    ///
    /// # Panics
    /// Never: memory is the only thing that this encoding can run out of.
    #[must_use]
    pub fn encode(&self, version: Version) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(version.major.to_le_bytes());
        bytes.extend(version.minor.to_le_bytes());
        postcard::to_extend(self, bytes).expect("a Vec takes any length")
    }

    /// The handshake that a frame's contents are, and the version its sender speaks.
    ///
    /// # Errors
    /// [`DecodeError::NotObs`] and [`DecodeError::OtherMajor`] are decided by the first eight bytes, in every version.
    pub fn decode(bytes: &[u8]) -> Result<(Version, Self), DecodeError> {
        let (Some(header), true) = (bytes.get(..HEADER), bytes.starts_with(&MAGIC)) else {
            return Err(DecodeError::NotObs);
        };
        let theirs = Version {
            major: u16::from_le_bytes([header[4], header[5]]),
            minor: u16::from_le_bytes([header[6], header[7]]),
        };
        if theirs.major != VERSION.major {
            return Err(DecodeError::OtherMajor { theirs, ours: VERSION });
        }
        Ok((theirs, whole(&bytes[HEADER..], 2)?))
    }
}

/// The version that a node and a monitor use with each other.
///
/// # Errors
/// What the node answers where they have none in common.
pub fn agree(node: (Version, u32), monitor: (Version, u32)) -> Result<Version, Refusal> {
    if node.0.major != monitor.0.major {
        return Err(Refusal::OtherMajor { node: node.0, monitor: monitor.0 });
    }
    if node.0.minor == monitor.0.minor && node.1 != monitor.1 {
        return Err(Refusal::OtherSchema { node: node.1, monitor: monitor.1 });
    }
    Ok(Version { major: node.0.major, minor: node.0.minor.min(monitor.0.minor) })
}
