//! Claims about work-coupled tasks: at most one task of a couple acts, and no order of an older epoch runs (R8; D30, D61,
//! D78, D80).

use super::cell_states::{Plan, bounds, settle_plan};
use super::{Claim, Settled, Variant, Work};
use crate::cell_state::plan::{CellProperty, Faults, Goal};
use crate::cell_state::worlds::{Couple, Orders};
use crate::report::{Found, Outcome};
use imrs_protocol::Ticks;
use imrs_protocol::margin::takeover_margin;
use imrs_protocol::rules::LeaseRule;

const NAME: &str = "one-active";

/// A couple with any number of lost packets, packets that overtake each other, and a lease that outlasts two lost
/// heartbeats.
const COUPLE: Couple = Couple {
    delay: 1,
    lease: 8,
    takeover: 8,
    every: 2,
    mutual: false,
    rule: LeaseRule::Echoed,
    epoch: 0,
    faults: Faults { loss: u8::MAX, dup: 0, crash: 0, drift: 0, late: 0, over: 0 },
    watch: CellProperty::OneActive,
};

pub(super) fn claims() -> Vec<Claim> {
    let drift = |drift: u8| Couple { faults: Faults { drift, ..COUPLE.faults }, ..COUPLE };
    let late = |base: Couple| Couple { faults: Faults { late: 1, ..base.faults }, ..base };
    let crash =
        |base: Couple| Couple { faults: Faults { crash: base.faults.crash + 1, ..base.faults }, ..base };
    let copy = |base: Couple| Couple { faults: Faults { dup: 1, ..base.faults }, ..base };
    // The same couple with a longer heartbeat period. Its lease outlasts only one lost heartbeat, so fewer heartbeats are
    // in flight.
    let seldom = |base: Couple| Couple { every: 3, ..base };
    let slow = |base: Couple| Couple { delay: 2, lease: 14, takeover: 14, every: 5, ..base };
    // Each exchange of roles raises the epoch. With unlimited losses the number of epochs would have no limit.
    let mutual =
        |loss: u8, base: Couple| Couple { mutual: true, faults: Faults { loss, ..base.faults }, ..base };
    let mut claims = vec![
        least("default", true, drift(0)),
        least("default, drift", true, drift(1)),
        least("default, crash", true, seldom(crash(drift(0)))),
        least("default, two crashes", true, seldom(crash(crash(drift(0))))),
        least("default, crash and a copy", true, seldom(copy(crash(drift(0))))),
        least("default, slow link and a copy", true, slow(copy(drift(0)))),
        least("default, exchanged roles", true, mutual(4, drift(0))),
        least("default, drift and a late tick", false, seldom(late(drift(1)))),
        least("default, more drift", false, drift(2)),
        least("default, slow link and drift", false, slow(drift(1))),
        least("default, drift and crash", false, seldom(crash(drift(1)))),
        least("default, drift and a copy", false, seldom(copy(drift(1)))),
        least("default, exchanged roles, drift", false, seldom(mutual(4, drift(1)))),
        least("default, exchanged roles, crash", false, seldom(mutual(3, crash(drift(0))))),
        least("default, exchanged roles, a copy", false, seldom(mutual(3, copy(drift(0))))),
        heartbeat(),
        Claim {
            name: NAME,
            rule: "default, epochs that wrap",
            parties: 2,
            about: "the same states wherever epochs begin: they are only compared, across their wrap (D80)",
            expect: Outcome::Holds,
            smoke: true,
            settle: Box::new(move |work| {
                equal_states(work, |epoch| Couple { epoch, ..mutual(3, drift(0)) }.plan())
            }),
        },
        least("default, crash, epochs that wrap", true, Couple { epoch: WRAPS, ..seldom(crash(drift(0))) }),
        half_way("default, crash, half-way round", true, seldom(crash(drift(0)))),
        half_way("default, two crashes, half-way round", false, seldom(crash(crash(drift(0))))),
        half_way(
            "default, exchanged roles, crash, half-way round",
            false,
            seldom(mutual(2, crash(drift(0)))),
        ),
    ];
    claims.extend(orders());
    claims
}

