//! The layout of mode 1: datagrams that are encrypted and authenticated with keys (D191). This file defines only the
//! layout, without any cryptography.
//!
//! ```text
//!  0..2   magic 9d 4d
//!  2      version of the envelope
//!  3      mode: 1
//! 15      what follows: 0 transport, 1 hello, 2 cookie, 3 initiation, 4 response, 5 refusal
//!
//!         transport, little endian:
//!  4..8   the receiver's index of the session
//!  8..15  counter: the nonce
//! 16..    encrypted: 20 bytes (below), 0 to 44 packets of 32 bytes, and a tag of 16 bytes
//!
//!         encrypted head:
//!  0      purpose and flags, as in mode 0
//!  1      packets, 0 to 44
//!  2      incarnation of the sender
//!  3      of a greeting: the incarnation of the receiver that the sender remembers; of a refusal: its reason
//!  4..12  tx_mono
//! 12..20  echo
//!
//!         all others, which make a session:
//!  4..6   sender node
//!  6..8   receiver node
//!  8..15  zero
//! 16..32  nonce of the initiator
//! 32..    hello: digest of declarations 4, of statements 4
//!         cookie: cookie 16
//!         initiation: cookie 16, the initiator's index 4, Noise message 56
//!         response: the initiator's index 4, the responder's index 4, Noise message 56
//!         refusal: digest of declarations 4, of statements 4, reason 1
//! last 16 keyed hash over everything before it
//! ```
//!
//! A transport datagram does not carry sender, receiver, sessions and digests, because the session stands for them. The
//! bytes in clear need no associated data: the index chooses the key, the counter is the nonce, and each other byte has
//! only one possible value. So a changed byte makes the decryption fail.

use super::header::{flags_of, purpose_of};
use super::{
    COUNTER_END, Digests, Echo, Envelope, EnvelopeError, MAGIC, MAX_PACKETS, MODE_KEYS, Opened, Purpose,
    Session, VERSION,
};
use imrs_protocol::{Incarnation, NodeId, PACKET_BYTES};

/// The number of bytes of a datagram that are in clear.
pub const CLEAR_BYTES: usize = 16;
/// The length of a tag or of a keyed hash, in bytes.
pub const TAG_BYTES: usize = 16;
/// The length of a nonce or of a cookie, in bytes.
pub const NONCE_BYTES: usize = 16;
/// The length of a Noise message of a handshake, in bytes: an ephemeral key, 8 bytes for the other side, a tag.
pub const NOISE_BYTES: usize = 32 + 8 + TAG_BYTES;
/// The length of the longest datagram of mode 1, in bytes.
pub const MAX_KEYED_BYTES: usize = CLEAR_BYTES + INNER_BYTES + MAX_PACKETS * PACKET_BYTES + TAG_BYTES;
/// The length of the longest datagram that makes a session, in bytes.
pub const MAX_HANDSHAKE_BYTES: usize = BODY_AT + NONCE_BYTES + 4 + NOISE_BYTES + TAG_BYTES;
/// The number of bytes before the packets within the encrypted part.
pub(super) const INNER_BYTES: usize = 20;

const KIND_AT: usize = 15;
const BODY_AT: usize = CLEAR_BYTES + NONCE_BYTES;

/// The clear part of a datagram of mode 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keyed<'a> {
    /// A datagram of a session.
    Transport {
        /// The receiver's index of the session.
        index: u32,
        /// The counter, which is the nonce.
        counter: u64,
        /// The encrypted part, with its tag.
        closed: &'a [u8],
    },
    /// A datagram that makes a session.
    Handshake(Handshake<'a>),
}

/// A datagram of the handshake that makes a session, or that refuses one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Handshake<'a> {
    /// The node that sent the datagram.
    pub sender: NodeId,
    /// The node for which the datagram is.
    pub receiver: NodeId,
    /// The number that the initiator has drawn for this attempt. All datagrams of the attempt have it.
    pub nonce: [u8; NONCE_BYTES],
    /// The content of the datagram.
    pub step: Step<'a>,
}

/// The content of a datagram of a handshake, by its place in the exchange.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step<'a> {
    /// The sender wants a session.
    Hello(Digests),
    /// The sender's cookie. The receiver must repeat it in its initiation.
    Cookie([u8; NONCE_BYTES]),
    /// The first Noise message.
    Initiation {
        /// The cookie that the receiver of this datagram has given.
        cookie: [u8; NONCE_BYTES],
        /// The sender's index of the session.
        index: u32,
        /// The Noise message.
        noise: &'a [u8; NOISE_BYTES],
    },
    /// The second Noise message: with it, both nodes have the keys of the session.
    Response {
        /// The receiver's index of the session.
        initiator: u32,
        /// The sender's index of the session.
        responder: u32,
        /// The Noise message.
        noise: &'a [u8; NOISE_BYTES],
    },
    /// The sender refuses to make a session with the receiver.
    Refusal {
        /// The sender's digests.
        digests: Digests,
        /// The position of the reason in [`Refused`](super::Refused).
        reason: u8,
    },
}

