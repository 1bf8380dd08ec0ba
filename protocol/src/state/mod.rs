//! One walk over all state. Each part of a machine lists its fields once, in [`Walk`]'s terms; writing canonical bytes, reading
//! them back, looking at what is relative and changing it are passes over that list.
//!
//! A canonical state holds remaining times instead of instants, rounds relative to the least one in use on their port and
//! sequences relative to the next one of their source. So two states that differ by a shift of time or ids have the same
//! bytes. A distance that outgrows its field is an [`Overflow`], never a saturated value.
//!
//! A list destructures its struct without `..`: a new field does not compile until it is in the list. There it is *stored*,
//! *derived* (and how it is rebuilt), or *left out* with the reason why no future depends on it.

mod decode;
mod encode;
mod relative;

pub(crate) use decode::Decode;
pub(crate) use encode::Encode;
pub(crate) use relative::{Change, Look};
pub use relative::{Visit, VisitMut};

use crate::ids::{Incarnation, MessageId, PortId, Round, Seq24, TaskId};
use crate::packet::Contents;
use crate::ticks::Ticks;

/// What packed ids are relative to.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// For each port, the least round in use anywhere in the cell.
    pub rounds: &'a [Round],
    /// For each task, the next sequence number it will use.
    pub sequences: &'a [Seq24],
    /// Whether nodes restart: if not, everyone's first life needs no bytes.
    pub lives: bool,
}

impl Frame<'_> {
    /// The round that a packed zero is loaded as.
    pub const ROUND: Round = Round(0x1000);
    /// The next sequence that packed sequences are loaded relative to.
    pub const SEQUENCE: Seq24 = Seq24::new(0x1000);
}

/// A state does not fit its packed form: a distance outgrew a byte, or the bytes ran out. The checker treats it as an
/// absorbing, visible failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Overflow;

impl core::fmt::Display for Overflow {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("a state does not fit its packed form")
    }
}

impl core::error::Error for Overflow {}

/// One pass over state. What takes a value and gives one gives what was read where the pass [loads](Self::LOADS), else the
/// value itself; what takes a reference to a field reads it, sets it or changes it in place.
///
/// Small things share bytes: [`bits`](Self::bits) fill the byte that the first of them began, until [`align`](Self::align).
pub(crate) trait Walk: Sized {
    /// Values come out of the pass: what decides how a part goes on is read before it.
    const LOADS: bool;
    /// The pass changes what is relative, the keys of orders among it: containers are rebuilt behind it.
    const CHANGES: bool;
    /// The pass writes: what stands in any order is taken in one, and what only its order matters of, by its rank.
    const WRITES: bool;

    /// Whether lives of nodes are told apart.
    fn lives(&self) -> bool;

    /// This state has no packed form.
    fn fail(&mut self) {}

    /// `n` bits.
    fn bits(&mut self, n: u32, value: u8) -> u8;

    /// The next bits begin a byte of their own.
    fn align(&mut self);

    /// A byte.
    fn code(&mut self, value: u8) -> u8;

    /// A number that fits a byte in every state that a checker keeps.
    fn count(&mut self, value: usize) -> usize;

    /// Two bytes.
    fn word(&mut self, value: u16) -> u16;

    /// Eight bytes.
    fn long(&mut self, value: u64) -> u64;

    /// An instant on the task's counter.
    fn instant(&mut self, instant: &mut Ticks);

    /// An instant that follows from other fields, or that nothing happens at.
    fn derived(&mut self, instant: &mut Ticks, rebuilt: impl FnOnce() -> Ticks);

    /// A round of a port.
    fn round(&mut self, port: PortId, round: &mut Round);

    /// A number of a message that this task sends or sent.
    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24);

    /// The next number of a task: what its others are relative to.
    fn next_sequence(&mut self, source: TaskId, sequence: &mut Seq24);

    /// An epoch of the couple at this position in the cell.
    fn epoch(&mut self, couple: u8, epoch: &mut u8);

    /// The life of a node: no bytes where lives are not told apart.
    fn life(&mut self, life: &mut Incarnation);

    /// What a message says.
    fn contents(&mut self, contents: &mut Contents);

    /// What a member brings to a meeting, without the zeros at its end.
    fn arguments(&mut self, arguments: &mut [u8; 8]);

    /// A bit.
    fn flag(&mut self, set: bool) -> bool {
        self.bits(1, u8::from(set)) != 0
    }

    /// A field of one bit.
    fn bit(&mut self, set: &mut bool) {
        *set = self.flag(*set);
    }

    /// A field of one byte.
    fn byte(&mut self, byte: &mut u8) {
        *byte = self.code(*byte);
    }

    /// Whether there is something, by a bit. What there is comes later.
    fn present<T: Default>(&mut self, field: &mut Option<T>) {
        let here = self.flag(field.is_some());
        if Self::LOADS {
            *field = here.then(T::default);
        }
    }

    /// A small number that may be absent: one more, or zero.
    fn maybe(&mut self, number: Option<u16>) -> Option<u16> {
        let one_more = self.count(number.map_or(0, |number| usize::from(number) + 1));
        one_more.checked_sub(1).and_then(|number| u16::try_from(number).ok())
    }

    /// The life that something was last heard in. Where lives are not told apart, the first one.
    fn heard(&mut self, life: &mut Option<Incarnation>) {
        if self.lives() {
            let one_more = self.code(life.map_or(0, |life| life.0.wrapping_add(1)));
            if Self::LOADS {
                *life = one_more.checked_sub(1).map(Incarnation);
            }
        } else if Self::LOADS {
            *life = Some(Incarnation(0));
        }
    }

    /// The id of a message of `source`.
    fn id(&mut self, source: TaskId, id: &mut MessageId) {
        self.life(&mut id.incarnation);
        self.sequence(source, &mut id.sequence);
    }

    /// A field that no future depends on, or that is rebuilt from others: it is what it is in a state that was read back.
    fn left_out<T>(&mut self, field: &mut T, read_back: impl FnOnce() -> T) {
        if Self::LOADS {
            *field = read_back();
        }
    }
}
