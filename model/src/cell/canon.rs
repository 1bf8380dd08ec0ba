//! Cells as packed bytes and back: what is named in the cell, then the floor.

use super::course::{Course, bit};
use super::pause::Asleep;
use super::plan::{CellFaults, Holds, Times};
use crate::floor::canon::number;
use crate::state::Violation;

/// Stands for a floor's first byte: what nodes showed before in this tick comes first.
const SIGHTS: u8 = 0xff;

/// What may still go wrong, a byte for each kind: more in every byte allows all that less does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Left([u8; 8]);

impl Left {
    /// Whether all that may go wrong with `other` may go wrong with this.
    pub fn covers(self, other: Self) -> bool {
        self.0.iter().zip(other.0).all(|(mine, others)| *mine >= others)
    }
}

/// How many bytes at the beginning of a state are [`Left`].
fn left_len(faults: &CellFaults) -> usize {
    let counted = [faults.loss, faults.dup, faults.reorder, faults.fail, faults.drift];
    let counted = counted.iter().filter(|had| **had > 0).count() + faults.pause.len();
    let len = counted + faults.cut.len();
    // A packet may be doubled or overtaken where a cut is over, and not where one is open. And there is no more room.
    if faults.dup > 0 || faults.reorder > 0 || len > 8 { counted.min(8) } else { len }
}