/// If the couple begins in this epoch, the primary's epoch is the last one before the wrap, and the standby's epoch the
/// first one after it.
const WRAPS: u8 = 252;

/// First epochs of the couple that are about half the number circle away from the epoch in which a restarted node begins.
/// At that distance it is unclear which of the two epochs is newer.
const HALF_WAY: std::ops::RangeInclusive<u8> = 120..=136;

/// The claim about a restarted node, which has forgotten the epochs: the node adopts its partner's epoch, and the partner
/// never adopts the epoch that the node guessed (D135).
fn half_way(rule: &'static str, smoke: bool, couple: Couple) -> Claim {
    Claim {
        name: NAME,
        rule,
        parties: 2,
        about: "a node that starts again takes its partner's epoch, though its own guess may count as newer",
        expect: Outcome::Holds,
        smoke,
        settle: Box::new(move |work| {
            let mut last = settle_plan(work, couple.plan());
            for epoch in HALF_WAY.step_by(2) {
                if last.outcome != Outcome::Holds {
                    break;
                }
                let settled = settle_plan(work, Couple { epoch, ..couple.clone() }.plan());
                last = Settled { sound: last.sound && settled.sound, ..settled };
            }
            last
        }),
    }
}

/// Explores the same plan from several epochs: from zero, from just before half of the number circle, and from just before
/// the wrap. All searches must hold, with the same number of states.
fn equal_states(work: &mut Work<'_>, from: impl Fn(u8) -> Plan) -> Settled {
    let (mut last, first) = work.part(|work| settle_plan(work, from(0)));
    for epoch in [WRAPS / 2 - 2, WRAPS] {
        if last.outcome != Outcome::Holds {
            break;
        }
        let (settled, counts) = work.part(|work| settle_plan(work, from(epoch)));
        let same = (counts.states, counts.transitions) == (first.states, first.transitions);
        last = Settled { sound: last.sound && settled.sound && same, ..settled };
    }
    last
}

fn least(rule: &'static str, smoke: bool, couple: Couple) -> Claim {
    Claim {
        name: NAME,
        rule,
        parties: 2,
        about: "never two that act, whatever is lost; by how much the take-over must exceed the lease is searched for",
        expect: Outcome::Holds,
        smoke,
        settle: Box::new(move |work| margin(work, &couple)),
    }
}

/// The greatest number of ticks beyond the lease that the search tries for a take-over.
const MOST: u64 = 6;

/// The closed form of the margin for the couple's clocks: the drift over both waits, and the tick by which a node may notice
/// late.
fn closed_form(couple: &Couple) -> u64 {
    let Couple { lease, faults, .. } = *couple;
    let both = 2 * lease;
    let ppm = (u64::from(faults.drift) * 1_000_000).div_ceil(both);
    takeover_margin(Ticks(lease), Ticks(lease), ppm, Ticks::ZERO, Ticks(1)).0
}

/// Searches for the least margin that holds. The margin below it is the variant that must fail. Also checks that the
/// standby can take over at all.
fn margin(work: &mut Work<'_>, couple: &Couple) -> Settled {
    let mut one_less: Option<(Settled, _)> = None;
    let mut held = None;
    // The search starts one tick below the lease, so that a smaller margin is tried and fails even if the least margin is
    // zero.
    for takeover in couple.lease - 1..=couple.lease + MOST {
        let tried = Couple { takeover, ..couple.clone() };
        let (settled, counts) = work.part(|work| settle_plan(work, tried.plan()));
        if settled.outcome == Outcome::Fails {
            one_less = Some((settled, counts));
            continue;
        }
        held = Some((takeover, settled));
        break;
    }
    let Some((takeover, settled)) = held else {
        return one_less.map_or_else(|| settle_plan(work, couple.plan()), |(settled, _)| settled);
    };
    let reach = Couple { takeover, watch: CellProperty::Reach(Goal::TookOver), ..couple.clone() };
    let reached = settle_plan(work, reach.plan()).outcome == Outcome::Fails;
    let (least, closed) = (takeover.saturating_sub(couple.lease), closed_form(couple));
    let found = Found {
        least_safe_margin: (settled.outcome == Outcome::Holds).then_some(least),
        closed_form_margin: Some(closed),
        ..Found::default()
    };
    let sound = reached && takeover >= couple.lease && least <= closed && one_less.is_some();
    let bounds = couple.plan().map_or(settled.bounds, |plan| bounds(&plan));
    Settled {
        found,
        bounds,
        sound: settled.sound && sound,
        variant: one_less.map(|(settled, counts)| {
            let about = "with one tick less both act at a time";
            Box::new(Variant { rule: "takeover-one-sooner", about, settled, counts })
        }),
        ..settled
    }
}

