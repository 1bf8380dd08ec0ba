//! Claims about `waitfor` (§4.3; D1 to D3, D54 to D56).

use super::larger::larger;
use super::margins::{Search, margins};
use super::meeting::{DELAY, RESEND, bounds, simple, strand_claim, timed};
use super::timing::off;
use super::{Claim, Settled, Work, outcome, unless_it_panics};
use crate::chart::draw;
use crate::report::{Found, Outcome};
use crate::scenario::{Budget, Timing, Watch};
use crate::worlds::Meeting;
use imrs_protocol::rules::{Confirmation, Rules};

const RULES: [(&str, Confirmation); 4] = [
    ("no-confirmation", Confirmation::None),
    ("first-complete", Confirmation::FirstComplete),
    ("every-complete", Confirmation::EveryComplete),
    ("pass-on", Confirmation::PassOn),
];

pub(super) fn claims() -> Vec<Claim> {
    let own = [
        ("no-false-release", no_false_release()),
        ("rendezvous-under-loss", rendezvous_under_loss()),
        ("pairing", pairing()),
        ("all-or-none", all_or_none()),
        ("they-meet-again", meet_again()),
    ];
    own.into_iter()
        .flat_map(|(name, claims)| claims.into_iter().chain(off(name)).chain(larger(name)))
        .collect()
}

fn no_false_release() -> Vec<Claim> {
    let name = "no-false-release";
    let about = "no member is released from a waitfor before all have arrived in its round";
    let faulty = Meeting {
        attempts: Some(3),
        budget: Budget { loss: 1, dup: 1, crash: 0 },
        ..timed(2, Watch::FalseRelease, 1, 3, 5)
    };
    let three = timed(3, Watch::FalseRelease, 1, 3, 6);
    let crash = Meeting {
        attempts: Some(2),
        budget: Budget { loss: 0, dup: 0, crash: 1 },
        resend: None,
        ..timed(2, Watch::FalseRelease, 0, 1, 3)
    };
    let crash_and_loss = Meeting {
        budget: Budget { loss: 1, dup: 0, crash: 1 },
        ..Meeting { attempts: Some(2), ..timed(2, Watch::FalseRelease, 1, 3, 5) }
    };
    let eager = Meeting { rules: Rules { quarantine: false, ..Rules::DEFAULT }, ..crash };
    let endless = Meeting { attempts: None, delay: Some(DELAY), ..Meeting::new(2, Watch::Pairing) };
    let unnumbered = Rules { rounds: false, ..Rules::DEFAULT };
    // The largest bounds of two members: three losses, two duplicates, a time_out of eight ticks.
    let worst = |attempts, crash| Meeting {
        attempts: Some(attempts),
        budget: Budget { loss: 3, dup: 2, crash },
        ..timed(2, Watch::FalseRelease, 3, 5, 8)
    };
    let once = |members, loss| Meeting {
        delay: Some(DELAY),
        budget: Budget { loss, dup: 0, crash: 0 },
        ..Meeting::new(members, Watch::FalseRelease)
    };
    let three_worse = Meeting { time_out: Some(5), ..three };
    let loss2 = Meeting { budget: Budget { loss: 3, dup: 2, crash: 0 }, ..faulty };
    let overtaking = Meeting { budget: Budget { loss: 1, dup: 1, crash: 0 }, ..three };
    vec![
        simple((name, "default", about), Outcome::Holds, true, faulty),
        simple((name, "default", about), Outcome::Holds, true, three),
        simple((name, "default, restart", about), Outcome::Holds, true, crash),
        simple((name, "default, restart", about), Outcome::Holds, false, crash_and_loss),
        simple((name, "default", about), Outcome::Holds, false, loss2),
        simple((name, "default", about), Outcome::Holds, false, overtaking),
        simple((name, "default", about), Outcome::Holds, true, worst(1, 0)),
        simple((name, "default", about), Outcome::Holds, false, worst(2, 0)),
        simple((name, "default, restart", about), Outcome::Holds, false, worst(1, 1)),
        simple((name, "default", about), Outcome::Holds, false, three_worse),
        simple((name, "default", about), Outcome::Holds, true, once(4, 1)),
        simple((name, "default", about), Outcome::Holds, false, once(4, 2)),
        simple(
            (
                name,
                "no-quarantine",
                "a restarted member must not take arrivals meant for its earlier incarnation (D49)",
            ),
            Outcome::Fails,
            true,
            eager,
        ),
        simple(
            (name, "no-round", "without round numbers a repeated waitfor fails even without losses (D3)"),
            Outcome::Fails,
            true,
            Meeting { rules: unnumbered, ..endless },
        ),
    ]
}

fn rendezvous_under_loss() -> Vec<Claim> {
    let sizes = [(2, true), (3, true), (4, false)];
    let table = sizes.into_iter().flat_map(|size| RULES.map(|rule| (size, rule)));
    table.map(|((members, smoke), (rule, rules))| strand_claim(members, rule, rules, smoke)).collect()
}