impl Course {
    /// The two parts of a state: what may still go wrong, and the rest.
    pub fn split<'a>(&self, state: &'a [u8]) -> (Left, &'a [u8]) {
        let len = if self.plan.everything { 0 } else { left_len(&self.faults) };
        let (budgets, core) = state.split_at(len.min(state.len()));
        let mut left = Left::default();
        left.0.iter_mut().zip(budgets).for_each(|(to, from)| *to = *from);
        (left, core)
    }

    /// Writes the canonical state, or says what outgrew it. What may still go wrong comes first ([`Course::split`]).
    pub fn store(&mut self) -> Result<Box<[u8]>, Violation> {
        self.bury();
        let floor = self.floor.store();
        if let Some(violation) = floor.violation() {
            return Err(violation);
        }
        let mut out = Vec::with_capacity(floor.len() + 16);
        let (b, f) = (&self.beside, &self.faults);
        let budgets =
            [(f.loss, b.loss), (f.dup, b.dup), (f.reorder, b.reorder), (f.fail, b.fail), (f.drift, b.drift)];
        for (had, left) in budgets {
            if had > 0 {
                out.push(left);
            }
        }
        out.extend(&b.paused);
        out.extend(&b.cuts);
        out.extend(&b.crashed);
        // Where it may not crash any more, nobody asks.
        let may = f.crash.iter().zip(&b.crashed).filter(|(_, crashed)| **crashed == 0);
        let may = may.fold(0_u64, |mask, (node, _)| mask | bit(node.index()));
        let down = (0..self.floor.stations.len()).filter(|&node| self.is_down(node));
        let may = down.fold(may, |mask, node| mask | bit(node));
        if !f.crash.is_empty() {
            out.extend((b.acted & may).to_le_bytes());
        }
        for node in &f.crash {
            number(b.held_back[node.index()].unwrap_or(0), &mut out);
        }
        for node in (0..b.asleep.len()).filter(|&node| self.may_pause(node)) {
            self.store_pause(node, &mut out)?;
        }
        for (check, due) in self.plan.checks.iter().zip(&b.due) {
            if matches!(check.holds, Holds::Leads { .. }) {
                number(due.map_or(0, |left| left + 1), &mut out);
            }
        }
        if self.times != Times::Ends {
            out.push(u8::try_from(b.stays.len()).map_err(|_| Violation::Overflow)?);
            b.stays.iter().for_each(|&(task, level)| out.extend([task, level]));
            out.extend(b.slow.to_le_bytes());
        }
        let at = out.len();
        out.extend_from_slice(&floor.0);
        if self.sights.iter().flat_map(|sights| &sights.earlier).any(|earlier| !earlier.is_empty()) {
            // The floor's first byte is zero where there is no violation.
            out[at] = SIGHTS;
            let sights = self.store_sights()?;
            out.splice(at + 1..at + 1, sights);
        }
        Ok(out.into_boxed_slice())
    }

    pub fn load(&mut self, state: &[u8]) {
        let mut at = 0;
        let mut byte = || {
            at += 1;
            state.get(at - 1).copied().unwrap_or(0)
        };
        let (b, f) = (&mut self.beside, &self.faults);
        let budgets = [
            (f.loss, &mut b.loss),
            (f.dup, &mut b.dup),
            (f.reorder, &mut b.reorder),
            (f.fail, &mut b.fail),
            (f.drift, &mut b.drift),
        ];
        for (had, left) in budgets {
            *left = if had > 0 { byte() } else { 0 };
        }
        b.paused.iter_mut().for_each(|left| *left = byte());
        b.cuts.iter_mut().for_each(|cut| *cut = byte());
        b.crashed.iter_mut().for_each(|crashed| *crashed = byte());
        if !f.crash.is_empty() {
            b.acted = u64::from_le_bytes(std::array::from_fn(|_| byte()));
        }
        let number = |byte: &mut dyn FnMut() -> u8| match byte() {
            u8::MAX => u32::from_le_bytes(std::array::from_fn(|_| byte())),
            short => u32::from(short),
        };
        for node in &f.crash {
            b.held_back[node.index()] = Some(number(&mut byte)).filter(|left| *left > 0);
        }
        for (node, station) in self.floor.stations.iter_mut().enumerate() {
            (station.asleep, b.asleep[node]) = (None, None);
            if !f.pause.iter().any(|pause| pause.is_of(node)) {
                continue;
            }
            if let Some(left) = number(&mut byte).checked_sub(1) {
                station.asleep = Some(number(&mut byte));
                let held = (0..byte()).map(|_| (byte(), byte())).collect();
                b.asleep[node] = Some(Asleep { left, held });
            }
        }
        for (check, due) in self.plan.checks.iter().zip(&mut b.due) {
            if matches!(check.holds, Holds::Leads { .. }) {
                *due = number(&mut byte).checked_sub(1);
            }
        }
        b.stays.clear();
        if self.times != Times::Ends {
            for _ in 0..byte() {
                b.stays.push((byte(), byte()));
            }
            b.slow = u64::from_le_bytes(std::array::from_fn(|_| byte()));
        }
        self.floor.violation = None;
        for earlier in self.sights.iter_mut().flat_map(|sights| &mut sights.earlier) {
            earlier.clear();
        }
        if state.get(at) == Some(&SIGHTS) {
            at += self.load_sights(&state[at + 1..]);
        }
        self.floor.load_bytes(state.get(at..).unwrap_or(&[]));
        self.see_anew();
    }

    /// What nodes showed before in this tick: how often, and the values.
    fn store_sights(&self) -> Result<Vec<u8>, Violation> {
        let mut out = Vec::new();
        for earlier in self.sights.iter().flat_map(|sights| &sights.earlier) {
            out.push(u8::try_from(earlier.len()).map_err(|_| Violation::Overflow)?);
            for value in earlier.iter().flatten() {
                out.extend(value.unwrap_or(i64::MIN).to_le_bytes());
            }
        }
        Ok(out)
    }

    /// Returns how many bytes that took.
    fn load_sights(&mut self, bytes: &[u8]) -> usize {
        let mut at = 0;
        let mut byte = || {
            at += 1;
            bytes.get(at - 1).copied().unwrap_or(0)
        };
        for sights in &mut self.sights {
            let widths: Vec<usize> = sights.widths().collect();
            for (earlier, width) in sights.earlier.iter_mut().zip(widths) {
                for _ in 0..byte() {
                    let value = |_| Some(i64::from_le_bytes(std::array::from_fn(|_| byte())));
                    let sight = (0..width).map(value).map(|value| value.filter(|value| *value != i64::MIN));
                    earlier.push(sight.collect());
                }
            }
        }
        at
    }

    /// How long a node may stay paused, how long it has been, and which of its actions have not begun.
    fn store_pause(&self, node: usize, out: &mut Vec<u8>) -> Result<(), Violation> {
        match &self.beside.asleep[node] {
            None => out.push(0),
            Some(asleep) => {
                number(asleep.left + 1, out);
                number(self.floor.slept(node).unwrap_or(0), out);
                out.push(u8::try_from(asleep.held.len()).map_err(|_| Violation::Overflow)?);
                asleep.held.iter().for_each(|&(task, level)| out.extend([task, level]));
            }
        }
        Ok(())
    }
}
