//! Packets in flight between the nodes of a world, and their packed form.

use crate::scenario::Scenario;
use imrs_protocol::{
    Contents, Frame, Incarnation, Kind, Meeting, MessageId, Overflow, Packet, PortId, Round, Seq24, TaskId,
    Ticks,
};

/// A packet in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct InFlight {
    pub packet: Packet,
    /// Ticks since the packet was sent.
    pub age: u8,
    /// The incarnation of the node that sent the packet, as the packet's envelope says.
    pub incarnation: Incarnation,
    /// Whether the packet was sent since the last tick, after its receiver's turn (see `world::turns`).
    pub fresh: bool,
}

/// The greatest number of bytes of a packed packet.
pub(crate) const IN_FLIGHT_BYTES: usize = 32;

/// The greatest age that half a byte can hold. One more value marks a fresh packet, whose age is 0.
const OLDEST: u8 = 14;
const FRESH: u8 = 15;
/// The mark of a fresh packet in the two age bits of the compact form.
const COMPACT_FRESH: u8 = 3;

/// A packed packet.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Packed {
    bytes: [u8; IN_FLIGHT_BYTES],
    len: u8,
}

impl Packed {
    const EMPTY: Self = Self { bytes: [0; IN_FLIGHT_BYTES], len: 0 };

    fn push(&mut self, byte: u8) -> Result<(), Overflow> {
        *self.bytes.get_mut(usize::from(self.len)).ok_or(Overflow)? = byte;
        self.len += 1;
        Ok(())
    }

    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.len)]
    }
}

/// How packets in flight are packed in one world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Codec {
    /// Whether kind, ends and age of a packet fit into one byte: in a world with one waitfor of at most four tasks, and
    /// link delays of at most two ticks.
    compact: bool,
    incarnations: bool,
    /// The TTL of a CONFIRM or an ABORT. It is not packed, because it is constant.
    patience: Ticks,
}

impl Codec {
    pub fn new(scenario: &Scenario) -> Self {
        let compact = scenario.is_meeting() && scenario.tasks() <= 4 && scenario.delay.unwrap_or(0) <= 2;
        let patience = scenario.cell.ports().first().map_or(Ticks::FAR, |port| port.decl.time_out);
        Self { compact, incarnations: scenario.incarnations(), patience }
    }

    /// Packs a packet in flight. `rename` renames its source and destination.
    pub fn encode(
        self,
        carried: &InFlight,
        frame: &Frame<'_>,
        rename: impl Fn(TaskId) -> u8,
    ) -> Result<Packed, Overflow> {
        let InFlight { packet, age, incarnation, fresh } = carried;
        if *age > OLDEST {
            return Err(Overflow);
        }
        let marked = |mark| if *fresh { mark } else { *age };
        let mut out = Packed::EMPTY;
        let (source, destination) = (rename(packet.source), rename(packet.destination));
        let meeting = packet.is_of_meeting();
        if self.compact {
            let kind = packet.kind as u8 - Kind::Arrive as u8;
            out.push((kind << 6) | (source << 4) | (destination << 2) | marked(COMPACT_FRESH))?;
        } else {
            out.push(((packet.kind as u8) << 4) | marked(FRESH))?;
            out.push((source << 4) | destination)?;
            out.push(u8::try_from(packet.port.0).map_err(|_| Overflow)?)?;
        }
        if self.incarnations {
            out.push((packet.id.incarnation.0 << 4) | incarnation.0)?;
        }
        if meeting {
            return self.encode_meeting(packet, frame, out);
        }
        out.push(u8::from(packet.class == imrs_protocol::Class::Status))?;
        let source_of_id = packet.id_source();
        let next = frame.sequences.get(source_of_id.index()).copied().unwrap_or_default();
        out.push(u8::try_from(next.steps_from(packet.id.sequence)).map_err(|_| Overflow)?)?;
        out.push(remaining(packet.remaining)?)?;
        let contents = packet.contents.as_bytes();
        out.push(u8::try_from(contents.len()).map_err(|_| Overflow)?)?;
        contents.iter().try_for_each(|&byte| out.push(byte))?;
        Ok(out)
    }

