//! The times of a packed state: its bytes say where there are times, and its zone says which ones.
//!
//! Each time is a variable of its own, in the order of packing, and zero is the present instant. So even states whose times
//! differ by constants have the same bytes, and their zones can be compared and merged.

/// A time as a variable and an offset.
pub(super) type Term = (u8, i64);

/// The times of a state that is being packed; or, of a packed state, how many times were already read.
#[derive(Debug, Default)]
pub(crate) struct Times {
    /// The present instant.
    pub(super) now: Term,
    pub(super) terms: Vec<Term>,
    pub(super) read: u8,
    /// When the packet that is packed next was sent.
    pub(super) sent: Option<Term>,
}

impl Times {
    /// The terms of the packed state's zone: the present instant, then each of the state's times.
    pub fn terms(&self) -> Vec<(usize, i64)> {
        let all = std::iter::once(&self.now).chain(&self.terms);
        all.map(|&(variable, offset)| (usize::from(variable), offset)).collect()
    }
}
