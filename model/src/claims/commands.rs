//! Claims about messages: TTL, outcomes, duplicates, clocks (§3, §5.1; D5, D6, D18, D20, D37, D49, D52).

use super::exchange::{claim, commands, settle};
use super::timing::off;
use super::{Claim, Settled, Work};
use crate::report::Outcome;
use crate::scenario::{Budget, Watch};
use crate::worlds::Exchange;
use imrs_protocol::rules::{Memory, Rules, TimeStamp};

pub(super) fn claims() -> Vec<Claim> {
    let mut claims = no_stale_delivery();
    claims.extend(off("no-stale-delivery"));
    claims.extend(resolves());
    claims.extend(off("class-2-resolves"));
    claims.extend(at_most_once());
    claims.extend(off("at-most-once"));
    claims.extend(no_global_clock());
    claims
}

fn statuses() -> Exchange {
    Exchange { command: false, retry: (0, 0), sends: 3, ..commands(Watch::Stale) }
}

fn larger(exchange: &Exchange) -> Exchange {
    Exchange {
        time_out: 8,
        delay: 2,
        retry: if exchange.command { (2, 2) } else { (0, 0) },
        sends: 3,
        budget: Budget { loss: 2, dup: 2, crash: exchange.budget.crash },
        ..exchange.clone()
    }
}

fn no_stale_delivery() -> Vec<Claim> {
    let name = "no-stale-delivery";
    let about = "no message is handed over after its sender's time_out";
    let uncharged = Rules { charge_residence: false, ..Rules::DEFAULT };
    let command = commands(Watch::Stale);
    vec![
        claim((name, "default", about), Outcome::Holds, true, vec![command.clone(), statuses()]),
        claim((name, "default", about), Outcome::Holds, false, vec![larger(&command), larger(&statuses())]),
        claim(
            (
                name,
                "residence-not-charged",
                "time spent in a buffer must be charged to a message's remaining time (§5.1.1)",
            ),
            Outcome::Fails,
            true,
            vec![Exchange { rules: uncharged, ..command }],
        ),
        claim(
            (name, "residence-not-charged, class 1", "the same for status messages"),
            Outcome::Fails,
            true,
            vec![Exchange { rules: uncharged, ..statuses() }],
        ),
    ]
}

fn resolves() -> Vec<Claim> {
    let name = "class-2-resolves";
    let about =
        "every command ends in exactly one outcome within time_out + 1 tick, and no answer is mixed up";
    let command = commands(Watch::Resolves);
    let late = Rules { refuse_late_replies: false, reserve_way_back: false, ..Rules::DEFAULT };
    let unreserved = Rules { reserve_way_back: false, ..Rules::DEFAULT };
    vec![
        claim((name, "default", about), Outcome::Holds, true, vec![command.clone()]),
        claim((name, "default", about), Outcome::Holds, false, vec![larger(&command)]),
        claim(
            (name, "late-reply-accepted", "a reply taken after the time_out ends a command twice"),
            Outcome::Fails,
            true,
            vec![Exchange { rules: late, watch: Watch::ResolvesOnce, ..command.clone() }],
        ),
        claim(
            (
                name,
                "way-back-not-reserved",
                "an answer in time at the receiver comes too late at the sender (D18)",
            ),
            Outcome::Fails,
            true,
            vec![Exchange { rules: unreserved, ..command }],
        ),
    ]
}

