//! Claims about time: no task waits for ever (§5.1.2), and the claims that hold even if packets are charged more than they
//! take and timers fire late (D42, D56).

use super::Claim;
use super::exchange::{claim, commands as exchange_of};
use super::margins::margins;
use super::meeting::{simple, timed};
use crate::report::Outcome;
use crate::scenario::{Budget, Timing, Watch};
use crate::worlds::{Exchange, Meeting};

/// Deviations of time: any packet may be charged one tick more than the link's bound, and one timer may fire a tick late.
const OFF: Timing = Timing { overcharge: 1, late: 1 };
const RULE: &str = "default, late timer and charge";

/// The rows (rule, members and bounds) of a claim in which timers are late, packets are charged too much, or clocks
/// drift. They are listed after the claim's other rows.
pub(super) fn off(name: &'static str) -> Vec<Claim> {
    let budget = Budget { loss: 1, dup: 0, crash: 0 };
    let exchange = |watch, about| {
        let exchange = Exchange { timing: OFF, budget, ..exchange_of(watch) };
        claim((name, RULE, about), Outcome::Holds, true, vec![exchange])
    };
    match name {
        "no-false-release" => {
            let about = "no member is released early though links are charged more and a timer is late";
            let meeting =
                Meeting { timing: OFF, attempts: Some(2), ..timed(2, Watch::FalseRelease, 1, 3, 5) };
            vec![simple((name, RULE, about), Outcome::Holds, true, meeting)]
        }
        "all-or-none" => {
            let late = Timing { overcharge: 1, late: 2 };
            vec![
                margins(RULE, 2, 0, late, true),
                margins(RULE, 2, 1, late, true),
                margins(RULE, 3, 0, OFF, false),
            ]
        }
        "no-stale-delivery" => {
            let about = "no message is handed over late though links are charged more and a timer is late";
            vec![exchange(Watch::Stale, about)]
        }
        "class-2-resolves" => {
            let about = "every command ends within time_out + 1 tick and the lateness of its timer";
            vec![exchange(Watch::Resolves, about)]
        }
        "at-most-once" => {
            let about = "one execution per command though links are charged more and a timer is late";
            vec![exchange(Watch::AtMostOnce, about)]
        }
        _ => Vec::new(),
    }
}

pub(super) fn claims() -> Vec<Claim> {
    let name = "nothing-waits-for-ever";
    let about = "every wait ends by its time_out, no tick holds more steps than possible, no task is stuck";
    let two = Meeting {
        attempts: Some(2),
        budget: Budget { loss: 1, dup: 1, crash: 0 },
        ..timed(2, Watch::Waits, 1, 3, 5)
    };
    let crash = Meeting {
        attempts: Some(2),
        budget: Budget { loss: 0, dup: 0, crash: 1 },
        resend: None,
        ..timed(2, Watch::Waits, 0, 1, 3)
    };
    let three = timed(3, Watch::Waits, 0, 1, 3);
    let row = |rule| (name, rule, about);
    vec![
        simple(row("default"), Outcome::Holds, true, two.clone()),
        simple(
            row("default, late timer"),
            Outcome::Holds,
            true,
            Meeting { timing: OFF, attempts: Some(1), ..two },
        ),
        simple(row("default, restart"), Outcome::Holds, true, crash),
        simple(row("default"), Outcome::Holds, false, three),
        claim(row("default, commands"), Outcome::Holds, true, vec![exchange_of(Watch::Waits)]),
    ]
}
