//! Packets in canonical states (D51): what of a packet a future depends on, everything relative.
//!
//! Left out are the marks that only observers read (re-sent, urgent) and the relays still allowed (routes are shortest
//! ways: where a packet is says how many it has passed).

use crate::comm_task::{Frame, Overflow};
use crate::ids::{Incarnation, MessageId, PortId, Round, Seq24, TaskId};
use crate::packet::{CONTENTS_BYTES, Class, Contents, Kind, MAX_HOPS, Meeting, Packet, Seal};
use crate::ticks::Ticks;

const STATUS: u8 = 0x08;
const MORE: u8 = 0x10;
const FRAGMENT: u8 = 0x20;
/// An arrival brings something.
const BRINGS: u8 = 0x40;
/// A length of time of four bytes follows.
pub(crate) const LONG: u8 = 254;

/// Appends bytes to a slice.
pub(crate) struct Pen<'a> {
    bytes: &'a mut [u8],
    pub at: usize,
}

impl<'a> Pen<'a> {
    pub const fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub fn byte(&mut self, byte: u8) -> Result<(), Overflow> {
        *self.bytes.get_mut(self.at).ok_or(Overflow)? = byte;
        self.at += 1;
        Ok(())
    }

    pub fn small(&mut self, number: impl TryInto<u8>) -> Result<(), Overflow> {
        self.byte(number.try_into().map_err(|_| Overflow)?)
    }

    /// What a member brings to a meeting, without the zeros at its end.
    pub fn arguments(&mut self, arguments: &[u8; 8]) -> Result<(), Overflow> {
        let len = arguments.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
        self.small(len)?;
        arguments[..len].iter().try_for_each(|&byte| self.byte(byte))
    }

    /// A length of time: 255 for never, and what no single byte holds behind a 254.
    pub fn ticks(&mut self, ticks: Ticks) -> Result<(), Overflow> {
        if ticks == Ticks::FAR {
            return self.byte(u8::MAX);
        }
        if let Some(short) = u8::try_from(ticks.0).ok().filter(|&short| short < LONG) {
            return self.byte(short);
        }
        let long = u32::try_from(ticks.0).map_err(|_| Overflow)?;
        self.byte(LONG)?;
        long.to_le_bytes().iter().try_for_each(|&byte| self.byte(byte))
    }
}

/// Reads bytes; past the end there are zeros.
pub(crate) struct Eye<'a> {
    bytes: &'a [u8],
    pub at: usize,
}

impl<'a> Eye<'a> {
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub fn byte(&mut self) -> u8 {
        let byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        byte
    }

    pub fn arguments(&mut self) -> [u8; 8] {
        let len = usize::from(self.byte()).min(8);
        let mut arguments = [0; 8];
        arguments.iter_mut().take(len).for_each(|byte| *byte = self.byte());
        arguments
    }

    pub fn ticks(&mut self) -> Ticks {
        match self.byte() {
            u8::MAX => Ticks::FAR,
            LONG => {
                Ticks(u64::from(u32::from_le_bytes([self.byte(), self.byte(), self.byte(), self.byte()])))
            }
            ticks => Ticks(u64::from(ticks)),
        }
    }
}

impl Packet {
    /// The task whose sequence the packet's id counts in: an answer carries the request's id (D47). On a port with
    /// usage `reply` that is the destination, too (D11).
    #[must_use]
    pub const fn id_source(&self) -> TaskId {
        match self.kind {
            Kind::Reply | Kind::Response | Kind::Control => self.destination,
            Kind::Send | Kind::Query | Kind::Arrive | Kind::Confirm | Kind::Abort => self.source,
        }
    }

    /// Whether the packet speaks of a meeting, so that it has rounds and no id.
    #[must_use]
    pub const fn is_of_meeting(&self) -> bool {
        match self.kind {
            Kind::Arrive | Kind::Confirm | Kind::Abort => true,
            Kind::Send | Kind::Query | Kind::Reply | Kind::Response | Kind::Control => false,
        }
    }

    /// What an arrival brings to its meeting, where that is something.
    fn brings(&self) -> Option<[u8; 8]> {
        let arguments = (self.kind == Kind::Arrive).then(|| self.meeting().arguments);
        arguments.filter(|arguments| *arguments != [0; 8])
    }

