//! Pinned numbers that the searches must find. If a search finds another number, its verdict is unexpected, so every change
//! that makes the protocol weaker or stronger is noticed.

use crate::report::Found;

/// The key of a pinned number: claim, rule, parties, lost packets.
type Row = (&'static str, &'static str, u32, u32);

/// The fewest losses that strand a member (leave it waiting after all have arrived), without and with retransmission.
const fn losses(once: u32, again: Option<u32>) -> Found {
    Found { least_losses_to_strand: Some(once), least_losses_with_resending: again, ..Found::NOTHING }
}

/// The least margin that holds, and the margin that the formula gives (D56).
const fn margin(least: u64, closed: u64) -> Found {
    Found { least_safe_margin: Some(least), closed_form_margin: Some(closed), ..Found::NOTHING }
}

/// The least TTL with which a message is served, and the TTL that the formula gives (D59).
const fn ttl(least: u64, closed: u64) -> Found {
    Found { least_bound_ticks: Some(least), bound_ticks: Some(closed), ..Found::NOTHING }
}

/// How many attempts the members need to meet (D54).
const fn attempts(k: u32) -> Found {
    Found { attempts: Some(k), ..Found::NOTHING }
}

const UNDER_LOSS: &str = "rendezvous-under-loss";
const ALL_OR_NONE: &str = "all-or-none";
const FAIR: &str = "penalty-is-fair";
const AGAIN: &str = "they-meet-again";
const ACTIVE: &str = "one-active";
/// The number of lost packets in the key of a row that allows any number of losses.
const ANY: u32 = u8::MAX as u32;
const OFF: &str = "default, late timer and charge";

const PINNED: [(Row, Found); 50] = [
    ((UNDER_LOSS, "no-confirmation", 2, 1), losses(1, Some(1))),
    ((UNDER_LOSS, "first-complete", 2, 2), losses(2, Some(4))),
    ((UNDER_LOSS, "every-complete", 2, 2), losses(2, Some(4))),
    ((UNDER_LOSS, "pass-on", 2, 2), losses(2, Some(4))),
    ((UNDER_LOSS, "no-confirmation", 3, 1), losses(1, Some(1))),
    ((UNDER_LOSS, "first-complete", 3, 2), losses(2, Some(6))),
    ((UNDER_LOSS, "every-complete", 3, 3), losses(3, Some(6))),
    ((UNDER_LOSS, "pass-on", 3, 3), losses(3, Some(6))),
    ((UNDER_LOSS, "no-confirmation", 4, 1), losses(1, None)),
    ((UNDER_LOSS, "first-complete", 4, 2), losses(2, None)),
    ((UNDER_LOSS, "every-complete", 4, 4), losses(4, None)),
    ((UNDER_LOSS, "pass-on", 4, 4), losses(4, None)),
    ((UNDER_LOSS, "no-confirmation", 5, 1), losses(1, None)),
    ((ALL_OR_NONE, "default", 2, 0), margin(1, 2)),
    ((ALL_OR_NONE, "default", 2, 1), margin(3, 5)),
    ((ALL_OR_NONE, "default", 2, 2), margin(4, 8)),
    ((ALL_OR_NONE, "default, sent once", 2, 0), margin(1, 2)),
    ((ALL_OR_NONE, "default", 3, 0), margin(1, 2)),
    ((ALL_OR_NONE, "default", 3, 1), margin(3, 5)),
    ((ALL_OR_NONE, OFF, 2, 0), margin(1, 2)),
    ((ALL_OR_NONE, OFF, 2, 1), margin(4, 5)),
    ((ALL_OR_NONE, OFF, 3, 0), margin(1, 2)),
    ((ALL_OR_NONE, "default, largest bounds", 2, 3), margin(4, 11)),
    ((ALL_OR_NONE, "default, two time_outs", 3, 0), margin(1, 2)),
    ((ALL_OR_NONE, "default, two time_outs", 3, 1), margin(3, 5)),
    ((FAIR, "default, served by GETs", 3, 0), ttl(6, 7)),
    ((FAIR, "default, served by GETs, two floods", 4, 0), ttl(6, 8)),
    ((FAIR, "default, served by a handler", 3, 0), ttl(4, 9)),
    ((FAIR, "default, served by GETs, one ahead", 4, 0), ttl(11, 13)),
    ((FAIR, "default, served by GETs, two ahead", 5, 0), ttl(16, 19)),
    ((FAIR, "default, served by a handler, one ahead", 4, 0), ttl(8, 11)),
    ((FAIR, "default, served by a handler, a rival", 3, 0), ttl(3, 11)),
    ((AGAIN, "default", 2, 1), attempts(2)),
    ((AGAIN, "default", 3, 0), attempts(1)),
    ((ACTIVE, "default", 2, ANY), margin(0, 1)),
    ((ACTIVE, "default, drift", 2, ANY), margin(1, 2)),
    ((ACTIVE, "default, crash", 2, ANY), margin(0, 1)),
    ((ACTIVE, "default, two crashes", 2, ANY), margin(0, 1)),
    ((ACTIVE, "default, crash and a copy", 2, ANY), margin(0, 1)),
    ((ACTIVE, "default, slow link and a copy", 2, ANY), margin(0, 1)),
    ((ACTIVE, "default, exchanged roles", 2, 4), margin(0, 1)),
    ((ACTIVE, "default, crash, epochs that wrap", 2, ANY), margin(0, 1)),
    ((ACTIVE, "default, drift and a late tick", 2, ANY), margin(2, 2)),
    ((ACTIVE, "default, more drift", 2, ANY), margin(2, 3)),
    ((ACTIVE, "default, slow link and drift", 2, ANY), margin(1, 3)),
    ((ACTIVE, "default, drift and crash", 2, ANY), margin(1, 2)),
    ((ACTIVE, "default, drift and a copy", 2, ANY), margin(1, 2)),
    ((ACTIVE, "default, exchanged roles, drift", 2, 4), margin(1, 2)),
    ((ACTIVE, "default, exchanged roles, crash", 2, 3), margin(0, 1)),
    ((ACTIVE, "default, exchanged roles, a copy", 2, 3), margin(0, 1)),
];

/// Whether a row found exactly the numbers that are pinned for it.
pub(super) fn agrees(row: (&str, &str, u32, u32), found: &Found) -> bool {
    let pinned = PINNED.iter().find(|(of, _)| *of == row).map_or(Found::NOTHING, |(_, numbers)| *numbers);
    *found == pinned
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_number_or_a_number_of_another_row_does_not_agree() {
        let row = (UNDER_LOSS, "every-complete", 3, 3);
        assert!(agrees(row, &losses(3, Some(6))));
        for other in [losses(2, Some(6)), losses(3, Some(5)), losses(3, None), margin(3, 6), Found::NOTHING] {
            assert!(!agrees(row, &other), "{other:?}");
        }
        assert!(!agrees((UNDER_LOSS, "every-complete", 3, 2), &losses(3, Some(6))));
        assert!(!agrees(("all-or-none", "default", 9, 0), &margin(1, 2)));
        assert!(agrees(("all-or-none", "default", 9, 0), &Found::NOTHING));
    }

    /// A couple's margin is pinned, too: a margin below the closed form is noticed if it is not the pinned one.
    #[test]
    fn the_margin_of_a_couple_is_written_down_too() {
        let row = (ACTIVE, "default, slow link and a copy", 2, ANY);
        assert!(agrees(row, &margin(0, 1)) && !agrees(row, &margin(1, 1)));
    }
}