/// Decodes the clear part of a datagram of mode 1. Whether the datagram is authentic is not checked here.
///
/// # Errors
/// Says why the bytes are no such datagram. Never panics, whatever the bytes are.
pub fn read(bytes: &[u8]) -> Result<Keyed<'_>, EnvelopeError> {
    let too_short = EnvelopeError::TooShort(bytes.len());
    let length = EnvelopeError::Length(bytes.len());
    let (head, body) = bytes.split_first_chunk::<CLEAR_BYTES>().ok_or(too_short)?;
    if head[..2] != MAGIC {
        return Err(EnvelopeError::NotImrs);
    }
    if head[2] != VERSION {
        return Err(EnvelopeError::Version(head[2]));
    }
    if head[3] != MODE_KEYS {
        return Err(EnvelopeError::Mode(head[3]));
    }
    if head[KIND_AT] == 0 {
        let packets = body.len().checked_sub(INNER_BYTES + TAG_BYTES).ok_or(too_short)?;
        if packets % PACKET_BYTES != 0 || bytes.len() > MAX_KEYED_BYTES {
            return Err(length);
        }
        return Ok(Keyed::Transport { index: four(head, 4), counter: eight(head, 8), closed: body });
    }
    if head[8..KIND_AT].iter().any(|&byte| byte != 0) {
        return Err(EnvelopeError::Purpose(head[KIND_AT]));
    }
    let (&nonce, rest) = body.split_first_chunk::<NONCE_BYTES>().ok_or(too_short)?;
    let (rest, _) = rest.split_last_chunk::<TAG_BYTES>().ok_or(too_short)?;
    let step = Step::parse(head[KIND_AT], rest, length)?;
    let node = |at: usize| NodeId(u16::from_le_bytes([head[at], head[at + 1]]));
    Ok(Keyed::Handshake(Handshake { sender: node(4), receiver: node(6), nonce, step }))
}

impl<'a> Step<'a> {
    fn parse(kind: u8, rest: &'a [u8], length: EnvelopeError) -> Result<Self, EnvelopeError> {
        let digests = |of: &[u8]| Digests { cell: four(of, 0), statements: four(of, 4) };
        match (kind, rest.len()) {
            (1, 8) => Ok(Self::Hello(digests(rest))),
            (2, NONCE_BYTES) => Ok(Self::Cookie(*rest.first_chunk().ok_or(length)?)),
            (3, _) => {
                let (&cookie, rest) = rest.split_first_chunk().ok_or(length)?;
                let (index, rest) = rest.split_first_chunk::<4>().ok_or(length)?;
                let noise = rest.try_into().map_err(|_| length)?;
                Ok(Self::Initiation { cookie, index: u32::from_le_bytes(*index), noise })
            }
            (4, _) => {
                let (indices, rest) = rest.split_first_chunk::<8>().ok_or(length)?;
                let noise = rest.try_into().map_err(|_| length)?;
                Ok(Self::Response { initiator: four(indices, 0), responder: four(indices, 4), noise })
            }
            (5, 9) => Ok(Self::Refusal { digests: digests(rest), reason: rest[8] }),
            (1 | 2 | 5, _) => Err(length),
            (kind, _) => Err(EnvelopeError::Purpose(kind)),
        }
    }

    /// Writes the bytes of this step. Returns the step's number and its length.
    fn emit(&self, to: &mut [u8]) -> (u8, usize) {
        let mut end = 0;
        let mut put = |bytes: &[u8]| {
            to[end..end + bytes.len()].copy_from_slice(bytes);
            end += bytes.len();
        };
        let mut put_digests = |digests: &Digests| {
            put(&digests.cell.to_le_bytes());
            put(&digests.statements.to_le_bytes());
        };
        let kind = match self {
            Self::Hello(digests) => {
                put_digests(digests);
                1
            }
            Self::Cookie(cookie) => {
                put(cookie);
                2
            }
            Self::Initiation { cookie, index, noise } => {
                put(cookie);
                put(&index.to_le_bytes());
                put(*noise);
                3
            }
            Self::Response { initiator, responder, noise } => {
                put(&initiator.to_le_bytes());
                put(&responder.to_le_bytes());
                put(*noise);
                4
            }
            Self::Refusal { digests, reason } => {
                put_digests(digests);
                put(&[*reason]);
                5
            }
        };
        (kind, end)
    }
}