    /// Writes the canonical bytes of this packet and returns how many.
    ///
    /// # Errors
    /// [`Overflow`] when a distance or a number outgrows its field, or `out` is too short.
    pub fn store(&self, frame: &Frame<'_>, out: &mut [u8]) -> Result<usize, Overflow> {
        let mut pen = Pen::new(out);
        let flag = |set: bool, bit: u8| if set { bit } else { 0 };
        let flags = flag(self.class == Class::Status, STATUS)
            | flag(self.more, MORE)
            | flag(self.fragment != 0, FRAGMENT)
            | flag(self.brings().is_some(), BRINGS);
        pen.byte(self.kind as u8 | flags)?;
        if self.fragment != 0 {
            pen.byte(self.fragment)?;
        }
        let (source, destination) = (self.source.0, self.destination.0);
        if source > 15 || destination > 15 {
            return Err(Overflow);
        }
        pen.small((source << 4) | destination)?;
        pen.small(self.port.0)?;
        if frame.lives {
            pen.byte(self.id.incarnation.0)?;
        }
        pen.ticks(self.remaining)?;
        if self.is_of_meeting() {
            let base = frame.rounds.get(self.port.index()).copied().unwrap_or_default();
            let meeting = self.meeting();
            pen.small(meeting.round.steps_from(base))?;
            pen.small(meeting.released.steps_from(base))?;
            if self.kind == Kind::Abort {
                pen.small(meeting.next_round().steps_from(base))?;
            }
            self.brings().iter().try_for_each(|brought| pen.arguments(brought))?;
            return Ok(pen.at);
        }
        let next = frame.sequences.get(self.id_source().index()).copied().unwrap_or_default();
        pen.small(next.steps_from(self.id.sequence))?;
        pen.small(self.contents.as_bytes().len())?;
        self.contents.as_bytes().iter().try_for_each(|&byte| pen.byte(byte))?;
        Ok(pen.at)
    }

