//! Canonical packing of a packet: the fields that can affect future behaviour.

use super::{Class, Kind, Meeting, Packet};
use crate::ids::TaskId;
use crate::state::{Pass, Walk, mark};

/// The low bits of the first byte, which hold the kind. The constants below are the flags in the bits above them.
const KIND: u8 = 0x07;
const STATUS: u8 = 0x08;
const MORE: u8 = 0x10;
const FRAGMENT: u8 = 0x20;
/// The flag of an ARRIVE that has arguments.
const BRINGS: u8 = 0x40;

/// The highest task number that fits: source and destination share a byte.
const MOST_TASKS: u16 = 15;

impl Packet {
    /// The task from whose sequence the packet's id comes. An answer carries the request's id, so that task is its
    /// destination (D47), also on a port with usage `reply` (D11).
    #[must_use]
    pub fn id_source(&self) -> TaskId {
        self.kind.id_source(self.source, self.destination)
    }

    /// Whether the packet belongs to a rendezvous. Such a packet carries rounds and no id.
    #[must_use]
    pub const fn is_of_meeting(&self) -> bool {
        self.kind.is_of_meeting()
    }

    /// Walks the packet's fields.
    pub fn walk<W: Walk>(&mut self, w: &mut W) {
        if W::READS {
            *self = Self::BLANK;
        }
        let Self {
            kind,
            class,
            more,
            // Only observers read this field.
            resent: _,
            // Routes are static, so the place of a packet determines how many relays it has passed.
            hops: _,
            fragment,
            destination,
            source,
            port,
            id,
            remaining,
            contents,
            // Comparisons of packets ignore this field (D154).
            seal: _,
        } = self;
        let mut meeting = Meeting::from_contents(contents);
        let head = w.put(
            *kind as u8
                | mark(*class == Class::Status, STATUS)
                | mark(*more, MORE)
                | mark(*fragment != 0, FRAGMENT)
                | mark(*kind == Kind::Arrive && meeting.arguments != [0; 8], BRINGS),
        );
        if W::READS {
            *kind = Kind::ALL[usize::from(head & KIND)];
            *class = if head & STATUS != 0 { Class::Status } else { Class::Command };
            *more = head & MORE != 0;
        }
        if head & FRAGMENT != 0 {
            w.byte(fragment);
        }
        if source.0.max(destination.0) > MOST_TASKS {
            w.overflows();
        }
        let ends = (source.0 & MOST_TASKS) << 4 | destination.0 & MOST_TASKS;
        let ends = u16::from(w.put(ends.to_le_bytes()[0]));
        if W::READS {
            (*source, *destination) = (TaskId(ends >> 4), TaskId(ends & MOST_TASKS));
        }
        w.small(&mut port.0);
        w.incarnation(&mut id.incarnation);
        w.length(remaining);
        if !kind.is_of_meeting() {
            w.sequence(kind.id_source(*source, *destination), &mut id.sequence);
            return w.contents(contents);
        }
        w.round(*port, &mut meeting.round);
        w.round(*port, &mut meeting.released);
        if *kind == Kind::Abort {
            let mut next = meeting.next_round();
            w.round(*port, &mut next);
            meeting.arguments = Meeting::abort_arguments(next);
        } else if head & BRINGS != 0 {
            w.arguments(&mut meeting.arguments);
        }
        if matches!(W::PASS, Pass::Decode | Pass::Change) {
            *contents = meeting.to_contents();
        }
    }
}

impl Kind {
    const fn id_source(self, source: TaskId, destination: TaskId) -> TaskId {
        match self {
            Self::Reply | Self::Response | Self::Control => destination,
            Self::Send | Self::Query | Self::Arrive | Self::Confirm | Self::Abort => source,
        }
    }

