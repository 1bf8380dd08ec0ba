//! Reads canonical bytes back.

use super::{Frame, Walk};
use crate::ids::{Incarnation, PortId, Round, Seq24, TaskId};
use crate::packed::Eye;
use crate::packet::{CONTENTS_BYTES, Contents};
use crate::ticks::Ticks;

/// The pass that reads. Ids come back relative to [`Frame::ROUND`] and [`Frame::SEQUENCE`], time relative to zero. Past the
/// end it reads zeros, which no pass that writes leaves and no part panics on.
pub(crate) struct Decode<'a> {
    eye: Eye<'a>,
    lives: bool,
    /// The bits that are left of the byte that they came from, and how many of it are taken.
    open: u8,
    taken: u32,
}

impl<'a> Decode<'a> {
    /// Reads what was written in a frame that told lives apart or did not.
    pub const fn new(bytes: &'a [u8], lives: bool) -> Self {
        Self { eye: Eye::new(bytes), lives, open: 0, taken: u8::BITS }
    }

    /// How many bytes it took.
    pub const fn finish(self) -> usize {
        self.eye.at
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        core::array::from_fn(|_| self.eye.byte())
    }
}

impl Walk for Decode<'_> {
    const LOADS: bool = true;
    const CHANGES: bool = false;
    const WRITES: bool = false;

    fn lives(&self) -> bool {
        self.lives
    }

    fn bits(&mut self, n: u32, _: u8) -> u8 {
        if self.taken + n > u8::BITS {
            (self.open, self.taken) = (self.eye.byte(), 0);
        }
        let value = u32::from(self.open) >> self.taken & ((1 << n) - 1);
        self.taken += n;
        u8::try_from(value).unwrap_or(0)
    }

    fn align(&mut self) {
        self.taken = u8::BITS;
    }

    fn code(&mut self, _: u8) -> u8 {
        self.eye.byte()
    }

    fn count(&mut self, _: usize) -> usize {
        usize::from(self.eye.byte())
    }

    fn word(&mut self, _: u16) -> u16 {
        u16::from_le_bytes(self.take())
    }

    fn long(&mut self, _: u64) -> u64 {
        u64::from_le_bytes(self.take())
    }

    fn instant(&mut self, instant: &mut Ticks) {
        *instant = self.eye.ticks();
    }

    fn derived(&mut self, instant: &mut Ticks, rebuilt: impl FnOnce() -> Ticks) {
        *instant = rebuilt();
    }

    fn round(&mut self, _: PortId, round: &mut Round) {
        *round = Frame::ROUND.plus(u16::from(self.eye.byte()));
    }

    fn sequence(&mut self, _: TaskId, sequence: &mut Seq24) {
        *sequence = Frame::SEQUENCE.plus(Seq24::MODULUS - u32::from(self.eye.byte()));
    }

    fn next_sequence(&mut self, _: TaskId, sequence: &mut Seq24) {
        *sequence = Frame::SEQUENCE;
    }

    fn epoch(&mut self, _: u8, epoch: &mut u8) {
        *epoch = self.eye.byte();
    }

    fn life(&mut self, life: &mut Incarnation) {
        *life = Incarnation(if self.lives { self.eye.byte() } else { 0 });
    }

    fn contents(&mut self, contents: &mut Contents) {
        let len = usize::from(self.eye.byte()).min(CONTENTS_BYTES);
        let mut bytes = [0; CONTENTS_BYTES];
        bytes.iter_mut().take(len).for_each(|byte| *byte = self.eye.byte());
        *contents = Contents::new(&bytes[..len]).unwrap_or_default();
    }

    fn arguments(&mut self, arguments: &mut [u8; 8]) {
        *arguments = self.eye.arguments();
    }
}
