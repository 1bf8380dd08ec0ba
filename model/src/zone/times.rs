//! The times of a packed state. The state's bytes say where there are times, and the state's zone says which values
//! they may have.
//!
//! Each time is a variable of its own, in the order of packing, and zero is the present instant. So even states whose
//! times differ by constants have the same bytes, and their zones can be compared and merged.

use imrs_protocol::Ticks;
use imrs_protocol::symbolic::{self, START, Symbol};

/// A variable and an offset.
pub(super) type Term = (u8, i64);

/// The times of a state that is being packed; or, of a packed state, how many times were already read.
#[derive(Debug, Default)]
pub(crate) struct Times {
    /// The present instant.
    pub(super) now: Term,
    pub(super) terms: Vec<Term>,
    pub(super) read: usize,
    /// When the packet that comes next was sent.
    pub(super) sent: Option<Term>,
    /// The positions of times that have passed and were packed as plain zeros, although it may matter how long ago they
    /// passed.
    pub(super) over: Vec<usize>,
}

impl Times {
    /// The times of a state whose zone has `len` variables: the present, then each of the state's times.
    pub fn of_zone(len: usize) -> Self {
        let terms = (1..len).map(|variable| (u8::try_from(variable).unwrap_or(u8::MAX), 0)).collect();
        Self { now: (START, 0), terms, ..Self::default() }
    }

    /// The variables, in the zone of the packed state, of the times that are zero because they have passed.
    pub fn over(&self) -> &[usize] {
        &self.over
    }

    /// The terms of the new state's zone: the present, then each of the state's times.
    pub fn terms(&self) -> Vec<(usize, i64)> {
        let all = std::iter::once(&self.now).chain(&self.terms);
        all.map(|&(variable, offset)| (usize::from(variable), offset)).collect()
    }
}

/// A time as a symbol (a difference of two variables plus a number); `None` if the time never comes.
pub(crate) fn symbol_of(time: Ticks) -> Option<Symbol> {
    let plain = || Symbol { first: START, second: START, offset: time.0.cast_signed() };
    (time != Ticks::FAR).then(|| symbolic::symbol(time.0).unwrap_or_else(plain))
}