/// The bytes of a datagram that makes a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HandshakeBytes {
    bytes: [u8; MAX_HANDSHAKE_BYTES],
    length: usize,
}

impl HandshakeBytes {
    /// Encodes a datagram of a handshake. `hash` computes the keyed hash of the bytes before it.
    pub fn new(of: &Handshake<'_>, hash: impl FnOnce(&[u8]) -> [u8; TAG_BYTES]) -> Self {
        let mut bytes = [0; MAX_HANDSHAKE_BYTES];
        bytes[..2].copy_from_slice(&MAGIC);
        (bytes[2], bytes[3]) = (VERSION, MODE_KEYS);
        bytes[4..6].copy_from_slice(&of.sender.0.to_le_bytes());
        bytes[6..8].copy_from_slice(&of.receiver.0.to_le_bytes());
        bytes[CLEAR_BYTES..BODY_AT].copy_from_slice(&of.nonce);
        let (kind, length) = of.step.emit(&mut bytes[BODY_AT..]);
        bytes[KIND_AT] = kind;
        let end = BODY_AT + length;
        let hash = hash(&bytes[..end]);
        bytes[end..end + TAG_BYTES].copy_from_slice(&hash);
        Self { bytes, length: end + TAG_BYTES }
    }
}

impl std::ops::Deref for HandshakeBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

/// The clear part of a transport datagram.
pub(super) fn clear(index: u32, counter: u64) -> [u8; CLEAR_BYTES] {
    let mut head = [0; CLEAR_BYTES];
    head[..2].copy_from_slice(&MAGIC);
    (head[2], head[3]) = (VERSION, MODE_KEYS);
    head[4..8].copy_from_slice(&index.to_le_bytes());
    head[8..].copy_from_slice(&(counter % COUNTER_END).to_le_bytes());
    head
}

/// The first bytes of the encrypted part of a transport datagram.
pub(super) fn inner(envelope: &Envelope, count: u8) -> [u8; INNER_BYTES] {
    let mut head = [0; INNER_BYTES];
    let (flags, extra) = flags_of(envelope);
    head[..4].copy_from_slice(&[flags, count, envelope.incarnation.0, extra]);
    head[4..12].copy_from_slice(&envelope.tx_mono.to_le_bytes());
    head[12..].copy_from_slice(&envelope.echo.map_or(0, |echo| echo.mono).to_le_bytes());
    head
}

/// The fields that are the same in all datagrams of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bound {
    /// The digests that both nodes have in common.
    pub digests: Digests,
    /// The sender, and the number that it drew when it opened its socket.
    pub sender: (NodeId, Session),
    /// The receiver, and the number that it drew when it opened its socket.
    pub receiver: (NodeId, Session),
}

/// Decodes the bytes that a session has decrypted.
///
/// # Errors
/// Says why the bytes are not the content of a datagram. Never panics, whatever the bytes are.
pub fn open<'a>(plain: &'a [u8], counter: u64, bound: &Bound) -> Result<Opened<'a>, EnvelopeError> {
    let length = EnvelopeError::Length(plain.len());
    let (head, body) = plain.split_first_chunk::<INNER_BYTES>().ok_or(length)?;
    let (packets, ragged) = body.as_chunks::<PACKET_BYTES>();
    if !ragged.is_empty() || packets.len() > MAX_PACKETS || usize::from(head[1]) != packets.len() {
        return Err(length);
    }
    let (purpose, restarted, has_echo) = purpose_of(head[0], head[3])?;
    if packets.is_empty() == (purpose == Purpose::Packets) {
        return Err(length);
    }
    let envelope = Envelope {
        sender: bound.sender.0,
        receiver: bound.receiver.0,
        incarnation: Incarnation(head[2]),
        restarted,
        session: bound.sender.1,
        counter,
        tx_mono: eight(head, 4),
        echo: has_echo.then_some(Echo { session: bound.receiver.1, mono: eight(head, 12) }),
        purpose,
    };
    Ok(Opened { digests: bound.digests, envelope, packets })
}

fn four(of: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([of[at], of[at + 1], of[at + 2], of[at + 3]])
}

fn eight(of: &[u8], at: usize) -> u64 {
    u64::from(four(of, at)) | u64::from(four(of, at + 4)) << 32
}
