//! Encodes and decodes the header of a datagram in mode 0; the parent module documents the layout.

use super::{
    COUNTER_END, Digests, Echo, Envelope, EnvelopeError, Greeting, HEADER_BYTES, MAGIC, MODE_CHECKSUM,
    Purpose, Refused, Session, VERSION,
};
use imrs_protocol::{Incarnation, NodeId};

/// The offset of the number of packets.
pub(super) const COUNT_AT: usize = 18;
const PURPOSE_MASK: u8 = 0b11;
const FLAG_ECHO: u8 = 1 << 2;
const FLAG_RESTARTED: u8 = 1 << 3;
const FLAG_WANTS_ANSWER: u8 = 1 << 4;
const FLAG_UNCOUNTED: u8 = 1 << 5;
const FLAG_REMEMBERS: u8 = 1 << 6;

pub(super) type Header = [u8; HEADER_BYTES];

pub(super) fn four(h: &Header, at: usize) -> u32 {
    u32::from_le_bytes([h[at], h[at + 1], h[at + 2], h[at + 3]])
}

fn eight(h: &Header, at: usize) -> u64 {
    u64::from(four(h, at)) | u64::from(four(h, at + 4)) << 32
}

/// Decodes the flags of a datagram and the extra byte behind them: the purpose, whether the sender was restarted, and
/// whether there is an echo.
pub(super) fn purpose_of(flags: u8, extra: u8) -> Result<(Purpose, bool, bool), EnvelopeError> {
    let flag = |flag: u8| flags & flag != 0;
    let purpose = match flags & PURPOSE_MASK {
        0 => Purpose::Packets,
        1 => Purpose::Greeting(Greeting {
            wants_answer: flag(FLAG_WANTS_ANSWER),
            uncounted: flag(FLAG_UNCOUNTED),
            remembers: flag(FLAG_REMEMBERS).then_some(Incarnation(extra)),
        }),
        2 => Purpose::Refusal(Refused::of(extra).ok_or(EnvelopeError::Purpose(flags))?),
        _ => Purpose::Goodbye,
    };
    Ok((purpose, flag(FLAG_RESTARTED), flag(FLAG_ECHO)))
}

/// The flags of a datagram, and its extra byte.
pub(super) fn flags_of(envelope: &Envelope) -> (u8, u8) {
    let flag = |flag: u8, is_set: bool| if is_set { flag } else { 0 };
    let (purpose, extra) = match envelope.purpose {
        Purpose::Packets => (0, 0),
        Purpose::Greeting(Greeting { wants_answer, uncounted, remembers }) => {
            let flags = flag(FLAG_WANTS_ANSWER, wants_answer)
                | flag(FLAG_UNCOUNTED, uncounted)
                | flag(FLAG_REMEMBERS, remembers.is_some());
            (1 | flags, remembers.map_or(0, |of| of.0))
        }
        Purpose::Refusal(reason) => (2, reason as u8),
        Purpose::Goodbye => (3, 0),
    };
    let flags = flag(FLAG_ECHO, envelope.echo.is_some()) | flag(FLAG_RESTARTED, envelope.restarted);
    (purpose | flags, extra)
}

impl Envelope {
    pub(super) fn parse(h: &Header) -> Result<Self, EnvelopeError> {
        let (purpose, restarted, has_echo) = purpose_of(h[17], h[19])?;
        let echo = Echo { session: Session(eight(h, 28)), mono: eight(h, 52) };
        Ok(Self {
            sender: NodeId(u16::from_le_bytes([h[12], h[13]])),
            receiver: NodeId(u16::from_le_bytes([h[14], h[15]])),
            incarnation: Incarnation(h[16]),
            restarted,
            session: Session(eight(h, 20)),
            counter: eight(h, 36) % COUNTER_END,
            tx_mono: eight(h, 44),
            echo: has_echo.then_some(echo),
            purpose,
        })
    }

    pub(super) fn emit(&self, digests: Digests, count: u8, h: &mut Header) {
        let (flags, extra) = flags_of(self);
        h[..2].copy_from_slice(&MAGIC);
        h[2] = VERSION;
        h[3] = MODE_CHECKSUM;
        h[4..8].copy_from_slice(&digests.cell.to_le_bytes());
        h[8..12].copy_from_slice(&digests.statements.to_le_bytes());
        h[12..14].copy_from_slice(&self.sender.0.to_le_bytes());
        h[14..16].copy_from_slice(&self.receiver.0.to_le_bytes());
        h[16] = self.incarnation.0;
        h[17] = flags;
        h[COUNT_AT] = count;
        h[19] = extra;
        h[20..28].copy_from_slice(&self.session.0.to_le_bytes());
        h[28..36].copy_from_slice(&self.echo.map_or(0, |e| e.session.0).to_le_bytes());
        h[36..44].copy_from_slice(&(self.counter % COUNTER_END).to_le_bytes());
        h[44..52].copy_from_slice(&self.tx_mono.to_le_bytes());
        h[52..60].copy_from_slice(&self.echo.map_or(0, |e| e.mono).to_le_bytes());
    }
}
