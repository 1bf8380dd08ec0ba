//! Times without values: a checker runs the machine once for all values that lead to the same behaviour.
//!
//! A symbol is the difference of two variables and an offset, within the 64 bits of an [`Instant`] or of [`Ticks`]. To
//! compare symbols, the machine asks the [`Zone`] of its thread, which holds what is known of the variables. If a
//! comparison may have either result, the zone gives one of them and remembers the other: the checker then runs the step
//! again. So the same compiled code runs on numbers and on symbols (D179).
//!
//! ```
//! use imrs_protocol::symbolic::{self, Symbol, Zone};
//! use imrs_protocol::{Instant, Ticks};
//! use std::{cell::RefCell, rc::Rc};
//!
//! /// Every variable is at most 10.
//! struct Ten;
//! impl Zone for Ten {
//!     fn is_negative(&mut self, symbol: Symbol) -> bool {
//!         symbol.offset < -10
//!     }
//!     fn sum(&mut self, _: Symbol, _: Symbol) -> Symbol {
//!         unreachable!("one variable alone is compared")
//!     }
//! }
//!
//! let at: Instant = symbolic::instant(1);
//! symbolic::within(Rc::new(RefCell::new(Ten)), || {
//!     assert!(at < Instant(11));
//!     assert!(at + Ticks(5) < Instant(16));
//!     assert_eq!((at + Ticks(5)) - at, Ticks(5));
//! });
//! ```

use super::{Instant, Ticks};
use core::cmp::Ordering;
use std::cell::RefCell;
use std::rc::Rc;
use std::thread_local;

/// The variable that stands for the start of all clocks: it is zero.
pub const START: u8 = 0;

/// A symbolic time: `first - second + offset`, or zero if this sum is negative, as [`Instant`] and [`Ticks`] saturate. The
/// checker numbers the variables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Symbol {
    /// The variable that is added.
    pub first: u8,
    /// The variable that is subtracted.
    pub second: u8,
    /// The number of ticks that is added to the difference of the variables.
    pub offset: i64,
}

/// A time in a packed state, which a zone packs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Time {
    /// The time until an instant, or zero if the instant is past. `forgets`: behaviour does not depend on how long it has
    /// been past.
    Left {
        /// Whether behaviour does not depend on how long the instant has been past.
        forgets: bool,
    },
    /// The time since a packet was sent over its link.
    Age,
    /// The remaining time of a packet, counted from the [`Age`](Self::Age) that was packed right before it, or from now.
    Remaining,
}

/// The checker's knowledge of the variables, on the path that the machine takes.
pub trait Zone {
    /// Whether `first - second + offset` is less than zero. If both answers are possible, the zone chooses one, and assumes
    /// it from then on.
    fn is_negative(&mut self, symbol: Symbol) -> bool;

    /// The sum of two symbols without their offsets, for a time that has more than two variables. If two variables have a
    /// fixed distance, they are replaced by that distance. Otherwise the zone makes a new variable, which may stand for
    /// more values than the sum has: the checker then explores more than can happen.
    fn sum(&mut self, one: Symbol, other: Symbol) -> Symbol;

    /// Packs a time as one byte, and stores in the zone what this byte does not say; `None` stands for "never".
    ///
    /// # Panics
    /// If the zone packs no states.
    fn pack(&mut self, time: Time, symbol: Option<Symbol>) -> u8 {
        unreachable!("a zone that packs no states: {time:?} of {symbol:?}")
    }

    /// The time for which a packed byte stands.
    ///
    /// # Panics
    /// If the zone packs no states.
    fn unpack(&mut self, time: Time, packed: u8) -> Option<Symbol> {
        unreachable!("a zone that packs no states: {time:?} as {packed}")
    }
}

thread_local! {
    static ZONE: RefCell<Option<Rc<RefCell<dyn Zone>>>> = const { RefCell::new(None) };
}

/// Runs `run` with symbols whose meaning `zone` knows.
pub fn within<R>(zone: Rc<RefCell<dyn Zone>>, run: impl FnOnce() -> R) -> R {
    /// Restores the previous zone when it is dropped, also if `run` panics.
    struct Restore(Option<Rc<RefCell<dyn Zone>>>);
    impl Drop for Restore {
        fn drop(&mut self) {
            ZONE.set(self.0.take());
        }
    }
    let _restore = Restore(ZONE.replace(Some(zone)));
    run()
}

/// The instant of a variable.
#[must_use]
pub fn instant(variable: u8) -> Instant {
    Instant(Symbol { first: variable, second: START, offset: 0 }.to_number())
}

/// The duration between the instants of two variables, zero if the first is earlier.
#[must_use]
pub fn between(first: u8, second: u8) -> Ticks {
    Ticks(Symbol { first, second, offset: 0 }.to_number())
}

/// The symbol for which the number of an [`Instant`] or of [`Ticks`] stands; `None` for a plain number.
#[must_use]
pub fn symbol(number: u64) -> Option<Symbol> {
    is_symbol(number).then(|| Symbol::of(number))
}

/// Symbols have the two highest bits `10`, plain numbers have no high bit, and "never" has all bits set.
const SYMBOL: u64 = 0b10 << 62;
/// All symbols, read as signed numbers, are less than this.
const END: i64 = i64::MIN + (1 << 62);
const OFFSET_BITS: u32 = 46;
const NEVER: u64 = u64::MAX;

const fn is_symbol(number: u64) -> bool {
    number.cast_signed() < END
}