    /// Reads a packet back, its ids relative to [`Frame::ROUND`] and [`Frame::SEQUENCE`], and says how many bytes it
    /// took. Of bytes that no [`store`](Self::store) wrote some packet comes out; none of them panics.
    #[must_use]
    pub fn load(bytes: &[u8], lives: bool) -> (Self, usize) {
        let mut eye = Eye::new(bytes);
        let head = eye.byte();
        let kind = Kind::ALL[usize::from(head & 7)];
        let fragment = if head & FRAGMENT != 0 { eye.byte() } else { 0 };
        let ends = eye.byte();
        let port = PortId(u16::from(eye.byte()));
        let incarnation = Incarnation(if lives { eye.byte() } else { 0 });
        let remaining = eye.ticks();
        let mut packet = Self {
            kind,
            class: if head & STATUS != 0 { Class::Status } else { Class::Command },
            more: head & MORE != 0,
            resent: false,
            urgent: false,
            hops: MAX_HOPS,
            fragment,
            destination: TaskId(u16::from(ends & 15)),
            source: TaskId(u16::from(ends >> 4)),
            port,
            id: MessageId { incarnation, sequence: Seq24::default() },
            remaining,
            contents: Contents::EMPTY,
            seal: Seal::NONE,
        };
        let round = |back: u8| Frame::ROUND.plus(u16::from(back));
        if packet.is_of_meeting() {
            let (at, released): (Round, Round) = (round(eye.byte()), round(eye.byte()));
            let arguments = match kind {
                Kind::Abort => Meeting::abort_arguments(round(eye.byte())),
                _ if head & BRINGS != 0 => eye.arguments(),
                _ => [0; 8],
            };
            packet.contents = Meeting { round: at, released, arguments }.to_contents();
            return (packet, eye.at);
        }
        packet.id.sequence = Frame::SEQUENCE.plus(Seq24::MODULUS - u32::from(eye.byte()));
        let len = usize::from(eye.byte()).min(CONTENTS_BYTES);
        let mut contents = [0; CONTENTS_BYTES];
        contents.iter_mut().take(len).for_each(|byte| *byte = eye.byte());
        packet.contents = Contents::new(&contents[..len]).unwrap_or_default();
        (packet, eye.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn packet() -> impl Strategy<Value = Packet> {
        let marks = (0..8_usize, any::<bool>(), any::<bool>(), 0..16_u8);
        let ids = (0..16_u16, 0..16_u16, 0..9_u16, 0..3_u8, 1..200_u32);
        let rounds = (0..200_u16, 0..200_u16, 0..200_u16);
        let time = prop_oneof![Just(Ticks::FAR), (0..300_u64).prop_map(Ticks)];
        (marks, ids, rounds, time, proptest::collection::vec(any::<u8>(), 0..=12)).prop_map(
            |((kind, status, more, fragment), (d, s, p, life, back), rounds, remaining, bytes)| {
                let mut packet = Packet {
                    kind: Kind::ALL[kind],
                    class: if status { Class::Status } else { Class::Command },
                    more,
                    resent: false,
                    urgent: false,
                    hops: MAX_HOPS,
                    fragment,
                    destination: TaskId(d),
                    source: TaskId(s),
                    port: PortId(p),
                    id: MessageId {
                        incarnation: Incarnation(life),
                        sequence: Frame::SEQUENCE.plus(Seq24::MODULUS - back),
                    },
                    remaining,
                    contents: Contents::new(&bytes).unwrap(),
                    seal: Seal::NONE,
                };
                if packet.is_of_meeting() {
                    let round = |r: u16| Frame::ROUND.plus(r);
                    packet.id.sequence = Seq24::default();
                    let arguments = match packet.kind {
                        Kind::Abort => Meeting::abort_arguments(round(rounds.2)),
                        Kind::Arrive => core::array::from_fn(|i| bytes.get(i).copied().unwrap_or(0)),
                        _ => [0; 8],
                    };
                    let meeting = Meeting { round: round(rounds.0), released: round(rounds.1), arguments };
                    packet.contents = meeting.to_contents();
                }
                packet
            },
        )
    }

    proptest! {
        #[test]
        fn loading_undoes_storing(p in packet()) {
            let (rounds, sequences) = ([Frame::ROUND; 9], [Frame::SEQUENCE; 16]);
            let frame = Frame { rounds: &rounds, sequences: &sequences, lives: true };
            let mut bytes = [0; 64];
            let len = p.store(&frame, &mut bytes).unwrap();
            prop_assert_eq!(Packet::load(&bytes[..len], true), (p, len));
            prop_assert!((0..len).all(|short| p.store(&frame, &mut bytes[..short]) == Err(Overflow)));
        }

        /// A shift of all ids of a source, and of all rounds of a port, is not seen.
        #[test]
        fn equal_up_to_a_shift_are_equal_bytes(p in packet(), by: u16) {
            let mut moved = p;
            if p.is_of_meeting() {
                let m = p.meeting();
                let next = m.next_round().plus(by);
                let arguments =
                    if p.kind == Kind::Abort { Meeting::abort_arguments(next) } else { m.arguments };
                moved.contents =
                    Meeting { round: m.round.plus(by), released: m.released.plus(by), arguments }.to_contents();
            } else {
                moved.id.sequence = p.id.sequence.plus(u32::from(by));
            }
            let store = |p: &Packet, round: Round, sequence: Seq24| {
                let (rounds, sequences) = ([round; 9], [sequence; 16]);
                let mut bytes = [0; 64];
                p.store(&Frame { rounds: &rounds, sequences: &sequences, lives: true }, &mut bytes).unwrap();
                bytes
            };
            let here = store(&p, Frame::ROUND, Frame::SEQUENCE);
            let there = store(&moved, Frame::ROUND.plus(by), Frame::SEQUENCE.plus(u32::from(by)));
            prop_assert_eq!(here, there);
        }

        #[test]
        fn any_bytes_are_some_packet(bytes in proptest::collection::vec(any::<u8>(), 0..40), lives: bool) {
            let (_, len) = Packet::load(&bytes, lives);
            prop_assert!(len <= 40);
        }
    }

    #[test]
    fn what_outgrows_its_field_is_an_overflow() {
        let far = [Seq24::new(0x2000); 16];
        let frame = Frame { rounds: &[], sequences: &far, lives: false };
        let (near, _) = Packet::load(&[0, 0x12, 0, 9, 1, 0], false);
        let mut bytes = [0; 64];
        assert_eq!(near.store(&frame, &mut bytes), Err(Overflow), "a distant id");
        let own = [Frame::SEQUENCE; 16];
        let frame = Frame { rounds: &[], sequences: &own, lives: false };
        assert!(near.store(&frame, &mut bytes).is_ok());
        let long = Packet { remaining: Ticks(1 << 32), ..near };
        assert_eq!(long.store(&frame, &mut bytes), Err(Overflow), "a long time");
        let many = Packet { source: TaskId(16), ..near };
        assert_eq!(many.store(&frame, &mut bytes), Err(Overflow), "a task of a large cell");
    }
}
