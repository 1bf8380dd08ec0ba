//! Building blocks of claims about messages: their scenarios, and how a claim is settled.

use super::{Claim, Settled, Work};
use crate::report::{Bounds, Outcome};
use crate::scenario::{Budget, Watch};
use crate::worlds::Exchange;

/// A scenario of commands with one retransmission, one loss and one duplicate.
pub(super) fn commands(watch: Watch) -> Exchange {
    Exchange {
        retry: (1, 2),
        buffer: 2,
        budget: Budget { loss: 1, dup: 1, crash: 0 },
        ..Exchange::new(watch)
    }
}

/// A claim that holds if all of these scenarios hold, and fails if one of them fails.
pub(super) fn claim(
    (name, rule, about): (&'static str, &'static str, &'static str),
    expect: Outcome,
    smoke: bool,
    worlds: Vec<Exchange>,
) -> Claim {
    Claim {
        name,
        rule,
        parties: 2,
        about,
        expect,
        smoke,
        settle: Box::new(move |work| settle(work, &worlds)),
    }
}

/// Explores the scenarios of a claim until one of them fails.
pub(super) fn settle(work: &mut Work<'_>, worlds: &[Exchange]) -> Settled {
    let mut settled = None;
    for exchange in worlds {
        let (outcome, counterexample) = match exchange.scenario() {
            Ok(scenario) => work.judge(&scenario),
            Err(_) => (Outcome::Unknown, None),
        };
        settled = Some(Settled::new(outcome, bounds(exchange), counterexample));
        if outcome != Outcome::Holds {
            break;
        }
    }
    settled.unwrap_or_else(|| Settled::unsettled(Bounds::default()))
}

fn bounds(exchange: &Exchange) -> Bounds {
    Bounds {
        loss: u32::from(exchange.budget.loss),
        dup: u32::from(exchange.budget.dup),
        delay: Some(u32::from(exchange.delay)),
        crash: u32::from(exchange.budget.crash),
        rounds: Some(u32::from(exchange.sends)),
        time_out: Some(exchange.time_out),
        resend: (exchange.retry.0 > 0).then_some(exchange.retry.1),
        margin: None,
    }
}
