//! The times of a packed state: its bytes say where there are times, and its zone says which ones.
//!
//! Each time is a variable of its own, in the order of packing, and zero is the present. So states whose times differ by
//! constants, too, have the same bytes, and their zones can be compared and merged.

use super::forks::Cut;
use imrs_protocol::symbolic::{START, Symbol, Time};

/// A time that is past, and makes no difference any more.
const PAST: u8 = 0;
/// A time that a variable of the zone stands for.
const KNOWN: u8 = 1;
const NEVER: u8 = 2;

/// A variable and an offset.
type Term = (u8, i64);

/// The instants of a state that is packed, or how many times of a packed state were read.
#[derive(Debug, Default)]
pub(crate) struct Times {
    /// The present.
    now: Term,
    terms: Vec<Term>,
    read: u8,
    /// When the packet that comes next was sent.
    sent: Option<Term>,
}

impl Times {
    /// The terms of the new state's zone: the present, then each of its times.
    pub fn terms(&self) -> Vec<(usize, i64)> {
        let all = std::iter::once(&self.now).chain(&self.terms);
        all.map(|&(variable, offset)| (usize::from(variable), offset)).collect()
    }
}

impl Cut {
    /// Begins to pack a state whose present is at this symbol.
    pub fn begin_to_pack(&mut self, now: Term) {
        self.times = Times { now, ..Times::default() };
    }

    pub(super) fn pack_time(&mut self, time: Time, symbol: Option<Symbol>) -> u8 {
        let now = self.times.now;
        let (from, symbol) = match (time, symbol) {
            (Time::Remaining, _) => (self.times.sent.take().unwrap_or(now), symbol),
            // It was sent so long before.
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
        // The first variable is the present.
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
