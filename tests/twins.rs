//! Compares the Promela models of `specs/promela` with the checker. Each model is the twin of a claim of the checker: the two
//! tools have separate descriptions of the protocol, and must find the same verdicts and the same least numbers.

#[path = "../model/tests/support/spin.rs"]
mod spin;
mod verifier;

use crate::support::claims::settled;
use crate::support::{is_here, is_whole};
use imrs_model::worlds::{Exchange, Meeting};
use imrs_model::{Budget, Limits, Outcome, Reductions, Scenario, Watch, explore};
use imrs_protocol::rules::{Confirmation, Rules};
use std::collections::BTreeMap;
use std::sync::Arc;
use verifier::{OPTIMISED, Twin};

/// The rules for confirming a rendezvous. Each has its name in the checker's claims, in the state machine, and in the
/// Promela twin (D1).
const RULES: [(&str, Confirmation, &str); 4] = [
    ("no-confirmation", Confirmation::None, "NO_CONFIRMATION"),
    ("first-complete", Confirmation::FirstComplete, "FIRST_COMPLETE"),
    ("every-complete", Confirmation::EveryComplete, "EVERY_COMPLETE"),
    ("pass-on", Confirmation::PassOn, "PASS_ON"),
];

/// Whether SPIN is installed. If it is not, these tests print that they were skipped, or fail if `IMRS_REQUIRE_ALL=1` is set.
fn spin_is_here() -> bool {
    is_here(spin::missing(), "the Promela twins were NOT compared")
}

/// Whether SPIN finds that the property of a twin holds.
fn holds(model: &str, definitions: &[&str]) -> bool {
    Twin::new(model, definitions).verdict().holds
}

fn fails(scenario: &Arc<Scenario>) -> bool {
    let found = explore(scenario, Limits::default(), None);
    assert!(found.complete);
    found.violation.is_some()
}

/// Asserts that in the twin `least` lost packets can strand a member, and one packet less cannot. The budget of the
/// twin means "at most this many lost packets".
fn twin_strands_with(members: u32, rule: &str, least: u32) {
    let stranded = |losses: u32| {
        let definitions = [&format!("N={members}"), rule, &format!("LOSS={losses}"), "FORGET"];
        let twin = Twin::new("waitfor.pml", &definitions);
        let twin = if members > 3 { twin.compiled(OPTIMISED) } else { twin };
        !twin.verdict().holds
    };
    assert!(least > 0 && !stranded(least - 1), "{members} members, {rule}: less than {least} suffice");
    assert!(stranded(least), "{members} members, {rule}: {least} do not suffice");
}

#[test]
fn as_many_lost_packets_strand_a_member() {
    if !spin_is_here() {
        return;
    }
    let report = settled("rendezvous-under-loss");
    let mut compared = 0;
    for verdict in &report.claims {
        let (_, _, rule) = RULES.iter().find(|(name, ..)| *name == verdict.rule).expect("a rule of D1");
        let least = verdict.found.least_losses_to_strand.expect("a number that was found");
        twin_strands_with(verdict.parties, rule, least);
        compared += 1;
    }
    assert!(compared >= 8, "only {compared} verdicts");
}

#[test]
fn as_many_lost_packets_strand_one_of_four() {
    if !spin_is_here() {
        return;
    }
    for ((name, confirmation, rule), least) in RULES.into_iter().zip([1, 2, 4, 4]) {
        // Quick runs skip this rule. It takes as long as the rule `PassOn`, which every run checks.
        if confirmation == Confirmation::EveryComplete && !is_whole() {
            continue;
        }
        let rules = Rules { confirmation, answer_late_arrivals: false, ..Rules::DEFAULT };
        let strands = |loss| {
            let budget = Budget { loss, dup: 0, crash: 0 };
            let meeting = Meeting { rules, budget, ..Meeting::new(4, Watch::Stranded) };
            fails(&meeting.scenario().expect("a sound declaration"))
        };
        assert!(!strands(least - 1) && strands(least), "{name}");
        twin_strands_with(4, rule, u32::from(least));
    }
}

/// Tests that without reductions the twin and the checker's model have the same number of states.
#[test]
fn as_many_states_where_nothing_is_reduced() {
    if !spin_is_here() {
        return;
    }
    // Under the other rules, a state of the twin holds other facts than a state of the machine, so the numbers of
    // states differ.
    for ((_, confirmation, rule), loss) in [(RULES[0], 0), (RULES[2], 1), (RULES[2], 2)] {
        let rules = Rules { confirmation, answer_late_arrivals: false, ..Rules::DEFAULT };
        let budget = Budget { loss, dup: 0, crash: 0 };
        let reductions = Reductions::NONE;
        let meeting = Meeting { rules, budget, reductions, ..Meeting::new(3, Watch::Stranded) };
        let scenario = meeting.scenario().expect("a sound declaration");
        let found = explore(&scenario, Limits::default(), None);
        let twin = Twin::new("waitfor.pml", &["N=3", rule, &format!("LOSS={loss}")]).verdict();
        assert!(found.complete && found.violation.is_none() && twin.holds, "{rule}");
        assert_eq!(twin.states, found.states, "{rule}, {loss} losses");
    }
}

