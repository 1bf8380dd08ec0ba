//! Claims about whole nodes: relays, buffers, the Timer, `order` and the time penalty (§4.2, §5.1; D15, D19, D20, D22,
//! D58 to D60).

use super::{Claim, Settled, Work};
use crate::cell_state::plan::{CellProperty, CellScenario, Faults, Goal};
use crate::cell_state::worlds::{Relay, busy_neighbour, delays, full_buffers};
use crate::report::{Bounds, Outcome};
use imrs_protocol::CellError;
use imrs_protocol::rules::{Eviction, JobRequest, Memory, Rules};
use std::sync::Arc;

pub(super) type Plan = Result<Arc<CellScenario>, Vec<CellError>>;

/// A scenario to explore, and whether its search must find a violation.
pub(super) struct Part {
    plan: Box<dyn Fn() -> Plan + Send + Sync>,
    /// Whether the search must find a violation. Such a part shows that the other parts do not hold vacuously.
    reached: bool,
}

pub(super) fn claims() -> Vec<Claim> {
    let mut claims = eviction();
    claims.extend(relays());
    claims.extend(nothing_waits_for_ever());
    claims.extend(no_global_clock());
    claims
}

pub(super) fn holds(plan: impl Fn() -> Plan + Send + Sync + 'static) -> Part {
    Part { plan: Box::new(plan), reached: false }
}

pub(super) fn reaches(plan: impl Fn() -> Plan + Send + Sync + 'static) -> Part {
    Part { plan: Box::new(plan), reached: true }
}

fn relay(relay: Relay) -> Part {
    holds(move || relay.plan())
}