    const fn is_of_meeting(self) -> bool {
        match self {
            Self::Arrive | Self::Confirm | Self::Abort => true,
            Self::Send | Self::Query | Self::Reply | Self::Response | Self::Control => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::{Incarnation, MessageId, PortId, Round, Seq24};
    use crate::packet::Contents;
    use crate::state::{Decode, Encode, Frame, Overflow};
    use crate::ticks::Ticks;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    fn packet() -> impl Strategy<Value = Packet> {
        let marks = (0..8_usize, any::<bool>(), any::<bool>(), 0..16_u8);
        let ids = (0..16_u16, 0..16_u16, 0..9_u16, 0..3_u8, 1..200_u32);
        let rounds = (0..200_u16, 0..200_u16, 0..200_u16);
        let time = prop_oneof![Just(Ticks::FAR), (0..300_u64).prop_map(Ticks)];
        (marks, ids, rounds, time, proptest::collection::vec(any::<u8>(), 0..=12)).prop_map(
            |((kind, status, more, fragment), (d, s, p, incarnation, back), rounds, remaining, bytes)| {
                let mut packet = Packet {
                    kind: Kind::ALL[kind],
                    class: if status { Class::Status } else { Class::Command },
                    more,
                    fragment,
                    destination: TaskId(d),
                    source: TaskId(s),
                    port: PortId(p),
                    id: MessageId {
                        incarnation: Incarnation(incarnation),
                        sequence: Frame::SEQUENCE.plus(Seq24::MODULUS - back),
                    },
                    remaining,
                    contents: Contents::new(&bytes).unwrap(),
                    ..Packet::BLANK
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

    fn encoded(packet: &Packet, (round, sequence): (Round, Seq24)) -> Result<Vec<u8>, Overflow> {
        let (rounds, sequences) = ([round; 9], [sequence; 16]);
        let frame = Frame { rounds: &rounds, sequences: &sequences, incarnations: true };
        let mut packet = *packet;
        Encode::bytes(&frame, |w| packet.walk(w))
    }

    const HOME: (Round, Seq24) = (Frame::ROUND, Frame::SEQUENCE);

    /// A pass that moves all ids of a source, and all rounds of a port, by the same number.
    struct Shift(u16);

    impl Walk for Shift {
        const PASS: Pass = Pass::Change;
        fn round(&mut self, _: PortId, round: &mut Round) {
            *round = round.plus(self.0);
        }
        fn sequence(&mut self, _: TaskId, sequence: &mut Seq24) {
            *sequence = sequence.plus(u32::from(self.0));
        }
    }

    proptest! {
        #[test]
        fn reading_undoes_writing(p in packet()) {
            let bytes = encoded(&p, HOME).unwrap();
            let mut back = Packet::BLANK;
            prop_assert_eq!(Decode::read(&bytes, true, |w| back.walk(w)), bytes.len());
            prop_assert_eq!(back, p);
        }

        /// Packets that differ only by a shift of all ids of a source and all rounds of a port have the same bytes.
        #[test]
        fn equal_up_to_a_shift_are_equal_bytes(p in packet(), by: u16) {
            let mut moved = p;
            moved.walk(&mut Shift(by));
            let there = (Frame::ROUND.plus(by), Frame::SEQUENCE.plus(u32::from(by)));
            prop_assert_eq!(encoded(&p, HOME), encoded(&moved, there));
        }

        #[test]
        fn any_bytes_are_some_packet(bytes in proptest::collection::vec(any::<u8>(), 0..40), incarnations: bool) {
            let mut packet = Packet::BLANK;
            prop_assert!(Decode::read(&bytes, incarnations, |w| packet.walk(w)) <= 40);
        }
    }

    #[test]
    fn what_outgrows_its_field_is_an_overflow() {
        let mut near = Packet::BLANK;
        Decode::read(&[0, 0x12, 0, 9, 1, 0], false, |w| near.walk(w));
        assert!(encoded(&near, HOME).is_ok());
        assert_eq!(encoded(&near, (Frame::ROUND, Seq24::new(0x2000))), Err(Overflow), "a distant id");
        let long = Packet { remaining: Ticks(1 << 32), ..near };
        assert_eq!(encoded(&long, HOME), Err(Overflow), "a long time");
        let many = Packet { source: TaskId(16), ..near };
        assert_eq!(encoded(&many, HOME), Err(Overflow), "a task of a large cell");
    }
}
