//! Claims about the order of service: interruption by rank (§4.2, D15, D16), the time penalty and aging (§5.1.1, D58,
//! D59).

use super::cell_states::{Part, claim, holds, reaches, settle};
use super::{Claim, Settled, Variant, Work};
use crate::cell_state::plan::{CellProperty, Faults, Goal};
use crate::cell_state::worlds::{Flood, Interrupted, Workshop, penalised, query_all, refused};
use crate::report::{Found, Outcome};
use imrs_protocol::rules::{Aging, Rules};

pub(super) fn claims() -> Vec<Claim> {
    let mut claims = query_order();
    claims.extend(query_sets());
    claims.extend(penalty_is_fair());
    claims.extend(literal_penalty());
    claims
}

const INTERRUPTED: Interrupted = Interrupted {
    time_out: 6,
    queries: 1,
    relay: false,
    faults: Faults { loss: 1, dup: 0, crash: 0, drift: 0, late: 0, over: 0 },
    rules: Rules::DEFAULT,
    watches: Vec::new(),
};

fn interrupted(plan: &Interrupted, watches: &[CellProperty]) -> Part {
    let plan = Interrupted { watches: watches.to_vec(), ..plan.clone() };
    holds(move || plan.plan())
}

fn query_order() -> Vec<Claim> {
    let name = "query-order";
    let about =
        "a handler runs only when it outranks; the interrupted thread resumes and gets its answer once";
    let watches = [CellProperty::Order, CellProperty::Waits { slack: 0 }];
    let nested = || Interrupted { watches: vec![CellProperty::Reach(Goal::Nested)], ..INTERRUPTED }.plan();
    let large = Interrupted {
        relay: true,
        time_out: 8,
        faults: Faults { loss: 2, ..INTERRUPTED.faults },
        ..INTERRUPTED
    };
    let careless = Interrupted { rules: Rules { obey_order: false, ..Rules::DEFAULT }, ..INTERRUPTED };
    vec![
        claim(
            (name, "default", about),
            Outcome::Holds,
            true,
            vec![reaches(nested), interrupted(&INTERRUPTED, &watches)],
        ),
        claim((name, "default, relay", about), Outcome::Holds, false, vec![interrupted(&large, &watches)]),
        claim(
            (name, "ignore-order", "every query interrupts at once: an urgent action waits for a lesser one"),
            Outcome::Fails,
            true,
            vec![interrupted(&careless, &watches)],
        ),
    ]
}

fn query_sets() -> Vec<Claim> {
    let about = "a query to all ends once, with a mark for each that was asked, whatever is lost (D12)";
    let faults = Faults { loss: 1, ..Faults::default() };
    let waits = move || query_all(faults, vec![CellProperty::Waits { slack: 0 }]);
    let once = move || query_all(faults, vec![CellProperty::AtMostOnce]);
    let all = move || query_all(faults, vec![CellProperty::Reach(Goal::AllAnswered)]);
    vec![
        claim(
            ("class-2-resolves", "default, query to all", about),
            Outcome::Holds,
            true,
            vec![reaches(all), holds(waits)],
        ),
        claim(
            ("at-most-once", "default, query to all", "no task that was asked runs the query twice"),
            Outcome::Holds,
            true,
            vec![holds(once)],
        ),
    ]
}

const FLOOD: Flood = Flood {
    flooded: 1,
    room: 1,
    urgent: 2,
    ttl: 20,
    buffer: 1,
    every: 20,
    service: 1,
    rules: Rules::DEFAULT,
    served: false,
};

const WORKSHOP: Workshop = Workshop {
    ttl: 20,
    every: 20,
    buffer: 1,
    rivals: 0,
    rank: 2,
    penalty: (2, false),
    service: 1,
    urgent: true,
    rules: Rules::DEFAULT,
    served: false,
};

fn flood(flood: Flood) -> Part {
    holds(move || flood.plan())
}

fn workshop(workshop: Workshop) -> Part {
    holds(move || workshop.plan())
}

