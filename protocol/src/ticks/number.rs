//! The operations on times. A time that is a plain number is compared and added as it is. With the feature `checker`, a
//! time may also be a symbol; `symbolic` then computes the result.

#[cfg(feature = "checker")]
use super::symbolic;
use core::cmp::Ordering;

/// Computes with plain numbers; if one of the operands is a symbol, `symbolic` computes.
macro_rules! either {
    ($symbols:path, $numbers:expr, $a:ident, $b:ident) => {{
        #[cfg(feature = "checker")]
        if symbolic::is_any($a, $b) {
            return $symbols($a, $b);
        }
        $numbers
    }};
}

#[inline]
pub(super) fn is_same(a: u64, b: u64) -> bool {
    either!(symbolic::is_same, a == b, a, b)
}

#[inline]
pub(super) fn is_less(a: u64, b: u64) -> bool {
    either!(symbolic::is_less, a < b, a, b)
}

#[inline]
pub(super) fn order(a: u64, b: u64) -> Ordering {
    either!(symbolic::order, a.cmp(&b), a, b)
}

#[inline]
pub(super) fn sum(a: u64, b: u64) -> u64 {
    either!(symbolic::sum, a.saturating_add(b), a, b)
}

/// `a - b`, or zero if `b` is greater. The greatest number, which stands for "never", stays the same.
#[inline]
pub(super) fn difference(a: u64, b: u64) -> u64 {
    either!(symbolic::difference, if a == u64::MAX { a } else { a.saturating_sub(b) }, a, b)
}

/// How often `b`, a plain number above zero, fits into `a`.
#[inline]
pub(super) fn quotient(a: u64, b: u64) -> u64 {
    either!(symbolic::quotient, a / b, a, b)
}