fn at_most_once() -> Vec<Claim> {
    let name = "at-most-once";
    let about = "one execution per command under duplication, re-sending and a restart";
    let crash = Exchange { budget: Budget { loss: 1, dup: 1, crash: 1 }, ..commands(Watch::AtMostOnce) };
    let calm = larger(&Exchange { budget: Budget::default(), ..crash });
    let shaken = Exchange { budget: crash.budget, sends: 2, ..larger(&crash) };
    let variant = |rules| vec![Exchange { rules, ..crash.clone() }];
    let forgetful = Rules { memory: Memory::None, ..Rules::DEFAULT };
    let short = Rules { memory: Memory::UntilAnswered, ..Rules::DEFAULT };
    let eager = Rules { quarantine: false, ..Rules::DEFAULT };
    vec![
        claim((name, "default", about), Outcome::Holds, true, vec![crash.clone()]),
        // A restart multiplies the states. So the larger scenario has one fault of each kind if nodes may restart, and two
        // of each if they may not.
        claim((name, "default", about), Outcome::Holds, false, vec![calm, shaken]),
        claim(
            (name, "no-memory", "without memory a copy runs again (D6)"),
            Outcome::Fails,
            true,
            variant(forgetful),
        ),
        claim(
            (name, "forgotten-when-answered", "a copy that arrives after the answer runs again (D52)"),
            Outcome::Fails,
            true,
            variant(short),
        ),
        claim(
            (name, "no-quarantine", "a restarted node cannot know what it ran (D49)"),
            Outcome::Fails,
            true,
            variant(eager),
        ),
        claim(
            (
                name,
                "sequence-wrap",
                "numbers that repeat while a copy has time left: the copy runs as a new command (D53)",
            ),
            Outcome::Fails,
            true,
            vec![Exchange { wrap: Some(2), sends: 3, ..commands(Watch::AtMostOnce) }],
        ),
    ]
}

fn no_global_clock() -> Vec<Claim> {
    let name = "no-global-clock";
    let offsets = [(0, 0), (3, 0), (0, 3), (200, 7)];
    let worlds = |rules: Rules| -> Vec<Exchange> {
        let watches = [Watch::Stale, Watch::Resolves];
        let pairs = offsets.into_iter().flat_map(|clocks| watches.map(|watch| (clocks, watch)));
        pairs.map(|(clocks, watch)| Exchange { rules, clocks, ..commands(watch) }).collect()
    };
    let absolute = worlds(Rules { time_stamp: TimeStamp::Absolute, ..Rules::DEFAULT });
    let same_states = worlds(Rules::DEFAULT);
    vec![
        Claim {
            name,
            rule: "default",
            parties: 2,
            about: "however far apart the nodes' clocks are, every verdict and every state stays the same (§5.1)",
            expect: Outcome::Holds,
            smoke: true,
            settle: Box::new(move |work| equal_states(work, &same_states)),
        },
        Claim {
            name,
            rule: "absolute-timestamps",
            parties: 2,
            about: "a deadline as an instant of the sender's clock revives expired messages (D37)",
            expect: Outcome::Fails,
            smoke: true,
            settle: Box::new(move |work| only_apart(work, &absolute)),
        },
    ]
}

/// Settles a claim that depends on the clocks: every scenario must hold if the clocks are equal, so that a failure with
/// unequal clocks is due to the clocks.
fn only_apart(work: &mut Work<'_>, worlds: &[Exchange]) -> Settled {
    let (together, apart): (Vec<_>, Vec<_>) = worlds.iter().cloned().partition(|e| e.clocks.0 == e.clocks.1);
    let equal = settle(work, &together).outcome == Outcome::Holds;
    let settled = settle(work, &apart);
    Settled { sound: settled.sound && equal, ..settled }
}

/// Settles a claim for which every scenario must hold, and scenarios that differ only in their clocks must have the same
/// number of states.
fn equal_states(work: &mut Work<'_>, worlds: &[Exchange]) -> Settled {
    let mut settled = settle(work, worlds);
    let mut counts: Vec<(Watch, u64, u64)> = Vec::new();
    for exchange in worlds {
        let Ok(scenario) = exchange.scenario() else { continue };
        let found = work.explore(&scenario);
        let alike = counts.iter().filter(|(watch, ..)| *watch == exchange.watch);
        settled.sound &= alike.into_iter().all(|&(_, s, t)| (s, t) == (found.states, found.transitions));
        counts.push((exchange.watch, found.states, found.transitions));
    }
    settled
}
