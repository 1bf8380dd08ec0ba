//! Keys between nodes: which nodes can make a session with each other, and how a session protects its datagrams
//! (D191).
//!
//! This module has no socket and reads no clock. A `Channel` makes the sessions with one neighbour. A `Live` session
//! closes (encrypts) and opens datagrams. The handshake is Noise KKpsk0, and an exchange of a cookie comes before it:
//!
//! ```text
//! initiator                      responder
//!   hello: digests, nonce  --->    compares digests; keeps nothing
//!                          <---  cookie: a keyed hash of the nonce and of the time
//!   initiation             --->    repeated ones are recognised by cookie and nonce
//!                          <---  response: the initiator uses the session from here on
//!   a datagram             --->    the responder uses it from here on
//! ```
//!
//! Each datagram of a handshake carries a hash with the cell's key. So a datagram of a process without that key costs
//! the receiver one hash. A cookie is valid for some seconds, within one start of the responder. So a recorded
//! initiation costs one more hash, and the responder computes and keeps nothing else for it.

#[cfg(any(test, feature = "fuzzing"))]
pub mod bytes;
mod channel;
#[cfg(test)]
mod lasting;
mod live;
mod primitives;
#[cfg(any(test, feature = "fuzzing"))]
mod rig;
mod sessions;
#[cfg(test)]
mod tests;

pub(super) use channel::{Answer, Channel};
pub(super) use live::Live;

use blake2::Blake2sMac;
use blake2::digest::consts::U16;
use blake2::digest::{KeyInit, Mac};
use imrs_protocol::NodeId;
use imrs_wire::envelope::keyed::TAG_BYTES;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use zeroize::Zeroizing;

/// How many bytes each key has.
pub const KEY_BYTES: usize = 32;

/// A key that is erased from memory when it is dropped.
pub type SecretKey = Zeroizing<[u8; KEY_BYTES]>;

/// The name of the Noise protocol: handshake, cipher and hash.
const PATTERN: &str = "Noise_KKpsk0_25519_ChaChaPoly_BLAKE2s";

/// The keys of one node: its own private key, the public keys of its neighbours, and the key of the cell. Clones share
/// the keys.
#[derive(Clone)]
pub struct NodeKeys(Arc<Secrets>);

struct Secrets {
    cell: SecretKey,
    private: SecretKey,
    publics: BTreeMap<NodeId, [u8; KEY_BYTES]>,
}

impl fmt::Debug for NodeKeys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("NodeKeys").field("publics", &self.0.publics).finish_non_exhaustive()
    }
}

impl NodeKeys {
    /// Makes the keys of a node from the cell's key, the node's private key, and the public keys of other nodes.
    #[must_use]
    pub fn new(cell: SecretKey, private: SecretKey, publics: BTreeMap<NodeId, [u8; KEY_BYTES]>) -> Self {
        Self(Arc::new(Secrets { cell, private, publics }))
    }

    /// Whether these keys contain the public key of a node.
    #[must_use]
    pub fn has(&self, node: NodeId) -> bool {
        self.0.publics.contains_key(&node)
    }
}

/// The system gave no random numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the system gives no random numbers")]
pub struct NoRandom;

/// Draws a random key for a cell.
///
/// # Errors
/// [`NoRandom`].
pub fn draw_cell_key() -> Result<SecretKey, NoRandom> {
    let mut key = SecretKey::default();
    getrandom::fill(&mut *key).map_err(|_| NoRandom)?;
    Ok(key)
}

/// Draws a random private key for a node. Returns it with its public key.
///
/// # Errors
/// [`NoRandom`].
pub fn draw_node_keys() -> Result<(SecretKey, [u8; KEY_BYTES]), NoRandom> {
    let noise = primitives::builder().map_err(|_| NoRandom)?;
    let pair = noise.generate_keypair().map_err(|_| NoRandom)?;
    let drawn = Zeroizing::new(pair.private);
    let mut private = SecretKey::default();
    private.copy_from_slice(&drawn);
    Ok((private, pair.public.try_into().map_err(|_| NoRandom)?))
}

/// A keyed hash of `bytes`.
fn hash(key: &[u8; KEY_BYTES], bytes: &[&[u8]]) -> Blake2sMac<U16> {
    let mut hash = <Blake2sMac<U16> as KeyInit>::new(key.into());
    bytes.iter().for_each(|bytes| hash.update(bytes));
    hash
}

fn tag(key: &[u8; KEY_BYTES], bytes: &[&[u8]]) -> [u8; TAG_BYTES] {
    hash(key, bytes).finalize().into_bytes().into()
}

/// Whether a keyed hash is right. The comparison takes the same time for a wrong hash as for a right one.
fn is_tag(key: &[u8; KEY_BYTES], bytes: &[&[u8]], tag: &[u8; TAG_BYTES]) -> bool {
    hash(key, bytes).verify(tag.into()).is_ok()
}