fn pairing() -> Vec<Claim> {
    let name = "pairing";
    let about =
        "without give-ups every member's k-th release is the same round, packets overtaking each other";
    let endless = |members| Meeting {
        attempts: None,
        delay: Some(DELAY),
        budget: Budget { loss: 1, dup: 0, crash: 0 },
        ..Meeting::new(members, Watch::Pairing)
    };
    let worst = Meeting { budget: Budget { loss: 3, dup: 2, crash: 0 }, resend: Some(RESEND), ..endless(2) };
    let silent = Rules { last_released: false, ..Rules::DEFAULT };
    let lossless = |members| Meeting { budget: Budget::default(), rules: silent, ..endless(members) };
    let variant = "without the round that its sender released last, an ARRIVE pairs different meetings (D54)";
    vec![
        simple((name, "default", about), Outcome::Holds, true, endless(2)),
        simple((name, "default", about), Outcome::Holds, true, endless(3)),
        simple((name, "default", about), Outcome::Holds, true, worst),
        simple((name, "no-last-released", variant), Outcome::Fails, true, lossless(2)),
        simple((name, "no-last-released", variant), Outcome::Fails, true, lossless(3)),
    ]
}

fn all_or_none() -> Vec<Claim> {
    let worlds = [(2, 0, true), (2, 1, true), (2, 2, true), (3, 0, true), (3, 1, true)];
    let claim = |(members, losses, smoke)| margins("default", members, losses, Timing::default(), smoke);
    let mut claims: Vec<Claim> = worlds.map(claim).into();
    let two = Search::of(2, 0);
    let unconfirmed = Rules { confirmation: Confirmation::None, ..Rules::DEFAULT };
    claims.extend([
        Search { rules: unconfirmed, ..two }.claim_none(
            "no-confirmation",
            "without a CONFIRM no margin is enough, even where nothing is lost: the member that hears of the others later may have no time left",
        ),
        Search { resend: None, ..two }.claim("default, sent once", true),
        Search { resend: None, losses: 1, ..two }.claim_none(
            "sent-once",
            "where every packet is sent once, one loss is more than any margin covers",
        ),
    ]);
    claims
}

fn meet_again() -> Vec<Claim> {
    let name = "they-meet-again";
    let search = |members: usize, loss: u8, smoke: bool| Claim {
        name,
        rule: "default",
        parties: u32::try_from(members).unwrap_or(0),
        about: "after the faults stop, the members meet within k attempts; k is searched for (D54)",
        expect: Outcome::Holds,
        smoke,
        settle: Box::new(move |work| attempts(work, members, loss)),
    };
    let counting = Rules { join_fresher: false, ..Rules::DEFAULT };
    let apart =
        Meeting { attempts: Some(2), rules: counting, ..timed(2, Watch::MeetAgain { attempts: 6 }, 1, 3, 5) };
    let short = Meeting { ..timed(3, Watch::MeetAgain { attempts: 2 }, 0, 1, 3) };
    vec![
        search(2, 1, true),
        search(3, 0, false),
        simple(
            (name, "counting-attempts", "members that only count their own attempts stay apart for ever"),
            Outcome::Fails,
            true,
            apart,
        ),
        simple(
            (
                name,
                "short-patience",
                "three members whose patience ends in turn stay within the margin for ever",
            ),
            Outcome::Fails,
            false,
            short,
        ),
    ]
}

/// A time_out with which members meet again, whenever each of them begins its attempts. With a shorter time_out, three
/// members could give up in turn for ever, because each finds the others within the margin of their deadlines.
const fn patience(members: usize, margin: u64) -> u64 {
    if members == 2 { margin + DELAY as u64 + 1 } else { 3 * (margin + DELAY as u64) }
}

fn attempts(work: &mut Work<'_>, members: usize, loss: u8) -> Settled {
    const MOST: u8 = 4;
    let first = if members == 2 { 2 } else { 1 };
    for attempts in 1..=MOST {
        let margin = u64::from(DELAY) + RESEND * u64::from(loss);
        let time_out = patience(members, margin);
        let meeting = Meeting {
            attempts: Some(first),
            ..timed(members, Watch::MeetAgain { attempts }, loss, margin, time_out)
        };
        let Ok(scenario) = meeting.scenario() else { break };
        let found = work.explore(&scenario);
        let outcome = outcome(&found);
        if outcome != Outcome::Fails || attempts == MOST {
            let chart = unless_it_panics(|| draw(&scenario, &found));
            let attempts = (outcome == Outcome::Holds).then_some(u32::from(attempts));
            let found = Found { attempts, ..Found::default() };
            return Settled { found, ..Settled::new(outcome, bounds(&meeting), chart) };
        }
    }
    let none = timed(members, Watch::MeetAgain { attempts: MOST }, loss, 0, 0);
    Settled::unsettled(bounds(&none))
}