/// Tests that the reduction `FORGET` of the twin changes no verdict.
#[test]
fn what_the_twin_forgets_changes_nothing() {
    if !spin_is_here() {
        return;
    }
    for (_, _, rule) in &RULES[2..] {
        for (losses, expected) in [("LOSS=1", true), ("LOSS=3", false)] {
            for forget in [&[][..], &["FORGET"]] {
                let all = [&["N=3", rule, losses], forget].concat();
                assert_eq!(holds("waitfor.pml", &all), expected, "{all:?}");
            }
        }
    }
}

/// Tests members with time_outs and retransmissions. Both tools must give the same verdict for the least margin that is
/// safe, and for a margin one tick smaller.
#[test]
fn the_same_margin_keeps_all_or_none() {
    if !spin_is_here() {
        return;
    }
    let all = [(3, 1, true, 2), (2, 2, false, 4), (2, 1, false, 3), (3, 0, true, 1)];
    // Quick runs check only one case, because compiling a verifier takes much longer than running it.
    let some = if is_whole() { &all[..] } else { &all[..1] };
    for &(members, losses, hurry, least) in some {
        for margin in least - 1..=least {
            let time_out = margin + 2;
            let meeting = Meeting {
                time_out: Some(time_out),
                delay: Some(1),
                resend: Some(2),
                losses,
                margin: Some(margin),
                budget: Budget { loss: losses, dup: 0, crash: 0 },
                hurry,
                ..Meeting::new(members, Watch::AllOrNone)
            };
            let numbers = [
                format!("N={members}"),
                format!("T={time_out}"),
                format!("LOSS={losses}"),
                format!("COPIES={losses}"),
                format!("MARGIN={margin}"),
            ];
            let mut definitions: Vec<&str> = numbers.iter().map(String::as_str).collect();
            definitions.extend(["ROOM=20", "FORGET"]);
            definitions.extend(hurry.then_some("HURRY"));
            let twin = holds("meeting_timed.pml", &definitions);
            let what = format!("{members} members, {losses} losses, margin {margin}");
            assert_eq!(twin, !fails(&meeting.scenario().expect("a sound declaration")), "{what}");
            assert_eq!(twin, margin == least, "{what}");
        }
    }
}

#[test]
fn commands_are_handed_over_once() {
    if !spin_is_here() {
        return;
    }
    let twins: BTreeMap<&str, &[&str]> = BTreeMap::from([
        ("default", &[][..]),
        ("no-memory", &["NO_MEMORY"]),
        ("forgotten-when-answered", &["FORGET_WHEN_ANSWERED"]),
        ("no-quarantine", &["NO_QUARANTINE"]),
    ]);
    let report = settled("at-most-once");
    let mut compared = 0;
    for verdict in &report.claims {
        let Some(variant) = twins.get(verdict.rule.as_str()) else { continue };
        let bounds = verdict.bounds;
        let mut definitions = vec![
            format!("LOSS={}", bounds.loss),
            format!("DUP={}", bounds.dup),
            format!("CRASH={}", bounds.crash),
            format!("SENDS={}", bounds.rounds.expect("a number of sends")),
            "RETRY=1".to_owned(),
        ];
        definitions.extend(variant.iter().map(|&name| name.to_owned()));
        let definitions: Vec<&str> = definitions.iter().map(String::as_str).collect();
        let twin = if holds("command.pml", &definitions) { Outcome::Holds } else { Outcome::Fails };
        assert_eq!(twin, verdict.outcome, "{}", verdict.rule);
        compared += 1;
    }
    assert_eq!(compared, twins.len());
    // A receiver must keep the dedup entry of a command until no copy of an older command is in flight.
    assert!(!holds("command.pml", &["FORGET_OLDER"]));
}