fn penalty_is_fair() -> Vec<Claim> {
    let name = "penalty-is-fair";
    let passed = "a head is bypassed G + P - 1 times at most, a message is rejected R times at most (D58)";
    let rules = |aging| Rules { aging, ..Rules::DEFAULT };
    let literal = Workshop { penalty: (2, true), ..WORKSHOP };
    vec![
        claim((name, "default", passed), Outcome::Holds, true, vec![flood(FLOOD), workshop(WORKSHOP)]),
        claim(
            (name, "default, two floods", passed),
            Outcome::Holds,
            false,
            vec![flood(Flood { flooded: 2, ..FLOOD }), flood(Flood { flooded: 2, room: 2, ..FLOOD })],
        ),
        claim(
            (name, "default, buffers of two", passed),
            Outcome::Holds,
            true,
            vec![
                flood(Flood { room: 2, ..FLOOD }),
                flood(Flood { room: 2, buffer: 2, ..FLOOD }),
                workshop(Workshop { rivals: 1, urgent: false, ..WORKSHOP }),
            ],
        ),
        claim(
            (name, "default, buffers of three", passed),
            Outcome::Holds,
            false,
            vec![flood(Flood { room: 3, buffer: 3, ..FLOOD }), workshop(Workshop { buffer: 2, ..WORKSHOP })],
        ),
        claim(
            (name, "no-penalty", "without aging a message with much time left starves (R61)"),
            Outcome::Fails,
            true,
            vec![flood(Flood { flooded: 2, rules: rules(Aging::Off), ..FLOOD })],
        ),
        claim(
            (name, "literal-penalty", "a message whose time_out grows is rejected for ever (D4)"),
            Outcome::Fails,
            true,
            vec![workshop(literal)],
        ),
        claim(
            (name, "unbounded-rejection", "a rejection that does not raise the rank is repeated for ever"),
            Outcome::Fails,
            true,
            vec![workshop(Workshop { rules: rules(Aging::Unbounded), ..WORKSHOP })],
        ),
        served_claim("default, served by GETs", true, |ttl| Flood {
            ttl: ttl.into(),
            every: ttl,
            served: true,
            ..FLOOD
        }),
        served_claim("default, served by GETs, two floods", false, |ttl| Flood {
            flooded: 2,
            ttl: ttl.into(),
            every: ttl,
            served: true,
            ..FLOOD
        }),
        served_claim("default, served by a handler", true, |ttl| Workshop {
            ttl: ttl.into(),
            every: ttl,
            served: true,
            ..WORKSHOP
        }),
        served_claim("default, served by GETs, one ahead", true, |ttl| Flood {
            room: 2,
            buffer: 2,
            ttl: ttl.into(),
            every: ttl,
            served: true,
            ..FLOOD
        }),
        served_claim("default, served by GETs, two ahead", false, |ttl| Flood {
            room: 3,
            buffer: 3,
            ttl: ttl.into(),
            every: ttl,
            served: true,
            ..FLOOD
        }),
        served_claim("default, served by a handler, one ahead", true, |ttl| Workshop {
            buffer: 2,
            ttl: ttl.into(),
            every: ttl,
            served: true,
            ..WORKSHOP
        }),
        served_claim("default, served by a handler, a rival", false, |ttl| Workshop {
            rivals: 1,
            urgent: false,
            ttl: ttl.into(),
            every: ttl,
            served: true,
            ..WORKSHOP
        }),
    ]
}

/// Scenarios in which the TTL of the watched message can be set. `closed_form` computes a TTL that is long enough.
trait TtlPlan: Clone + Send + Sync + 'static {
    fn part(&self) -> Part;
    fn closed_form(&self) -> u64;
    fn tasks(&self) -> usize;
}

impl TtlPlan for Flood {
    fn part(&self) -> Part {
        flood(*self)
    }
    fn closed_form(&self) -> u64 {
        self.service().bound_by_gets().0
    }
    fn tasks(&self) -> usize {
        self.plan().map_or(0, |plan| plan.tasks.len())
    }
}

impl TtlPlan for Workshop {
    fn part(&self) -> Part {
        workshop(*self)
    }
    fn closed_form(&self) -> u64 {
        self.service().bound().0
    }
    fn tasks(&self) -> usize {
        self.plan().map_or(0, |plan| plan.tasks.len())
    }
}

/// The claim that a message is served if its TTL is that of the closed form. The search finds the least TTL that is served.
/// The variant that must fail has one tick less (D59).
fn served_claim<L: TtlPlan>(
    rule: &'static str,
    smoke: bool,
    with: impl Fn(u8) -> L + Send + Sync + 'static,
) -> Claim {
    Claim {
        name: "penalty-is-fair",
        rule,
        parties: u32::try_from(with(u8::MAX).tasks()).unwrap_or(0),
        about: "a message with a TTL of K ticks is served: K from the declaration, the least TTL found beside it (D59)",
        expect: Outcome::Holds,
        smoke,
        settle: Box::new(move |work| least_ttl(work, &with)),
    }
}

