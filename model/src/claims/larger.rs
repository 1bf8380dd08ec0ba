//! Larger scenarios of the claims about `waitfor`: two members with their largest bounds, three and four with faults,
//! and five. If a scenario with all faults at once is too large, several rows share the faults, or all members reach
//! the waitfor at once.

use super::Claim;
use super::margins::{Search, TimeOuts};
use super::meeting::{simple, strand_claim, timed};
use crate::report::Outcome;
use crate::scenario::{Budget, Watch};
use crate::worlds::Meeting;
use imrs_protocol::rules::{Confirmation, Rules};

/// The rows (rule, members and bounds) of a claim that only the full run explores. They are listed after the claim's
/// other rows.
pub(super) fn larger(name: &'static str) -> Vec<Claim> {
    match name {
        "no-false-release" => no_false_release(),
        "rendezvous-under-loss" => rendezvous_under_loss(),
        "pairing" => pairing(),
        "all-or-none" => all_or_none(),
        _ => Vec::new(),
    }
}

const fn faults(loss: u8, dup: u8, crash: u8) -> Budget {
    Budget { loss, dup, crash }
}

fn no_false_release() -> Vec<Claim> {
    let row =
        |rule, about, meeting| simple(("no-false-release", rule, about), Outcome::Holds, false, meeting);
    let together =
        "no member is released early if all reach the waitfor at once, and again at once after a restart";
    let again =
        |members, time_out, budget| Meeting { budget, ..timed(members, Watch::FalseRelease, 1, 3, time_out) };
    // Meetings with the least margin, which covers no lost packet.
    let least =
        |members, time_out, budget| Meeting { budget, ..timed(members, Watch::FalseRelease, 0, 1, time_out) };
    let once =
        |members, budget| Meeting { resend: None, budget, ..timed(members, Watch::FalseRelease, 0, 1, 3) };
    let eager = Rules { quarantine: false, ..Rules::DEFAULT };
    let at_once = |meeting: Meeting| Meeting { hurry: true, ..meeting };
    let five = "five members, nothing lost, packets in any order";
    vec![
        row(
            "default, more faults",
            "three members that reach the waitfor at any time",
            again(3, 5, faults(2, 1, 0)),
        ),
        row("default, at once", together, at_once(again(3, 5, faults(2, 1, 0)))),
        row("default, at once", together, at_once(again(3, 6, faults(2, 1, 0)))),
        row("default, restart, at once", together, at_once(once(3, faults(2, 1, 1)))),
        row("default, restart, at once", together, at_once(least(3, 4, faults(2, 1, 1)))),
        row("default, restart, at once", together, at_once(again(3, 6, faults(2, 1, 1)))),
        simple(
            ("no-false-release", "no-quarantine, at once", "three members, one of which starts again (D49)"),
            Outcome::Fails,
            false,
            at_once(Meeting { attempts: Some(2), rules: eager, ..once(3, faults(0, 0, 1)) }),
        ),
        row("default, at once", together, at_once(once(4, faults(1, 0, 0)))),
        row("default, at once", together, at_once(again(4, 6, faults(1, 0, 0)))),
        row("default", five, Meeting::new(5, Watch::FalseRelease)),
    ]
}

fn rendezvous_under_loss() -> Vec<Claim> {
    let name = "rendezvous-under-loss";
    // With five members only `no-confirmation` is searched with losses. The other rules fail only after more losses, and
    // with so many losses five members have too many states.
    let about = "five members with nothing lost: no member waits after all have arrived";
    let lossless = Meeting::new(5, Watch::Stranded);
    vec![
        strand_claim(5, "no-confirmation", Confirmation::None, false),
        simple((name, "every-complete", about), Outcome::Holds, false, lossless),
    ]
}

fn pairing() -> Vec<Claim> {
    let row = |rule, about, meeting| simple(("pairing", rule, about), Outcome::Holds, false, meeting);
    let about =
        "with re-sending and give-ups, while losses keep to the margin, every k-th release is the same round";
    let late = "with re-sending, where all reach the waitfor at once and wait longer than the losses cost";
    let patient = |members, loss, dup, margin, time_out, attempts| Meeting {
        attempts: Some(attempts),
        budget: faults(loss, dup, 0),
        ..timed(members, Watch::Pairing, loss, margin, time_out)
    };
    let together = Meeting { attempts: None, hurry: true, ..patient(3, 1, 0, 3, 8, 1) };
    vec![
        row("default, re-sending", about, patient(2, 1, 1, 3, 8, 3)),
        row("default, re-sending", about, patient(2, 3, 2, 7, 10, 2)),
        row("default, re-sending, at once", late, together),
    ]
}

fn all_or_none() -> Vec<Claim> {
    let search = |members, losses, dup, time_outs| Search { dup, time_outs, ..Search::of(members, losses) };
    let apart = "four members that arrive at any time: without a margin one runs while another has given up";
    let less = Meeting { resend: None, ..timed(4, Watch::AllOrNone, 0, 0, 2) };
    let about =
        "four members at once, every packet sent once, nothing lost, with the margin of fewer members";
    let four = Meeting { resend: None, hurry: true, ..timed(4, Watch::AllOrNone, 0, 1, 3) };
    vec![
        simple(("all-or-none", "default, at once", about), Outcome::Holds, false, four),
        // Members that reach the waitfor at once have the same deadline. So a margin that is too short shows only if
        // members come at any time.
        simple(("all-or-none", "margin-one-less", apart), Outcome::Fails, false, less),
        search(2, 3, 2, TimeOuts::Only(8)).claim("default, largest bounds", false),
        search(3, 0, 0, TimeOuts::Least { more: 1 }).claim("default, two time_outs", false),
        search(3, 1, 0, TimeOuts::Least { more: 1 }).claim("default, two time_outs", false),
    ]
}
