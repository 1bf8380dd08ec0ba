//! The version number of the observation protocol.

use serde::{Deserialize, Serialize};
use std::fmt;

/// A version of the observation protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Version {
    /// Programs with different major versions do not understand each other.
    pub major: u16,
    /// A higher minor version only adds kinds of frames.
    pub minor: u16,
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.major, self.minor)
    }
}

/// The version that this library speaks.
pub const VERSION: Version = Version { major: 1, minor: 4 };
