//! The bounds of a matrix: shared by its copies, or owned by one that changes.

use std::cell::RefCell;
use std::hash::{Hash, Hasher};
use std::mem;
use std::ops::Deref;
use std::sync::Arc;

thread_local! {
    /// Buffers of matrices that are gone. A run changes a copy of its zone, and a new buffer for each run would cost as much
    /// as the run's comparisons.
    static BUFFERS: RefCell<Vec<Vec<i32>>> = const { RefCell::new(Vec::new()) };
}

/// Bounds in the order of their rows. A copy is always shared.
pub(super) enum Bounds {
    Shared(Arc<[i32]>),
    Own(Vec<i32>),
}

impl Bounds {
    /// The bounds over `len` variables of which only these are not free, each with its place.
    pub fn of(len: usize, bounds: impl Iterator<Item = (usize, i32)>) -> Self {
        let mut own = vec![super::FREE; len * len];
        own.iter_mut().step_by(len + 1).for_each(|to_itself| *to_itself = 0);
        bounds.for_each(|(at, bound)| own[at] = bound);
        Self::Own(own)
    }

    /// The bounds, to be changed.
    pub fn own(&mut self) -> &mut Vec<i32> {
        if let Self::Shared(shared) = self {
            let mut own = BUFFERS.with_borrow_mut(Vec::pop).unwrap_or_default();
            own.clear();
            own.extend_from_slice(shared);
            *self = Self::Own(own);
        }
        match self {
            Self::Own(own) => own,
            Self::Shared(_) => unreachable!("the bounds were copied above"),
        }
    }
}

impl Deref for Bounds {
    type Target = [i32];

    fn deref(&self) -> &[i32] {
        match self {
            Self::Shared(shared) => shared,
            Self::Own(own) => own,
        }
    }
}

impl Clone for Bounds {
    fn clone(&self) -> Self {
        Self::Shared(match self {
            Self::Shared(shared) => Arc::clone(shared),
            Self::Own(own) => own.as_slice().into(),
        })
    }
}

impl Drop for Bounds {
    fn drop(&mut self) {
        if let Self::Own(own) = self {
            let own = mem::take(own);
            // While the thread ends there may be no list.
            let _ = BUFFERS.try_with(|buffers| buffers.borrow_mut().push(own));
        }
    }
}

impl FromIterator<i32> for Bounds {
    fn from_iter<I: IntoIterator<Item = i32>>(bounds: I) -> Self {
        Self::Shared(bounds.into_iter().collect())
    }
}

impl PartialEq for Bounds {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl Eq for Bounds {}

impl Hash for Bounds {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (**self).hash(state);
    }
}
