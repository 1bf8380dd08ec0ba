//! Packs the times of a state: one byte for each time, and a term for each time that the byte alone does not determine.

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

    /// Begins to read the state that was packed last, with its times on the variables of this zone.
    pub fn begin_to_read(&mut self) {
        (self.times.read, self.times.sent) = (0, None);
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
        if time == (Time::Left { forgets: false }) && first == second && offset == 0 {
            // Zero, the present, comes before the times.
            self.times.over.push(self.times.terms.len() + 1);
        }
        if time == Time::Age {
            self.times.sent = Some(term);
        }
        self.times.terms.push(term);
        KNOWN
    }

    pub(super) fn unpack_time(&mut self, time: Time, packed: u8) -> Option<Symbol> {
        let now = self.times.now;
        let from = self.times.sent.take().unwrap_or(now);
        match packed {
            NEVER => return None,
            PAST => return Some(Symbol { first: START, second: START, offset: 0 }),
            _ => {}
        }
        let term = self.times.terms.get(self.times.read).copied().unwrap_or(now);
        self.times.read += 1;
        let since = |(first, more): Term, (second, less): Term| Symbol { first, second, offset: more - less };
        Some(match time {
            Time::Left { .. } => since(term, now),
            Time::Remaining => since(term, from),
            Time::Age => {
                self.times.sent = Some(term);
                since(now, term)
            }
        })
    }
}
