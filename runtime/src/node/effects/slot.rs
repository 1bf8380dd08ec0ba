//! An input for a communication task in the words of a slot of its inbox (D201).
//!
//! ```text
//!  0    what 8 | kind 8 | class 1, more 1, re-sent 1, zero 5 | hops 8 | fragment 8 | length 8 | incarnation 8 | zero 8
//!  1    destination 16 | source 16 | port 16 | member 16      (low bits first)
//!  2    when it happened
//!  3    remaining time
//!  4    contents, first 8 bytes
//!  5    contents, last 4 bytes | sequence 32
//! ```
//!
//! An input that is not a packet uses the same words for its own fields. The checksum that a packet had on a link is
//! not stored: only relays need it, and the recordings of a communication task leave it out, too.

use super::{Addressed, Stamped};
use crate::sync::AtomicU64;
use crate::sync::inbox::Slotted;
use imrs_protocol::{
    CONTENTS_BYTES, Class, Contents, Incarnation, Input, Kind, MessageId, NodeId, Packet, PortId, Seal,
    Seq24, TaskId, Ticks, TimeId,
};

/// How many words an input has. Together with its number, an input fills a cache line except for one word.
const WORDS: usize = 6;

const TIME: u8 = 0;
const PACKET: u8 = 1;
const TIME_OUT: u8 = 2;
const UNSENT: u8 = 3;
const RESTARTED: u8 = 4;
const STOPPED: u8 = 5;

/// The bits of a packet's flags.
const COMMAND: u8 = 1;
const MORE: u8 = 2;
const RESENT: u8 = 4;

impl Slotted for Addressed {
    type Words = [u64; WORDS];
    type Atomics = [AtomicU64; WORDS];

    fn atomics() -> Self::Atomics {
        std::array::from_fn(|_| AtomicU64::new(0))
    }

    /// `None` for a request: the task's own thread takes the lock to make its request, so it never leaves a request
    /// in an inbox.
    fn to_words(&self) -> Option<[u64; WORDS]> {
        let at = self.stamped.at;
        // A node has at most 65,536 tasks.
        let member = (self.member as u64) << 48;
        Some(match &self.stamped.input {
            Input::Request(_) => return None,
            Input::Time => [bytes([TIME, 0, 0, 0, 0, 0, 0, 0]), member, at, 0, 0, 0],
            Input::Packet(packet) => words_of(packet, member, at),
            &Input::TimeOut { id: TimeId(id), turn } => {
                [bytes([TIME_OUT, id, turn, 0, 0, 0, 0, 0]), member, at, 0, 0, 0]
            }
            Input::Unsent(id) => {
                let first = bytes([UNSENT, 0, 0, 0, 0, 0, id.incarnation.0, 0]);
                [first, member, at, 0, 0, u64::from(id.sequence.get()) << 32]
            }
            &Input::PeerRestarted(NodeId(node)) => {
                [bytes([RESTARTED, 0, 0, 0, 0, 0, 0, 0]), member | u64::from(node), at, 0, 0, 0]
            }
            &Input::PeerStopped(NodeId(node)) => {
                [bytes([STOPPED, 0, 0, 0, 0, 0, 0, 0]), member | u64::from(node), at, 0, 0, 0]
            }
        })
    }

    fn of_words(words: &[u64; WORDS]) -> Self {
        let [what, a, b, ..] = words[0].to_le_bytes();
        let input = match what {
            PACKET => Input::Packet(packet_of(words)),
            TIME_OUT => Input::TimeOut { id: TimeId(a), turn: b },
            UNSENT => Input::Unsent(id_of(words)),
            RESTARTED => Input::PeerRestarted(NodeId(half(words[1], 0))),
            STOPPED => Input::PeerStopped(NodeId(half(words[1], 0))),
            _time => Input::Time,
        };
        Self { member: half(words[1], 3).into(), stamped: Stamped { at: words[2], input } }
    }
}

fn words_of(packet: &Packet, member: u64, at: u64) -> [u64; WORDS] {
    let flag = |is: bool, bit: u8| if is { bit } else { 0 };
    let flags =
        flag(packet.class == Class::Command, COMMAND) | flag(packet.more, MORE) | flag(packet.resent, RESENT);
    let length = packet.contents.as_bytes().len() as u8;
    let first =
        [PACKET, packet.kind as u8, flags, packet.hops, packet.fragment, length, packet.id.incarnation.0, 0];
    let [low, middle, high] = [0, 4, 8].map(|from| quarter(packet.contents.padded(), from));
    [
        bytes(first),
        u64::from(packet.destination.0)
            | (u64::from(packet.source.0) << 16)
            | (u64::from(packet.port.0) << 32)
            | member,
        at,
        packet.remaining.0,
        low | (middle << 32),
        high | (u64::from(packet.id.sequence.get()) << 32),
    ]
}

