//! The first frame that each side sends.

use super::decode::{DecodeError, whole};
use super::version::{VERSION, Version};
use imrs_protocol::Incarnation;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The CRC-32 of the golden frames of [`VERSION`] and of the minor versions before it. Two builds of one version with
/// different values have different frame types, and would misread each other's frames.
pub const SCHEMA: u32 = 0x0455_08ca;

const MAGIC: [u8; 4] = *b"IMOB";
/// The length of the magic bytes and the two version numbers, which have the same meaning in every version.
const HEADER: usize = 8;

/// A node's introduction of itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeIdentity {
    /// The name of the node's cell.
    pub cell: String,
    /// The digest of its cell's table. Nodes with different digests do not communicate.
    pub digest: u32,
    /// The name of the node.
    pub node: String,
    /// The position of the node in the cell's list of nodes.
    pub id: u16,
    /// The node's incarnation.
    pub incarnation: Incarnation,
    /// Microseconds per tick of the remaining times in later frames.
    pub tick_us: u64,
}

/// The kind of program that sends the introduction.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Role {
    /// A running node.
    Node(NodeIdentity),
    /// A monitor, recorder or test.
    Monitor,
}

/// The introduction with which both sides begin.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// Identifies the frame types of this build: [`SCHEMA`].
    pub schema: u32,
    /// The id of the process that sends the introduction.
    pub pid: u32,
    /// Name and version of the program, for people.
    pub build: String,
    /// The sender's monotonic clock, in microseconds from an arbitrary start.
    pub mono_us: u64,
    /// The kind of program, with a node's identity.
    pub role: Role,
}

/// Why a node does not serve a monitor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Error)]
pub enum Refusal {
    /// The major versions differ. The refusal names both versions, so that a person can update one program.
    #[error("the node speaks imrs-obs {node}, this program {monitor}: use programs of one release")]
    OtherMajor {
        /// The node's version.
        node: Version,
        /// The monitor's version.
        monitor: Version,
    },
    /// The versions are equal, but the builds have different frame types.
    #[error(
        "the node was built from other frame types (schema {node:08x}, this program {monitor:08x}): use programs of one release"
    )]
    OtherSchema {
        /// The checksum of the node's frame types: its [`SCHEMA`].
        node: u32,
        /// The checksum of the monitor's frame types: its [`SCHEMA`].
        monitor: u32,
    },
    /// The node already serves its maximum number of monitors.
    #[error("the node serves {limit} monitors already: close one")]
    TooMany {
        /// The maximum number of monitors.
        limit: u16,
    },
    /// The first frame was the introduction of a node, not of a monitor.
    #[error("the node expected a monitor's hello")]
    NotAMonitor,
}

/// The first frame in each direction.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Handshake {
    /// The sender's introduction.
    Hello(Hello),
    /// The node refuses, and closes the connection after this.
    Refused(Refusal),
}

impl Handshake {
    /// Encodes the frame for `version` ([`VERSION`], except in tests).
    ///
    /// # Panics
    /// Never: the encoding can only run out of memory.
    #[must_use]
    pub fn encode(&self, version: Version) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(version.major.to_le_bytes());
        bytes.extend(version.minor.to_le_bytes());
        postcard::to_extend(self, bytes).expect("a Vec takes any length")
    }

    /// Decodes a handshake. Returns it with the sender's version.
    ///
    /// # Errors
    /// [`DecodeError`]. In every version, the first eight bytes alone decide about [`DecodeError::NotObs`] and
    /// [`DecodeError::OtherMajor`].
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

/// Chooses the version that a node and a monitor use with each other. Each argument is a version and its schema.
///
/// # Errors
/// The refusal that the node sends if node and monitor have no version in common.
pub fn agree(node: (Version, u32), monitor: (Version, u32)) -> Result<Version, Refusal> {
    if node.0.major != monitor.0.major {
        return Err(Refusal::OtherMajor { node: node.0, monitor: monitor.0 });
    }
    if node.0.minor == monitor.0.minor && node.1 != monitor.1 {
        return Err(Refusal::OtherSchema { node: node.1, monitor: monitor.1 });
    }
    Ok(Version { major: node.0.major, minor: node.0.minor.min(monitor.0.minor) })
}
