//! The search for the least margin of `waitfor` (D2, D56).

use super::meeting::{DELAY, RESEND, bounds, once, releases, timed};
use super::{Claim, Settled, Variant, Work};
use crate::report::{Found, Outcome};
use crate::scenario::{Budget, Timing, Watch};
use crate::worlds::Meeting;
use imrs_protocol::Ticks;
use imrs_protocol::margin::least_margin;
use imrs_protocol::rules::Rules;

/// A search for the least margin that suffices: no member is released while another gives up.
#[derive(Clone, Copy)]
pub(super) struct Search {
    pub members: usize,
    pub losses: u8,
    pub dup: u8,
    pub timing: Timing,
    pub time_outs: TimeOuts,
    pub rules: Rules,
    /// The period of retransmissions in ticks; `None`: every packet is sent once.
    pub resend: Option<u64>,
}

/// The time_outs with which the search tries a margin.
#[derive(Clone, Copy)]
pub(super) enum TimeOuts {
    /// The least time_out with which a release is reachable, and `more` longer ones. So the result does not depend on how
    /// the period of retransmissions divides the time_out.
    Least { more: u64 },
    /// Only this time_out.
    Only(u64),
}

impl Search {
    /// A search under the default rules, without duplicates or deviations of time.
    pub fn of(members: usize, losses: u8) -> Self {
        let more = if members == 2 { RESEND + 1 } else { 0 };
        Self {
            members,
            losses,
            dup: 0,
            timing: Timing::default(),
            time_outs: TimeOuts::Least { more },
            rules: Rules::DEFAULT,
            resend: Some(RESEND),
        }
    }

    pub fn claim(self, rule: &'static str, smoke: bool) -> Claim {
        Claim {
            name: "all-or-none",
            rule,
            parties: u32::try_from(self.members).unwrap_or(0),
            about: "no member is released while another gives up, as long as delays and losses keep to their bounds (D2)",
            expect: Outcome::Holds,
            smoke,
            settle: Box::new(move |work| self.margin(work)),
        }
    }

    /// The claim that no margin is enough. The search tries all margins up to three times the margin that the formula
    /// gives for the default rules.
    pub fn claim_none(self, rule: &'static str, about: &'static str) -> Claim {
        Claim {
            about,
            expect: Outcome::Fails,
            settle: Box::new(move |work| self.none(work)),
            ..self.claim(rule, true)
        }
    }

    /// Settles the claim that no margin is enough: every margin must fail. The counterexample of the closed form is shown.
    fn none(&self, work: &mut Work<'_>) -> Settled {
        let closed_form = self.closed_form();
        let mut shown = None;
        for margin in 0..=3 * closed_form {
            let settled = self.fails_at(work, margin);
            let settled =
                settled.unwrap_or_else(|| once(work, &self.meeting(margin, *self.time_outs(margin).start())));
            if settled.outcome != Outcome::Fails {
                return settled;
            }
            if margin == closed_form {
                shown = Some(settled);
            }
        }
        shown.unwrap_or_else(|| once(work, &self.meeting(0, *self.time_outs(0).start())))
    }

    fn closed_form(&self) -> u64 {
        least_margin(Ticks(u64::from(DELAY)), self.losses, Ticks(RESEND), Ticks(1)).0
    }

    fn time_outs(&self, margin: u64) -> std::ops::RangeInclusive<u64> {
        match self.time_outs {
            TimeOuts::Least { more } => {
                let least = margin + u64::from(DELAY) + 1;
                least..=least + more
            }
            TimeOuts::Only(time_out) => time_out..=time_out,
        }
    }

    fn meeting(&self, margin: u64, time_out: u64) -> Meeting {
        let Self { members, losses, dup, timing, rules, resend, .. } = *self;
        let attempts = if members == 2 { 2 } else { 1 };
        Meeting {
            attempts: Some(attempts),
            timing,
            rules,
            resend,
            budget: Budget { loss: losses, dup, crash: 0 },
            ..timed(members, Watch::AllOrNone, losses, margin, time_out)
        }
    }

    /// The result for the first time_out with which the margin does not hold; `None` if it holds with all time_outs.
    fn fails_at(&self, work: &mut Work<'_>, margin: u64) -> Option<Settled> {
        let mut settled = self.time_outs(margin).map(|time_out| once(work, &self.meeting(margin, time_out)));
        settled.find(|settled| settled.outcome != Outcome::Holds)
    }

    /// Searches for the least margin that holds. The margin below it is the variant that must fail. Also checks that a
    /// member can be released with that margin at all; otherwise the claim would hold vacuously.
    fn margin(&self, work: &mut Work<'_>) -> Settled {
        let closed_form = self.closed_form();
        let mut one_less = None;
        let mut least = None;
        for candidate in 0..=closed_form {
            match work.part(|work| self.fails_at(work, candidate)) {
                (None, _) => {
                    least = Some(candidate);
                    break;
                }
                (Some(settled), counts) => one_less = Some((settled, counts)),
            }
        }
        let shown = least.unwrap_or(closed_form);
        let meeting = self.meeting(shown, *self.time_outs(shown).start());
        let reached = releases(work, &meeting);
        let unsettled = one_less.as_ref().map_or(Outcome::Unknown, |(settled, _)| settled.outcome);
        Settled {
            outcome: if least.is_some() { Outcome::Holds } else { unsettled },
            bounds: bounds(&meeting),
            found: Found {
                least_safe_margin: least,
                closed_form_margin: Some(closed_form),
                ..Found::default()
            },
            counterexample: None,
            sound: reached && least.is_some_and(|least| least <= closed_form),
            variant: one_less.map(|(settled, counts)| {
                let about = "with one tick less margin one member runs while another has given up";
                Box::new(Variant { rule: "margin-one-less", about, settled, counts })
            }),
        }
    }
}

/// The claim that a search finds the least margin, if packets may be charged too much and timers may be late.
pub(super) fn margins(rule: &'static str, members: usize, losses: u8, timing: Timing, smoke: bool) -> Claim {
    Search { timing, ..Search::of(members, losses) }.claim(rule, smoke)
}
