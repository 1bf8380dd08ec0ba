//! Writes canonical bytes.

use super::{Frame, Overflow, Walk};
use crate::ids::{Incarnation, PortId, Round, Seq24, TaskId};
use crate::packed::Pen;
use crate::packet::Contents;
use crate::ticks::Ticks;

/// The pass that writes.
pub(crate) struct Encode<'a> {
    pen: Pen<'a>,
    frame: &'a Frame<'a>,
    now: Ticks,
    /// Where the byte stands that the next bits go into, and how many of it are taken.
    open: usize,
    taken: u32,
    failed: bool,
}

impl<'a> Encode<'a> {
    /// Writes to `out` what is relative to `now` and to a frame.
    pub fn new(out: &'a mut [u8], frame: &'a Frame<'a>, now: Ticks) -> Self {
        Self { pen: Pen::new(out), frame, now, open: 0, taken: u8::BITS, failed: false }
    }

    /// How many bytes it took.
    ///
    /// # Errors
    /// [`Overflow`] when a distance or a number outgrew its field, or there was too little room.
    pub fn finish(self) -> Result<usize, Overflow> {
        if self.failed { Err(Overflow) } else { Ok(self.pen.at) }
    }

    fn put(&mut self, byte: u8) {
        self.failed |= self.pen.byte(byte).is_err();
    }

    fn put_all(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.put(byte));
    }

    fn distance(&mut self, distance: impl TryInto<u8>) {
        match distance.try_into() {
            Ok(distance) => self.put(distance),
            Err(_) => self.failed = true,
        }
    }
}

impl Walk for Encode<'_> {
    const LOADS: bool = false;
    const CHANGES: bool = false;
    const WRITES: bool = true;

    fn lives(&self) -> bool {
        self.frame.lives
    }

    fn fail(&mut self) {
        self.failed = true;
    }

    fn bits(&mut self, n: u32, value: u8) -> u8 {
        if self.taken + n > u8::BITS {
            (self.open, self.taken) = (self.pen.at, 0);
            self.put(0);
        }
        self.failed |= u32::from(value) >> n != 0;
        self.pen.set(self.open, value.checked_shl(self.taken).unwrap_or(0));
        self.taken += n;
        value
    }

    fn align(&mut self) {
        self.taken = u8::BITS;
    }

    fn code(&mut self, value: u8) -> u8 {
        self.put(value);
        value
    }

    fn count(&mut self, value: usize) -> usize {
        self.distance(value);
        value
    }

    fn word(&mut self, value: u16) -> u16 {
        self.put_all(&value.to_le_bytes());
        value
    }

    fn long(&mut self, value: u64) -> u64 {
        self.put_all(&value.to_le_bytes());
        value
    }

    fn instant(&mut self, instant: &mut Ticks) {
        let left = if *instant == Ticks::FAR { Ticks::FAR } else { *instant - self.now };
        self.failed |= self.pen.ticks(left).is_err();
    }

    fn derived(&mut self, _: &mut Ticks, _: impl FnOnce() -> Ticks) {}

    fn round(&mut self, port: PortId, round: &mut Round) {
        let base = self.frame.rounds.get(port.index()).copied().unwrap_or_default();
        self.distance(round.steps_from(base));
    }

    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24) {
        let next = self.frame.sequences.get(source.index()).copied().unwrap_or_default();
        self.distance(next.steps_from(*sequence));
    }

    fn next_sequence(&mut self, _: TaskId, _: &mut Seq24) {}

    fn epoch(&mut self, _: u8, epoch: &mut u8) {
        self.put(*epoch);
    }

    fn life(&mut self, life: &mut Incarnation) {
        if self.frame.lives {
            self.put(life.0);
        }
    }

    fn contents(&mut self, contents: &mut Contents) {
        self.distance(contents.as_bytes().len());
        self.put_all(contents.as_bytes());
    }

    fn arguments(&mut self, arguments: &mut [u8; 8]) {
        self.failed |= self.pen.arguments(arguments).is_err();
    }
}
