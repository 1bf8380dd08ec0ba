//! Building blocks of claims about `waitfor`: their scenarios, and how a claim is settled.

use super::{Claim, Settled, Work};
use crate::report::{Bounds, Outcome};
use crate::scenario::{Budget, Watch};
use crate::worlds::Meeting;
use imrs_protocol::rules::{Confirmation, Rules};

/// The longest link delay and the period of retransmissions in scenarios with time, in ticks.
pub(super) const DELAY: u8 = 1;
pub(super) const RESEND: u64 = 2;

/// A meeting in which time passes. Up to `losses` packets are lost, and the margin must cover them.
pub(super) fn timed(members: usize, watch: Watch, losses: u8, margin: u64, time_out: u64) -> Meeting {
    Meeting {
        time_out: Some(time_out),
        delay: Some(DELAY),
        resend: Some(RESEND),
        losses,
        margin: Some(margin),
        budget: Budget { loss: losses, dup: 0, crash: 0 },
        ..Meeting::new(members, watch)
    }
}

pub(super) fn bounds(meeting: &Meeting) -> Bounds {
    Bounds {
        loss: u32::from(meeting.budget.loss),
        dup: u32::from(meeting.budget.dup),
        delay: meeting.delay.map(u32::from),
        crash: u32::from(meeting.budget.crash),
        rounds: meeting.attempts.map(u32::from),
        time_out: meeting.time_out,
        resend: meeting.resend,
        margin: meeting.margin,
    }
}

/// Settles a claim by a single exploration.
pub(super) fn once(work: &mut Work<'_>, meeting: &Meeting) -> Settled {
    let (outcome, counterexample) = match meeting.scenario() {
        Ok(scenario) => work.judge(&scenario),
        Err(_) => (Outcome::Unknown, None),
    };
    Settled::new(outcome, bounds(meeting), counterexample)
}

pub(super) fn simple(
    (name, rule, about): (&'static str, &'static str, &'static str),
    expect: Outcome,
    smoke: bool,
    meeting: Meeting,
) -> Claim {
    let parties = u32::try_from(meeting.members).unwrap_or(0);
    let settle = move |work: &mut Work<'_>| {
        let settled = once(work, &meeting);
        let vacuous = expect == Outcome::Holds && says_of_releases(&meeting) && !releases(work, &meeting);
        Settled { sound: settled.sound && !vacuous, ..settled }
    };
    Claim { name, rule, parties, about, expect, smoke, settle: Box::new(settle) }
}

/// Whether a meeting's property speaks only of releases. Such a property would hold vacuously if no member were ever
/// released.
const fn says_of_releases(meeting: &Meeting) -> bool {
    matches!(meeting.watch, Watch::FalseRelease | Watch::Pairing | Watch::AllOrNone)
}

/// Whether a member can be released at all, without any fault.
pub(super) fn releases(work: &mut Work<'_>, meeting: &Meeting) -> bool {
    let reachable = Meeting { watch: Watch::Reachable, budget: Budget::default(), ..meeting.clone() };
    once(work, &reachable).outcome == Outcome::Fails
}

/// The claim about how many losses strand a member (leave it waiting after all have arrived) under a rule of confirmation.
pub(super) fn strand_claim(
    members: usize,
    rule: &'static str,
    confirmation: Confirmation,
    smoke: bool,
) -> Claim {
    Claim {
        name: "rendezvous-under-loss",
        rule,
        parties: u32::try_from(members).unwrap_or(0),
        about: "how many lost packets leave a member waiting though all have arrived (§4.3)",
        expect: Outcome::Fails,
        smoke,
        settle: Box::new(move |work| strand(work, members, confirmation)),
    }
}

/// Searches for the fewest losses that strand a member: without and with retransmission.
fn strand(work: &mut Work<'_>, members: usize, confirmation: Confirmation) -> Settled {
    let rules = Rules { confirmation, answer_late_arrivals: false, ..Rules::DEFAULT };
    let literal = Meeting { rules, ..Meeting::new(members, Watch::Stranded) };
    let (settled, least) = least_losses(work, &literal, 12);
    let mut settled = settled;
    settled.found.least_losses_to_strand = least;
    if members <= 3 {
        let rules = Rules { confirmation, ..Rules::DEFAULT };
        let margin = u64::from(DELAY) + RESEND;
        let again =
            Meeting { rules, hurry: true, ..timed(members, Watch::GaveUpAfterAllArrived, 1, margin, 8) };
        settled.found.least_losses_with_resending = least_losses(work, &again, 12).1;
    }
    settled.sound &= least.is_some();
    settled
}

fn least_losses(work: &mut Work<'_>, meeting: &Meeting, most: u8) -> (Settled, Option<u32>) {
    let mut last = None;
    for loss in 0..=most {
        let meeting = Meeting { budget: Budget { loss, ..meeting.budget }, ..*meeting };
        let settled = once(work, &meeting);
        if settled.outcome != Outcome::Holds {
            let least = (settled.outcome == Outcome::Fails).then_some(u32::from(loss));
            return (settled, least);
        }
        last = Some(settled);
    }
    (last.unwrap_or_else(|| Settled::unsettled(bounds(meeting))), None)
}