    fn encode_meeting(self, packet: &Packet, frame: &Frame<'_>, mut out: Packed) -> Result<Packed, Overflow> {
        let meeting = packet.meeting();
        let base = frame.rounds.get(packet.port.index()).copied().unwrap_or_default();
        let relative =
            |round: Round| u8::try_from(round.steps_from(base)).ok().filter(|&r| r < 15).ok_or(Overflow);
        // The low half of the byte is the round of which the sender was released last. It is 15 if the packet names its
        // own round there, as a sender does that was never released.
        let hint = if meeting.released == meeting.round { 15 } else { relative(meeting.released)? };
        out.push((relative(meeting.round)? << 4) | hint)?;
        match packet.kind {
            Kind::Arrive => out.push(remaining(packet.remaining)?)?,
            _ if packet.remaining != self.patience => return Err(Overflow),
            Kind::Abort => out.push(relative(meeting.next_round())?)?,
            _ => {}
        }
        Ok(out)
    }

    /// Unpacks a packet in flight. Returns the packet and the number of bytes read.
    pub fn decode(self, bytes: &[u8]) -> (InFlight, usize) {
        let mut at = 0;
        let mut byte = || {
            let byte = bytes.get(at).copied().unwrap_or(0);
            at += 1;
            byte
        };
        let (kind, source, destination, age, port, fresh);
        if self.compact {
            let head = byte();
            kind = [Kind::Arrive, Kind::Confirm, Kind::Abort, Kind::Abort][usize::from(head >> 6)];
            (source, destination, age, port) = ((head >> 4) & 3, (head >> 2) & 3, head & 3, 0);
            fresh = age == COMPACT_FRESH;
        } else {
            let head = byte();
            kind = Kind::ALL[usize::from(head >> 4) & 7];
            age = head & 15;
            fresh = age == FRESH;
            let ends = byte();
            (source, destination, port) = (ends >> 4, ends & 15, byte());
        }
        let (mut id_incarnation, mut incarnation) = (Incarnation(0), Incarnation(0));
        if self.incarnations {
            let incarnations = byte();
            (id_incarnation, incarnation) = (Incarnation(incarnations >> 4), Incarnation(incarnations & 15));
        }
        let mut packet = Packet {
            kind,
            destination: TaskId(u16::from(destination)),
            source: TaskId(u16::from(source)),
            port: PortId(u16::from(port)),
            id: MessageId { incarnation: id_incarnation, sequence: Seq24::default() },
            remaining: self.patience,
            ..Packet::BLANK
        };
        if matches!(kind, Kind::Arrive | Kind::Confirm | Kind::Abort) {
            let rounds = byte();
            let round = Frame::ROUND.plus(u16::from(rounds >> 4));
            let released = if rounds & 15 == 15 { round } else { Frame::ROUND.plus(u16::from(rounds & 15)) };
            let mut arguments = [0; 8];
            match kind {
                Kind::Arrive => packet.remaining = time(byte()),
                Kind::Abort => arguments = Meeting::abort_arguments(Frame::ROUND.plus(u16::from(byte()))),
                _ => {}
            }
            packet.contents = Meeting { round, released, arguments }.to_contents();
        } else {
            if byte() == 1 {
                packet.class = imrs_protocol::Class::Status;
            }
            packet.id.sequence = Frame::SEQUENCE.plus(Seq24::MODULUS - u32::from(byte()));
            packet.remaining = time(byte());
            let len = usize::from(byte()).min(12);
            let mut contents = [0; 12];
            for slot in contents.iter_mut().take(len) {
                *slot = byte();
            }
            packet.contents = Contents::new(&contents[..len]).unwrap_or_default();
        }
        (InFlight { packet, age: if fresh { 0 } else { age }, incarnation, fresh }, at)
    }
}

fn remaining(ticks: Ticks) -> Result<u8, Overflow> {
    if ticks == Ticks::FAR {
        return Ok(u8::MAX);
    }
    u8::try_from(ticks.0).ok().filter(|&t| t != u8::MAX).ok_or(Overflow)
}

fn time(byte: u8) -> Ticks {
    if byte == u8::MAX { Ticks::FAR } else { Ticks(u64::from(byte)) }
}