fn least_ttl<L: TtlPlan>(work: &mut Work<'_>, with: &impl Fn(u8) -> L) -> Settled {
    let closed = u8::try_from(with(1).closed_form()).unwrap_or(u8::MAX);
    let mut settled = settle(work, &[with(closed).part()]);
    // The search goes down from the closed form. The last TTL that holds is the least one, and the TTL below it gives the
    // counterexample.
    let mut least = closed;
    let mut below = None;
    while settled.outcome == Outcome::Holds && least > 1 {
        let (shorter, counts) = work.part(|work| settle(work, &[with(least - 1).part()]));
        if shorter.outcome != Outcome::Holds {
            below = Some((shorter, counts));
            break;
        }
        least -= 1;
    }
    settled.found = Found {
        bound_ticks: Some(u64::from(closed)),
        least_bound_ticks: Some(u64::from(least)),
        ..Found::default()
    };
    settled.sound &= below.is_some();
    settled.variant = below.map(|(settled, counts)| {
        Box::new(Variant {
            rule: "one-tick-less",
            about: "a TTL one tick shorter than the least one found",
            settled,
            counts,
        })
    });
    settled
}

fn literal_penalty() -> Vec<Claim> {
    let about = "a rejected message expires no later than its sender's wait: urgency, TTL and back-off are separate (D4)";
    let name = "no-stale-delivery";
    vec![
        claim((name, "default, time penalty", about), Outcome::Holds, true, vec![holds(|| penalised(false))]),
        claim(
            (
                name,
                "literal time_penalty",
                "the Appendix's `save` extends the TTL of a rejected message: it runs after its sender gave up (D4)",
            ),
            Outcome::Fails,
            true,
            vec![holds(|| penalised(true))],
        ),
        claim(
            (
                name,
                "default, refused",
                "a rejected message has no more time than its sender waits, and leaves its buffer by then",
            ),
            Outcome::Holds,
            true,
            vec![
                reaches(|| refused(PENALTY, Aging::Off, CellProperty::Reach(Goal::Left))),
                holds(|| refused(PENALTY, Aging::Off, CellProperty::TimeToLive)),
                holds(|| refused(PENALTY, Aging::Off, CellProperty::Expires)),
                holds(|| refused(PENALTY, Aging::Bounded, CellProperty::TimeToLive)),
                holds(|| refused(PENALTY, Aging::Bounded, CellProperty::Expires)),
            ],
        ),
        claim(
            (
                name,
                "literal time_penalty, time to live",
                "each rejection adds the penalty to a message's remaining time: soon it is more than its sender waits (D4)",
            ),
            Outcome::Fails,
            true,
            vec![holds(|| refused(LITERAL, Aging::Bounded, CellProperty::TimeToLive))],
        ),
        never_expires(),
    ]
}

/// The penalty and whether it is literal: then the same time is also added to the remaining time.
const PENALTY: (u64, bool) = (2, false);
const LITERAL: (u64, bool) = (PENALTY.0, true);

/// The claim about the literal penalty: it adds to a message's remaining time as much as each wait takes, so the message
/// neither expires nor is taken. The search covers the whole state space. A penalty of zero adds nothing.
fn never_expires() -> Claim {
    let about = "each rejection adds as much time as passes until the next offer: rejected again and again, a message never expires (D4)";
    let row = ("no-stale-delivery", "literal time_penalty, for ever", about);
    let explored = || holds(|| refused(LITERAL, Aging::Bounded, CellProperty::Expires));
    let never = || holds(|| refused(LITERAL, Aging::Bounded, CellProperty::Reach(Goal::Left)));
    let without = || holds(|| refused((0, true), Aging::Bounded, CellProperty::Expires));
    Claim {
        settle: Box::new(move |work| {
            let settled = settle(work, &[explored()]);
            let stays = settle(work, &[never()]).outcome == Outcome::Holds;
            let expires = settle(work, &[without()]).outcome == Outcome::Holds;
            Settled { sound: settled.sound && stays && expires, ..settled }
        }),
        ..claim(row, Outcome::Fails, true, vec![explored()])
    }
}
