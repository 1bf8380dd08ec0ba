//! Locks of values that are whole at any time.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks, whatever a panic elsewhere left.
pub(crate) fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