/// Whether one of the two numbers stands for a symbol.
#[inline]
pub(super) fn is_any(a: u64, b: u64) -> bool {
    (is_symbol(a) || is_symbol(b)) && has_zone()
}

/// Whether this thread has a zone. Without a zone all numbers are plain, whatever a damaged recording says.
pub(crate) fn has_zone() -> bool {
    ZONE.with_borrow(Option::is_some)
}

impl Symbol {
    /// The symbol of a plain number: the start moved by an offset.
    const fn plain(number: u64) -> Self {
        Self { first: START, second: START, offset: number.cast_signed() }
    }

    fn of(number: u64) -> Self {
        if !is_symbol(number) {
            return Self::plain(number);
        }
        let [first, second] = [54, 46].map(|at| (number >> at).to_le_bytes()[0]);
        // The sign of the offset is the highest bit of its field.
        let offset = (number << (64 - OFFSET_BITS)).cast_signed() >> (64 - OFFSET_BITS);
        Self { first, second, offset }
    }

    /// The number that stands for the symbol.
    ///
    /// # Panics
    ///
    /// If the offset exceeds 2^45 ticks: more than a year of microseconds.
    fn to_number(self) -> u64 {
        let Self { first, second, offset } = self;
        if first == second {
            return u64::try_from(offset).unwrap_or(0);
        }
        assert!(offset.unsigned_abs() >> (OFFSET_BITS - 1) == 0, "an offset of {offset} ticks is too large");
        let low = (offset << (64 - OFFSET_BITS)).cast_unsigned() >> (64 - OFFSET_BITS);
        SYMBOL | u64::from(first) << 54 | u64::from(second) << 46 | low
    }

    const fn negated(self) -> Self {
        Self { first: self.second, second: self.first, offset: -self.offset }
    }

    /// The sum of two symbols, without saturation.
    fn plus(self, other: Self) -> Self {
        let offset = self.offset + other.offset;
        match (self, other) {
            (a, b) if a.second == b.first => Self { first: a.first, second: b.second, offset },
            (a, b) if a.first == b.second => Self { first: b.first, second: a.second, offset },
            (a, b) if a.first == a.second => Self { offset, ..b },
            (a, b) if b.first == b.second => Self { offset, ..a },
            (a, b) => {
                let sum = ask(|zone| zone.sum(a, b));
                Self { offset: offset + sum.offset, ..sum }
            }
        }
    }

    fn is_negative(self) -> bool {
        if self.first == self.second { self.offset < 0 } else { ask(|zone| zone.is_negative(self)) }
    }

    /// The symbol, or zero if the symbol is negative.
    fn saturated(self) -> Self {
        if self.is_negative() { Self::plain(0) } else { self }
    }
}

/// Asks the zone of this thread.
///
/// # Panics
///
/// If there is no zone; callers check that first.
fn ask<R>(question: impl FnOnce(&mut dyn Zone) -> R) -> R {
    ZONE.with_borrow(|zone| question(&mut *zone.as_ref().expect("a zone").borrow_mut()))
}

/// Packs a time by the zone of the thread.
pub(crate) fn pack(time: Time, length: Ticks) -> u8 {
    let symbol = (length.0 != NEVER).then(|| Symbol::of(length.0));
    ask(|zone| zone.pack(time, symbol))
}

/// The time that the thread's zone packed as this byte.
pub(crate) fn unpack(time: Time, packed: u8) -> Ticks {
    Ticks(ask(|zone| zone.unpack(time, packed)).map_or(NEVER, Symbol::to_number))
}

#[cold]
pub(super) fn is_same(a: u64, b: u64) -> bool {
    a == b || order(a, b) == Ordering::Equal
}

#[cold]
pub(super) fn is_less(a: u64, b: u64) -> bool {
    if a == b || a == NEVER || b == NEVER {
        return a != b && b == NEVER;
    }
    let (a, b) = (Symbol::of(a), Symbol::of(b));
    // After saturation at zero `a` is less than `b` exactly if `b` is positive and, before saturation, exceeds `a`.
    b.negated().is_negative() && a.plus(b.negated()).is_negative()
}

#[cold]
pub(super) fn order(a: u64, b: u64) -> Ordering {
    match () {
        () if is_less(a, b) => Ordering::Less,
        () if is_less(b, a) => Ordering::Greater,
        () => Ordering::Equal,
    }
}

#[cold]
pub(super) fn sum(a: u64, b: u64) -> u64 {
    if a == NEVER || b == NEVER {
        return NEVER;
    }
    Symbol::of(a).saturated().plus(Symbol::of(b).saturated()).to_number()
}

#[cold]
pub(super) fn difference(a: u64, b: u64) -> u64 {
    match () {
        () if a == NEVER => NEVER,
        () if a == b || b == NEVER => 0,
        // `a` need not be saturated first, because the subtracted time is not negative.
        () => Symbol::of(a).plus(Symbol::of(b).saturated().negated()).to_number(),
    }
}

/// How often `b` fits into `a`. The function compares multiples of `b` with `a`, so that the quotient is a plain number. It doubles the
/// multiple until this is greater than `a`, and then halves the range between the last two.
#[cold]
pub(super) fn quotient(a: u64, b: u64) -> u64 {
    let (mut fits, mut above) = (0, 1);
    while !is_less(a, above * b) {
        (fits, above) = (above, above * 2);
    }
    while above - fits > 1 {
        let middle = fits.midpoint(above);
        if is_less(a, middle * b) {
            above = middle;
        } else {
            fits = middle;
        }
    }
    fits
}
