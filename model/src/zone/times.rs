//! The times of a packed state: its bytes say where there are times, and its zone says which ones.
//!
//! Each time is a variable of its own, in the order of packing, and zero is the present. So states whose times differ by
//! constants, too, have the same bytes, and their zones can be compared and merged.

/// A variable and an offset.
pub(super) type Term = (u8, i64);

/// The instants of a state that is packed, or how many times of a packed state were read.
#[derive(Debug, Default)]
pub(crate) struct Times {
    /// The present.
    pub(super) now: Term,
    pub(super) terms: Vec<Term>,
    pub(super) read: u8,
    /// When the packet that comes next was sent.
    pub(super) sent: Option<Term>,
}

impl Times {
    /// The terms of the new state's zone: the present, then each of its times.
    pub fn terms(&self) -> Vec<(usize, i64)> {
        let all = std::iter::once(&self.now).chain(&self.terms);
        all.map(|&(variable, offset)| (usize::from(variable), offset)).collect()
    }
}
