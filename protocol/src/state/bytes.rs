//! The passes that write the canonical bytes of a state, and read them.

use super::{Pass, Walk};
use crate::ids::{PortId, Round, Seq24, TaskId};
#[cfg(feature = "checker")]
use crate::ticks::symbolic::{self, Time};
use crate::ticks::{Instant, Ticks};
use alloc::vec::Vec;
use core::fmt;

/// The numbers to which packed ids are relative.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// For each port, the least round that any task of the cell uses.
    pub rounds: &'a [Round],
    /// For each task, the next sequence number that the task will use.
    pub sequences: &'a [Seq24],
    /// Whether nodes restart. If not, every incarnation is the first one and takes no bytes.
    pub incarnations: bool,
}

impl Frame<'_> {
    /// The round as which a packed zero is read.
    pub const ROUND: Round = Round(0x1000);
    /// The next sequence number of a task after reading. Packed sequence numbers are relative to it.
    pub const SEQUENCE: Seq24 = Seq24::new(0x1000);
}

/// A state does not fit its packed form: a distance outgrew a byte. The checker treats this as an absorbing, visible
/// failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Overflow;

impl fmt::Display for Overflow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a state does not fit its packed form")
    }
}

impl core::error::Error for Overflow {}

/// Writes canonical bytes: states that differ only by a shift of time or of ids have the same bytes. A distance that
/// outgrows its field is an [`Overflow`], never a saturated value.
#[derive(Debug)]
pub struct Encode<'a> {
    out: &'a mut Vec<u8>,
    frame: Frame<'a>,
    now: Instant,
    overflows: bool,
    /// Whether times may be symbols, which only a zone can pack.
    #[cfg(feature = "checker")]
    is_symbolic: bool,
}

impl<'a> Encode<'a> {
    /// Appends to `out` the bytes of everything that `walk` walks.
    pub fn append(
        out: &'a mut Vec<u8>,
        frame: &Frame<'a>,
        walk: impl FnOnce(&mut Self),
    ) -> Result<(), Overflow> {
        let mut pass = Self {
            out,
            frame: *frame,
            now: Instant::START,
            overflows: false,
            #[cfg(feature = "checker")]
            is_symbolic: symbolic::has_zone(),
        };
        walk(&mut pass);
        if pass.overflows { Err(Overflow) } else { Ok(()) }
    }

    /// The bytes of everything that `walk` walks.
    pub fn bytes(frame: &Frame<'_>, walk: impl FnOnce(&mut Encode<'_>)) -> Result<Vec<u8>, Overflow> {
        let mut out = Vec::new();
        Encode::append(&mut out, frame, walk)?;
        Ok(out)
    }

    #[inline]
    fn distance(&mut self, steps: u32) {
        let byte = u8::try_from(steps).unwrap_or_else(|_| {
            self.overflows = true;
            0
        });
        self.out.push(byte);
    }
}

impl Walk for Encode<'_> {
    const PASS: Pass = Pass::Encode;

    #[inline]
    fn clock(&mut self, now: &mut Instant) {
        self.now = *now;
    }

    #[inline]
    fn instant(&mut self, instant: &mut Instant) {
        let mut left = *instant - self.now;
        #[cfg(feature = "checker")]
        if self.is_symbolic {
            return self.out.push(symbolic::pack(Time::Left { forgets: true }, left));
        }
        self.number_of_ticks(&mut left);
    }

    #[cfg(feature = "checker")]
    fn derived(&mut self, instant: &mut Instant, _: impl FnOnce() -> Instant) {
        if self.is_symbolic {
            self.instant(instant);
        }
    }

    #[inline]
    fn length(&mut self, length: &mut Ticks) {
        #[cfg(feature = "checker")]
        if self.is_symbolic {
            return self.out.push(symbolic::pack(Time::Remaining, *length));
        }
        self.number_of_ticks(length);
    }

    #[cfg(feature = "checker")]
    fn left(&mut self, left: &mut Ticks, forgets: bool) {
        if self.is_symbolic {
            return self.out.push(symbolic::pack(Time::Left { forgets }, *left));
        }
        self.span(left);
    }

    #[cfg(feature = "checker")]
    fn age(&mut self, age: &mut Ticks) {
        if self.is_symbolic {
            return self.out.push(symbolic::pack(Time::Age, *age));
        }
        self.span(age);
    }

    #[inline]
    fn round(&mut self, port: PortId, round: &mut Round) {
        let base = self.frame.rounds.get(port.index()).copied().unwrap_or_default();
        self.distance(u32::from(round.steps_from(base)));
    }

    #[inline]
    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24) {
        let next = self.frame.sequences.get(source.index()).copied().unwrap_or_default();
        self.distance(next.steps_from(*sequence));
    }

    #[inline]
    fn next_sequence(&mut self, _: TaskId, _: &mut Seq24) {}

    #[inline]
    fn epoch(&mut self, _: u8, epoch: &mut u8) {
        self.byte(epoch);
    }

    #[inline]
    fn byte(&mut self, byte: &mut u8) {
        self.out.push(*byte);
    }

    #[inline]
    fn raw(&mut self, bytes: &mut [u8]) {
        self.out.extend_from_slice(bytes);
    }

    #[inline]
    fn incarnations(&self) -> bool {
        self.frame.incarnations
    }

    #[inline]
    fn overflows(&mut self) {
        self.overflows = true;
    }
}