fn packet_of(words: &[u64; WORDS]) -> Packet {
    let [_, kind, flags, hops, fragment, length, _, _] = words[0].to_le_bytes();
    let [a, b, c, d, ..] = words[5].to_le_bytes();
    let mut padded = [0; CONTENTS_BYTES];
    padded[..8].copy_from_slice(&words[4].to_le_bytes());
    padded[8..].copy_from_slice(&[a, b, c, d]);
    Packet {
        kind: Kind::ALL[usize::from(kind)],
        class: if flags & COMMAND != 0 { Class::Command } else { Class::Status },
        more: flags & MORE != 0,
        resent: flags & RESENT != 0,
        hops,
        fragment,
        destination: TaskId(half(words[1], 0)),
        source: TaskId(half(words[1], 1)),
        port: PortId(half(words[1], 2)),
        id: id_of(words),
        remaining: Ticks(words[3]),
        contents: Contents::of_padded(padded, length),
        seal: Seal::NONE,
    }
}

fn id_of(words: &[u64; WORDS]) -> MessageId {
    let [.., incarnation, _] = words[0].to_le_bytes();
    let [.., a, b, c, d] = words[5].to_le_bytes();
    MessageId {
        incarnation: Incarnation(incarnation),
        sequence: Seq24::new(u32::from_le_bytes([a, b, c, d])),
    }
}

const fn bytes(bytes: [u8; 8]) -> u64 {
    u64::from_le_bytes(bytes)
}

/// The 16 bits of `word` that begin at the byte `at`.
const fn half(word: u64, at: usize) -> u16 {
    let bytes = word.to_le_bytes();
    u16::from_le_bytes([bytes[2 * at], bytes[2 * at + 1]])
}

/// Four bytes of contents.
fn quarter(padded: &[u8; CONTENTS_BYTES], from: usize) -> u64 {
    u64::from(u32::from_le_bytes([padded[from], padded[from + 1], padded[from + 2], padded[from + 3]]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::Request;
    use proptest::prelude::*;

    fn packets() -> impl Strategy<Value = Packet> {
        let flags = (0..8_usize, any::<[bool; 3]>(), 0..=7_u8, 0..=15_u8);
        let ends = (any::<[u16; 3]>(), any::<u8>(), 0..Seq24::MODULUS);
        let rest = (any::<u64>(), prop::collection::vec(any::<u8>(), 0..=CONTENTS_BYTES));
        (flags, ends, rest).prop_map(|(flags, ends, (remaining, contents))| {
            let ((kind, [command, more, resent], hops, fragment), ([to, from, port], incarnation, sequence)) =
                (flags, ends);
            Packet {
                kind: Kind::ALL[kind],
                class: if command { Class::Command } else { Class::Status },
                more,
                resent,
                hops,
                fragment,
                destination: TaskId(to),
                source: TaskId(from),
                port: PortId(port),
                id: MessageId { incarnation: Incarnation(incarnation), sequence: Seq24::new(sequence) },
                remaining: Ticks(remaining),
                contents: Contents::new(&contents).expect("short"),
                seal: Seal::NONE,
            }
        })
    }

    fn inputs() -> impl Strategy<Value = Input> {
        let id = (any::<u8>(), 0..Seq24::MODULUS).prop_map(|(incarnation, sequence)| MessageId {
            incarnation: Incarnation(incarnation),
            sequence: Seq24::new(sequence),
        });
        prop_oneof![
            Just(Input::Time),
            packets().prop_map(Input::Packet),
            any::<[u8; 2]>().prop_map(|[id, turn]| Input::TimeOut { id: TimeId(id), turn }),
            id.prop_map(Input::Unsent),
            any::<u16>().prop_map(|node| Input::PeerRestarted(NodeId(node))),
            any::<u16>().prop_map(|node| Input::PeerStopped(NodeId(node))),
        ]
    }

    proptest! {
        #[test]
        fn an_input_comes_out_of_its_words_as_it_went_in(
            input in inputs(),
            at in any::<u64>(),
            member in any::<u16>(),
        ) {
            let addressed = Addressed { member: member.into(), stamped: Stamped { at, input } };
            let out = Addressed::of_words(&addressed.to_words().expect("not a request"));
            prop_assert_eq!((out.member, out.stamped.at), (addressed.member, at));
            prop_assert_eq!(out.stamped.input, input);
        }
    }

    #[test]
    fn a_request_is_not_left() {
        let stamped = Stamped { at: 1, input: Input::Request(Request::Cancel) };
        assert!(Addressed { member: 0, stamped }.to_words().is_none());
    }
}