/// The claim that a heartbeat which only says "alive" is not enough: the standby cannot tell a dead partner from lost
/// answers, so no take-over is late enough.
fn heartbeat() -> Claim {
    let couple = |takeover: u64| Couple { rule: LeaseRule::Heartbeat, takeover, ..COUPLE };
    Claim {
        name: NAME,
        rule: "plain-heartbeats",
        parties: 2,
        about: "a lease that any heartbeat renews outlasts every take-over, when only the answers are lost (D61)",
        expect: Outcome::Fails,
        smoke: true,
        settle: Box::new(move |work| {
            // The verdict shows the counterexample of the shortest take-over. Longer take-overs must fail, too.
            let longer = [COUPLE.lease + 4, 2 * COUPLE.lease, 3 * COUPLE.lease];
            let fails =
                |work: &mut Work<'_>, t| settle_plan(work, couple(t).plan()).outcome == Outcome::Fails;
            let all = longer.into_iter().all(|takeover| fails(work, takeover));
            let settled = settle_plan(work, couple(COUPLE.lease).plan());
            Settled { sound: settled.sound && all, ..settled }
        }),
    }
}

/// The TTL of an order, and the link delay of an order, in ticks.
const ORDER: (u64, u64) = (4, 1);

/// A scenario in which both tasks of a couple send orders to one arm. The take-over comes `margin` ticks after the lease.
fn ordered(margin: u64, heed: bool, watch: CellProperty) -> Orders {
    let couple = Couple { takeover: COUPLE.lease + margin, every: 3, watch, ..COUPLE };
    Orders { couple, delay: ORDER.1, ttl: ORDER.0, orders: 1, heed }
}

/// Claims about which orders an actuator executes.
fn orders() -> Vec<Claim> {
    let about =
        "an actuator that got an order of an epoch executes no order of an older one, on any of its ports";
    let claim = |rule, expect, margin: u64, heed| Claim {
        name: "fenced-orders",
        rule,
        parties: 3,
        about,
        expect,
        smoke: true,
        settle: Box::new(move |work: &mut Work<'_>| {
            let reach = ordered(margin, heed, CellProperty::Reach(Goal::TookOver));
            let reached = settle_plan(work, reach.plan()).outcome == Outcome::Fails;
            let settled = settle_plan(work, ordered(margin, heed, CellProperty::FencedOrders).plan());
            Settled { sound: settled.sound && reached, ..settled }
        }),
    };
    let whole = takeover_margin(Ticks(0), Ticks(0), 0, Ticks(ORDER.0), Ticks(1)).0;
    let wraps = Claim {
        name: "fenced-orders",
        rule: "default, epochs that wrap",
        parties: 3,
        about: "the same states wherever epochs begin: an actuator compares them across their wrap",
        expect: Outcome::Holds,
        smoke: true,
        settle: Box::new(|work| {
            equal_states(work, |epoch| {
                let orders = ordered(1, true, CellProperty::FencedOrders);
                Orders { couple: Couple { epoch, ..orders.couple }, ..orders }.plan()
            })
        }),
    };
    vec![
        // A couple that is declared as trusted may take over while the last order still runs. Then only the guard of the
        // orders protects the arm.
        claim("default", Outcome::Holds, 1, true),
        wraps,
        claim("no-guard", Outcome::Fails, 1, false),
        claim("no-guard, whole margin", Outcome::Holds, whole, false),
    ]
}
