//! Packs the times of a state: one byte for each time, and a term for what the byte leaves open.

use super::forks::Cut;
use super::times::{Term, Times};
use imrs_protocol::symbolic::{START, Symbol, Time};

/// The byte of a time that is past, and no longer makes a difference.
const PAST: u8 = 0;
/// The byte of a time for which a variable of the zone stands.
const KNOWN: u8 = 1;
const NEVER: u8 = 2;

impl Cut {
    /// Begins to pack a state. `now` is the present instant.
    pub fn begin_to_pack(&mut self, now: Term) {
        self.times = Times { now, ..Times::default() };
    }

    pub(super) fn pack_time(&mut self, time: Time, symbol: Option<Symbol>) -> u8 {
        let now = self.times.now;
        let (from, symbol) = match (time, symbol) {
            (Time::Remaining, _) => (self.times.sent.take().unwrap_or(now), symbol),
            // The age says how long before the present the packet was sent.
            (Time::Age, Some(Symbol { first, second, offset })) => {
                (now, Some(Symbol { first: second, second: first, offset: -offset }))
            }
            (Time::Age | Time::Left { .. }, _) => (now, symbol),
        };
        let Some(Symbol { first, second, offset }) = symbol else { return NEVER };
        let is_past = |cut: &mut Self| cut.asks_negative(Symbol { first, second, offset: offset - 1 });
        if time == (Time::Left { forgets: true }) && is_past(self) {
            return PAST;
        }
        let (variable, more) = self.moved(from.0, first, second);
        self.decides(variable);
        let term = (variable, offset + from.1 + more);
        if time == Time::Age {
            self.times.sent = Some(term);
        }
        self.times.terms.push(term);
        KNOWN
    }

    pub(super) fn unpack_time(&mut self, time: Time, packed: u8) -> Option<Symbol> {
        let zero = Symbol { first: START, second: START, offset: 0 };
        let from = self.times.sent.take().map_or(START, |(sent, _)| sent);
        match packed {
            NEVER => return None,
            PAST => return Some(zero),
            _ => {}
        }
        // The first variable is the present instant, so the times begin with the second one.
        self.times.read += 1;
        let variable = self.times.read;
        Some(match time {
            Time::Left { .. } => Symbol { first: variable, ..zero },
            Time::Remaining => Symbol { first: variable, second: from, offset: 0 },
            Time::Age => {
                self.times.sent = Some((variable, 0));
                Symbol { second: variable, ..zero }
            }
        })
    }
}