/// Tests how many packets must be lost so that the sender of a single command gets no answer, if the receiver answers
/// at once.
#[test]
fn as_many_lost_packets_leave_a_command_without_its_answer() {
    if !spin_is_here() {
        return;
    }
    for retry in 0..=2 {
        let unanswered = |loss: &u8| {
            let budget = Budget { loss: *loss, dup: 0, crash: 0 };
            let exchange = Exchange {
                sends: 1,
                retry: (retry, 2),
                time_out: 8,
                budget,
                ..Exchange::new(Watch::Answered)
            };
            let mut scenario = Arc::unwrap_or_clone(exchange.scenario().expect("a sound declaration"));
            scenario.hurry = true;
            fails(&Arc::new(scenario))
        };
        let twin_answers = |losses: u8, prompt: &[&str]| {
            let all = [format!("RETRY={retry}"), "DUP=0".into(), format!("LOSS={losses}"), "SINGLE".into()];
            let all: Vec<&str> = all.iter().map(String::as_str).collect();
            holds("command.pml", &[&all[..], prompt].concat())
        };
        let least = (0..12).find(unanswered).expect("enough losses leave it without");
        assert_eq!(least, retry + 1, "each copy brings an answer of its own");
        assert!(twin_answers(least - 1, &["PROMPT"]) && !twin_answers(least, &["PROMPT"]));
        // The receiver does not answer a copy that arrives before its first answer. A slow receiver sends only one
        // answer, so a single lost packet suffices.
        if retry == 2 {
            assert!(twin_answers(0, &[]) && !twin_answers(1, &[]));
        }
    }
}

/// The numbers of a take-over: lease, link delay, heartbeat period and clock drift, all in ticks.
#[derive(Clone, Copy, Debug)]
struct TakeOver {
    lease: u32,
    delay: u32,
    every: u32,
    drift: u32,
}

impl TakeOver {
    fn holds(self, takeover: u32, more: &[&str]) -> bool {
        let numbers = [('L', self.lease), ('T', takeover), ('D', self.delay), ('E', self.every)]
            .map(|(n, v)| format!("{n}={v}"));
        let drift = format!("DRIFT={}", self.drift);
        let mut definitions: Vec<&str> = numbers.iter().map(String::as_str).collect();
        definitions.push(&drift);
        definitions.extend(more);
        holds("takeover.pml", &definitions)
    }

    /// The least time from the end of the lease to the take-over that is safe, according to the twin.
    fn least_margin(self) -> u32 {
        let least = (0..=self.lease).find(|margin| self.holds(self.lease + margin, &[])).expect("a margin");
        // All smaller margins have failed. If the margin 0 is safe, a take-over before the end of the lease must still
        // be unsafe.
        assert!(least > 0 || !self.holds(self.lease - 1, &[]), "{self:?}");
        least
    }
}

const TAKE_OVERS: [(TakeOver, u32); 2] = [
    (TakeOver { lease: 6, delay: 1, every: 2, drift: 1 }, 1),
    (TakeOver { lease: 8, delay: 2, every: 3, drift: 2 }, 2),
];

/// Tests that the least margin of the twin equals the clock drift, and that the link delay adds nothing to it.
#[test]
fn the_margin_of_the_take_over() {
    if !spin_is_here() {
        return;
    }
    for (world, margin) in TAKE_OVERS {
        assert_eq!(world.least_margin(), margin, "{world:?}");
    }
    // The checker finds the same least margin for the state machine, with the same bounds.
    let report = settled("one-active");
    for (rule, drift) in [("default", 0), ("default, drift", 1)] {
        let verdict = report.claims.iter().find(|v| v.rule == rule).expect("a verdict");
        let twin = TakeOver { lease: 8, delay: 1, every: 2, drift }.least_margin();
        assert_eq!(verdict.found.least_safe_margin, Some(u64::from(twin)), "{rule}");
    }
    // A model in which nothing happens would have the property, too. So leases must be renewed in this one, and the standby
    // must be able to take over.
    let (world, _) = TAKE_OVERS[1];
    for reachable in ["RENEWED", "TAKEN"] {
        assert!(!world.holds(world.lease + world.drift, &[reachable]), "{reachable}");
    }
}

#[test]
fn plain_heartbeats_let_both_be_active() {
    if !spin_is_here() {
        return;
    }
    for (world, _) in TAKE_OVERS {
        for takeover in [world.lease + world.drift, 4 * world.lease] {
            assert!(!world.holds(takeover, &["HEARTBEAT"]), "{world:?}, take-over {takeover}");
        }
    }
}

/// Tests the shortest lease that does not end while both tasks are connected and no packet is lost. After a round trip, the
/// next heartbeat echoes an answer. The echo after that comes one period later, and reaches the primary after one link delay.
#[test]
fn the_least_lease_that_lasts() {
    if !spin_is_here() {
        return;
    }
    for (delay, every) in [(1, 2), (2, 3), (2, 2)] {
        let periods = 2 * delay / every + 1;
        let least = (periods + 1) * every + delay + 1;
        let lasts = |lease| TakeOver { lease, delay, every, drift: 0 }.holds(3 * lease, &["STAYS", "LOSS=0"]);
        assert!(lasts(least) && !lasts(least - 1), "delay {delay}, every {every}: not {least}");
    }
}
