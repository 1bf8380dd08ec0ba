//! Tests of the checker's results for the protocol's claims, some of which are pinned.

use crate::support::worlds::{commands, endless, least_losses, literal, scenario, timed};
use imrs_model::worlds::Meeting;
use imrs_model::{Limits, Options, Outcome, Report, Silent, Verdict, Watch, claim_names, explore, verify};
use imrs_protocol::rules::{Confirmation, Rules};
use serde_json::Value;
use std::sync::LazyLock;

const RULES: [Confirmation; 4] =
    [Confirmation::None, Confirmation::FirstComplete, Confirmation::EveryComplete, Confirmation::PassOn];

/// The report on this claim, which two tests read.
static UNDER_LOSS: LazyLock<Report> = LazyLock::new(|| settle("rendezvous-under-loss"));

fn settle(claim: &str) -> Report {
    verify(&Options { full: false, claim: Some(claim.into()), jobs: 1, memory: 4 << 30 }, &Silent)
}

#[test]
fn losses_that_strand_a_member_rule_by_rule() {
    // For each confirmation rule, in the order of `RULES`, the least number of lost packets that strands a member.
    for (members, expected) in [(2, [1, 2, 2, 2]), (3, [1, 2, 3, 3])] {
        assert_eq!(RULES.map(|rule| least_losses(members, rule)), expected, "{members} members");
    }
}

#[test]
fn the_default_is_to_confirm_when_complete_and_it_matters() {
    assert_eq!(Rules::DEFAULT.confirmation, Confirmation::EveryComplete);
    for members in [2, 3] {
        let with = least_losses(members, Rules::DEFAULT.confirmation);
        let without = least_losses(members, Confirmation::None);
        assert!(without < with, "{members} members: {without} and {with}");
    }
    // The confirmation rule matters with retransmission, too: without a CONFIRM one loss lets a member give up although all
    // have arrived.
    let gives_up = |confirmation, loss| {
        let rules = Rules { confirmation, ..Rules::DEFAULT };
        let meeting = Meeting { rules, hurry: true, ..timed(2, Watch::GaveUpAfterAllArrived, loss, 3, 8) };
        explore(&scenario(&meeting), Limits::default(), None).violation.is_some()
    };
    assert!(gives_up(Confirmation::None, 1) && !gives_up(Rules::DEFAULT.confirmation, 1));
}

#[test]
fn counts_of_small_worlds() {
    let worlds = [
        (scenario(&endless(2, 1)), PINNED[0]),
        (scenario(&literal(3, Confirmation::EveryComplete, 2)), PINNED[1]),
        (scenario(&timed(2, Watch::AllOrNone, 1, 3, 5)), PINNED[2]),
        (commands(Watch::Resolves).scenario().expect("a sound declaration"), PINNED[3]),
    ];
    let counts = worlds.each_ref().map(|(scenario, _)| {
        let found = explore(scenario, Limits::default(), None);
        assert!(found.complete && found.violation.is_none());
        (found.states, found.transitions, found.depth)
    });
    assert_eq!(counts, worlds.map(|(_, pinned)| pinned));
}

/// Numbers of states and transitions, and the depth. They may change only if the protocol or a reduction changes.
const PINNED: [(u64, u64, u64); 4] = [(75, 172, 12), (280, 1142, 11), (622, 1105, 22), (3568, 7447, 22)];

/// The verdicts of the quick run on claims that need little time, computed once for all tests.
fn cheap() -> Vec<Verdict> {
    let others = ["pairing", "class-2-resolves", "no-stale-delivery", "at-most-once"];
    UNDER_LOSS
        .claims
        .iter()
        .cloned()
        .chain(others.into_iter().flat_map(|claim| settle(claim).claims))
        .collect()
}

#[test]
fn every_verdict_is_as_expected_and_every_failure_is_drawn() {
    let verdicts = cheap();
    let rules: Vec<_> =
        verdicts.iter().filter(|v| v.name == "rendezvous-under-loss" && v.parties == 3).collect();
    let names: Vec<_> = rules.iter().map(|v| v.rule.as_str()).collect();
    assert_eq!(names, ["no-confirmation", "first-complete", "every-complete", "pass-on"]);
    let losses: Vec<_> = rules.iter().filter_map(|v| v.found.least_losses_to_strand).collect();
    assert_eq!(losses, [1, 2, 3, 3]);
    for verdict in &verdicts {
        let what = format!("{} {} of {}", verdict.name, verdict.rule, verdict.parties);
        assert!(verdict.as_expected, "{what}");
        assert!(verdict.complete && verdict.states > 0 && verdict.transitions >= verdict.states, "{what}");
        assert_eq!(verdict.counterexample.is_some(), verdict.outcome == Outcome::Fails, "{what}");
        let Some(drawn) = &verdict.counterexample else { continue };
        let widest = drawn.chart.lines().map(|line| line.chars().count()).max();
        assert!(widest.is_some_and(|columns| columns <= 78), "{what}:\n{}", drawn.chart);
        assert!(!drawn.chart.contains('\u{1b}'));
        let cause = drawn.chart.rsplit("=> ").next().unwrap_or_default();
        let cause = cause.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(cause.len() > 10, "{what}: ends in {cause:?}");
        assert!(drawn.length >= 2 && drawn.steps.last() == Some(&format!("so {cause}")), "{what}");
    }
}

#[test]
fn the_report_has_the_fields_of_its_contract() {
    let report: Value = serde_json::to_value(&*UNDER_LOSS).expect("a report is plain data");
    assert_eq!(report["version"], 1);
    assert_eq!(report["cell"], Value::Null);
    let claims = report["claims"].as_array().expect("a list");
    assert_eq!(claims.len(), 8);
    for claim in claims {
        let texts = ["name", "rule", "about", "expect", "outcome"];
        let numbers = [
            "parties",
            "states",
            "transitions",
            "depth",
            "collision_probability",
            "seconds",
            "states_per_second",
        ];
        assert!(texts.iter().all(|field| claim[field].is_string()), "{claim}");
        assert!(numbers.iter().all(|field| claim[field].is_number()), "{claim}");
        assert!(["as_expected", "complete"].iter().all(|field| claim[field].is_boolean()), "{claim}");
        assert!(["loss", "dup", "crash"].iter().all(|field| claim["bounds"][field].is_u64()), "{claim}");
        for field in ["delay", "rounds"] {
            assert!(claim["bounds"].get(field).is_some(), "{field} in {claim}");
        }
        for field in ["least_losses_to_strand", "least_safe_margin", "bound_ticks"] {
            assert!(claim["found"].get(field).is_some(), "{field} in {claim}");
        }
        assert!(claim["counterexample"]["length"].is_u64() && claim["counterexample"]["steps"].is_array());
        assert_eq!((&claim["expect"], &claim["outcome"]), (&"fails".into(), &"fails".into()));
    }
}

#[test]
fn every_claim_of_this_slice_has_a_name() {
    let names = claim_names();
    for name in [
        "no-false-release",
        "rendezvous-under-loss",
        "pairing",
        "all-or-none",
        "they-meet-again",
        "no-stale-delivery",
        "class-2-resolves",
        "at-most-once",
        "no-global-clock",
    ] {
        assert!(names.contains(&name), "{name} is missing from {names:?}");
    }
}