/// A claim that holds if all parts hold. In parts that must find a violation, the violation is expected.
pub(super) fn claim(
    (name, rule, about): (&'static str, &'static str, &'static str),
    expect: Outcome,
    smoke: bool,
    parts: Vec<Part>,
) -> Claim {
    let parties = parts.first().and_then(|part| (part.plan)().ok()).map_or(0, |plan| plan.tasks.len());
    let parties = u32::try_from(parties).unwrap_or(u32::MAX);
    Claim { name, rule, parties, about, expect, smoke, settle: Box::new(move |work| settle(work, &parts)) }
}

/// Explores the scenarios of a claim until one of them fails.
pub(super) fn settle(work: &mut Work<'_>, parts: &[Part]) -> Settled {
    let mut settled = Settled::new(Outcome::Unknown, Bounds::default(), None);
    for part in parts {
        let Ok(plan) = (part.plan)() else {
            return Settled { outcome: Outcome::Unknown, sound: false, ..settled };
        };
        let (outcome, counterexample) = work.judge_cell_state(&plan);
        if part.reached {
            settled.sound &= outcome == Outcome::Fails;
            continue;
        }
        settled.bounds = bounds(&plan);
        (settled.outcome, settled.counterexample) = (outcome, counterexample);
        if outcome != Outcome::Holds {
            break;
        }
    }
    settled
}

/// Explores one scenario.
pub(super) fn settle_plan(work: &mut Work<'_>, plan: Plan) -> Settled {
    let Ok(plan) = plan else {
        return Settled::unsettled(Bounds::default());
    };
    let (outcome, counterexample) = work.judge_cell_state(&plan);
    Settled::new(outcome, bounds(&plan), counterexample)
}

pub(super) fn bounds(plan: &CellScenario) -> Bounds {
    let ports = plan.cell.ports();
    let delay = plan.links().iter().map(|&(.., bound)| u32::from(bound)).max();
    Bounds {
        loss: u32::from(plan.faults.loss),
        dup: u32::from(plan.faults.dup),
        delay,
        crash: u32::from(plan.faults.crash),
        rounds: None,
        time_out: ports.iter().map(|port| port.decl.time_out.0).max(),
        resend: ports.iter().filter(|port| port.decl.retry > 0).map(|port| port.decl.resend.0).min(),
        margin: None,
    }
}

fn eviction() -> Vec<Claim> {
    let name = "eviction";
    let about =
        "no command that can still arrive is dropped for space while its buffer holds a status message (D60)";
    let small = Relay {
        room: Some(1),
        time_out: (6, 4),
        transit: 1,
        sends: (1, 2),
        watches: vec![CellProperty::Eviction],
        ..Relay::default()
    };
    let large = Relay { transit: 2, sends: (2, 3), ..small.clone() };
    let by_time = Relay { rules: Rules { eviction: Eviction::ByTime, ..Rules::DEFAULT }, ..small.clone() };
    vec![
        claim((name, "default", about), Outcome::Holds, true, vec![relay(small)]),
        claim((name, "default", about), Outcome::Holds, false, vec![relay(large)]),
        claim(
            (name, "by-time-only", "the packet with most time left is dropped, whatever its class (§III)"),
            Outcome::Fails,
            true,
            vec![relay(by_time)],
        ),
    ]
}

/// The claims about messages that pass a relay whose buffer fills and whose links take one packet a tick.
fn relays() -> Vec<Claim> {
    let watches = [
        ("no-stale-delivery", CellProperty::Stale { slack: 0 }),
        ("class-2-resolves", CellProperty::Waits { slack: 0 }),
        ("at-most-once", CellProperty::AtMostOnce),
    ];
    let small = Relay { room: Some(1), faults: Faults { loss: 1, ..Faults::default() }, ..Relay::default() };
    let large = Relay {
        time_out: (7, 7),
        retry: (1, 3),
        commands: true,
        faults: Faults { loss: 2, ..Faults::default() },
        ..small.clone()
    };
    let about = "the same over a relay that holds two packets and passes one on in a tick";
    let mut claims = Vec::new();
    for (name, watch) in watches {
        let with = |relay_plan: &Relay| Relay { watches: vec![watch], ..relay_plan.clone() };
        claims.push(claim((name, "default, relay", about), Outcome::Holds, true, vec![relay(with(&small))]));
        claims.push(claim((name, "default, relay", about), Outcome::Holds, false, vec![relay(with(&large))]));
    }
    let refused = Relay {
        room: Some(1),
        transit: 1,
        commands: true,
        watches: vec![CellProperty::Reach(Goal::RefusedOnTheWay)],
        ..Relay::default()
    };
    let reached = refused.clone();
    let resolved = Relay { watches: vec![CellProperty::Waits { slack: 0 }], ..refused };
    claims.push(claim(
        (
            "class-2-resolves",
            "default, refused on the way",
            "a full relay's refusal reaches the source, and every command still ends once (D19, D66)",
        ),
        Outcome::Holds,
        true,
        vec![reaches(move || reached.plan()), relay(resolved)],
    ));
    claims.extend(copies());
    claims.push(did_not_run());
    let doubled = Relay {
        sends: (0, 3),
        faults: Faults { dup: 2, ..Faults::default() },
        watches: vec![CellProperty::AtMostOnce],
        ..Relay::default()
    };
    claims.push(claim(
        (
            "at-most-once",
            "default, relay, class 1",
            "a status is delivered at most once, though links double it",
        ),
        Outcome::Holds,
        true,
        vec![relay(doubled)],
    ));
    let forgetful = Relay {
        rules: Rules { memory: Memory::None, ..Rules::DEFAULT },
        faults: Faults { dup: 1, ..Faults::default() },
        watches: vec![CellProperty::AtMostOnce],
        ..Relay::default()
    };
    claims.push(claim(
        ("at-most-once", "no-memory, relay", "a copy made on a link behind the relay runs again (D6)"),
        Outcome::Fails,
        true,
        vec![relay(forgetful)],
    ));
    claims
}

/// The claim about what senders learn of commands that did not run: a full buffer refuses or holds them, or one copy is
/// refused while another copy runs.
fn did_not_run() -> Claim {
    let about = "a command that is reported as refused or never sent has not run and does not run later";
    let copies = Relay {
        room: Some(1),
        transit: 1,
        commands: true,
        retry: (1, 2),
        watches: vec![CellProperty::DidNotRun],
        ..Relay::default()
    };
    let parts = vec![
        reaches(|| full_buffers(1, CellProperty::Reach(Goal::Refused))),
        reaches(|| full_buffers(1, CellProperty::Reach(Goal::Unsent))),
        holds(|| full_buffers(1, CellProperty::DidNotRun)),
        relay(copies),
    ];
    claim(("at-most-once", "default, told that it did not run", about), Outcome::Holds, true, parts)
}

/// Claims about copies of messages. Worlds with one task per node cannot show them: there, packets that the task would
/// ignore are dropped, and only receivers crash.
fn copies() -> Vec<Claim> {
    let twice =
        |faults, watch| relay(Relay { sends: (2, 0), faults, watches: vec![watch], ..Relay::default() });
    let dup = Faults { dup: 1, ..Faults::default() };
    vec![
        claim(
            (
                "class-2-resolves",
                "default, relay, copies",
                "an answer that arrives twice ends only the command that it answers (D12)",
            ),
            Outcome::Holds,
            true,
            vec![twice(dup, CellProperty::Waits { slack: 0 })],
        ),
        claim(
            (
                "at-most-once",
                "default, relay, restart",
                "a command of an earlier incarnation of its source does not run after one of the present incarnation (D49)",
            ),
            Outcome::Holds,
            true,
            vec![twice(Faults { crash: 1, ..dup }, CellProperty::AtMostOnce)],
        ),
    ]
}

fn nothing_waits_for_ever() -> Vec<Claim> {
    let name = "nothing-waits-for-ever";
    let about = "every wait ends by its time_out, no delay ends early, and a tick holds few steps, even with a busy neighbour or full buffers";
    let blocking = Rules { job_request: JobRequest::Blocking, ..Rules::DEFAULT };
    let full = || full_buffers(1, CellProperty::Waits { slack: 0 });
    let stuck = || full_buffers(1, CellProperty::Reach(Goal::BuffersFull));
    vec![
        claim(
            (name, "default, whole nodes", about),
            Outcome::Holds,
            true,
            vec![
                reaches(stuck),
                holds(|| busy_neighbour(Rules::DEFAULT)),
                holds(|| delays([4, 2])),
                holds(full),
            ],
        ),
        claim(
            (
                name,
                "blocking-job-request",
                "a Timer that waits for a busy task stops the CLICKs of its node (D22)",
            ),
            Outcome::Fails,
            true,
            vec![holds(move || busy_neighbour(blocking))],
        ),
    ]
}

fn no_global_clock() -> Vec<Claim> {
    let offsets = [[0, 0, 0], [0, 3, 0], [200, 7, 99]];
    let faults = Faults { drift: 1, loss: 1, ..Faults::default() };
    // A node that missed a tick may hand over a message one tick late. A wait may always last one tick too long.
    let watches = vec![CellProperty::Stale { slack: 1 }, CellProperty::Waits { slack: 0 }];
    let cell_states: Vec<Relay> = offsets
        .into_iter()
        .map(|clocks| Relay {
            clocks,
            faults,
            time_out: (5, 3),
            watches: watches.clone(),
            ..Relay::default()
        })
        .collect();
    vec![Claim {
        name: "no-global-clock",
        rule: "default, relay and drift",
        parties: 3,
        about: "clocks apart change no state; one that misses or doubles a tick costs no more than that tick",
        expect: Outcome::Holds,
        smoke: true,
        settle: Box::new(move |work| equal_states(work, &cell_states)),
    }]
}

/// Settles a claim for which every scenario must hold, and all scenarios must have the same number of states.
fn equal_states(work: &mut Work<'_>, cell_states: &[Relay]) -> Settled {
    let mut counts = Vec::new();
    let mut last = settle(work, &[]);
    for cell_state in cell_states {
        let before = work.states();
        last = settle(work, &[relay(cell_state.clone())]);
        counts.push(work.states() - before);
        if last.outcome != Outcome::Holds {
            return last;
        }
    }
    last.sound &= counts.windows(2).all(|pair| pair[0] == pair[1]);
    last
}