/// Reads bytes that an [`Encode`] wrote. Rounds become relative to [`Frame::ROUND`], sequence numbers to
/// [`Frame::SEQUENCE`], times to zero. Bytes past the end read as zero, and no bytes make the pass panic.
#[derive(Debug)]
pub struct Decode<'a> {
    bytes: &'a [u8],
    at: usize,
    incarnations: bool,
    /// Whether a zone packed the times.
    #[cfg(feature = "checker")]
    is_symbolic: bool,
}

impl<'a> Decode<'a> {
    /// Reads everything that `walk` walks, and returns how many bytes that took.
    pub fn read(bytes: &'a [u8], incarnations: bool, walk: impl FnOnce(&mut Self)) -> usize {
        let mut pass = Self {
            bytes,
            at: 0,
            incarnations,
            #[cfg(feature = "checker")]
            is_symbolic: symbolic::has_zone(),
        };
        walk(&mut pass);
        pass.at
    }

    /// Whether some bytes have not been read yet.
    #[must_use]
    pub const fn has_more(&self) -> bool {
        self.at < self.bytes.len()
    }
}

impl Walk for Decode<'_> {
    const PASS: Pass = Pass::Decode;

    #[inline]
    fn clock(&mut self, now: &mut Instant) {
        *now = Instant::START;
    }

    #[inline]
    fn instant(&mut self, instant: &mut Instant) {
        let mut left = Ticks::ZERO;
        #[cfg(feature = "checker")]
        if self.is_symbolic {
            left = symbolic::unpack(Time::Left { forgets: true }, self.put(0));
            *instant = Instant::START + left;
            return;
        }
        self.number_of_ticks(&mut left);
        *instant = Instant::START + left;
    }

    #[cfg(feature = "checker")]
    fn derived(&mut self, instant: &mut Instant, derive: impl FnOnce() -> Instant) {
        if self.is_symbolic {
            self.instant(instant);
        } else {
            *instant = derive();
        }
    }

    #[inline]
    fn length(&mut self, length: &mut Ticks) {
        #[cfg(feature = "checker")]
        if self.is_symbolic {
            *length = symbolic::unpack(Time::Remaining, self.put(0));
            return;
        }
        self.number_of_ticks(length);
    }

    #[cfg(feature = "checker")]
    fn left(&mut self, left: &mut Ticks, forgets: bool) {
        if self.is_symbolic {
            *left = symbolic::unpack(Time::Left { forgets }, self.put(0));
            return;
        }
        self.span(left);
    }

    #[cfg(feature = "checker")]
    fn age(&mut self, age: &mut Ticks) {
        if self.is_symbolic {
            *age = symbolic::unpack(Time::Age, self.put(0));
            return;
        }
        self.span(age);
    }

    #[inline]
    fn round(&mut self, _: PortId, round: &mut Round) {
        *round = Frame::ROUND.plus(u16::from(self.put(0)));
    }

    #[inline]
    fn sequence(&mut self, _: TaskId, sequence: &mut Seq24) {
        *sequence = Frame::SEQUENCE.plus(Seq24::MODULUS - u32::from(self.put(0)));
    }

    #[inline]
    fn next_sequence(&mut self, _: TaskId, next: &mut Seq24) {
        *next = Frame::SEQUENCE;
    }

    #[inline]
    fn epoch(&mut self, _: u8, epoch: &mut u8) {
        self.byte(epoch);
    }

    #[inline]
    fn byte(&mut self, byte: &mut u8) {
        *byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
    }

    #[inline]
    fn incarnations(&self) -> bool {
        self.incarnations
    }
}
