//! Cells as packed bytes and back: what is named in the cell, then the floor.

use super::course::{Course, bit};
use super::plan::Holds;
use crate::floor::canon::number;
use crate::state::Violation;

impl Course {
    /// Writes the canonical state, or says what outgrew it.
    pub fn store(&mut self) -> Result<Box<[u8]>, Violation> {
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
        out.extend(&b.crashed);
        out.extend(&b.cuts);
        // Where it may not crash any more, nobody asks.
        let may = f.crash.iter().zip(&b.crashed).filter(|(_, crashed)| **crashed == 0);
        let may = may.fold(0_u64, |mask, (node, _)| mask | bit(node.index()));
        if !f.crash.is_empty() {
            out.extend((b.acted & may).to_le_bytes());
        }
        for (check, due) in self.plan.checks.iter().zip(&b.due) {
            if matches!(check.holds, Holds::Leads { .. }) {
                number(due.map_or(0, |left| left + 1), &mut out);
            }
        }
        if self.plan.between {
            out.push(u8::try_from(b.stays.len()).map_err(|_| Violation::Overflow)?);
            b.stays.iter().for_each(|&(task, level)| out.extend([task, level]));
        }
        out.extend_from_slice(&floor.0);
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
        b.crashed.iter_mut().for_each(|crashed| *crashed = byte());
        b.cuts.iter_mut().for_each(|cut| *cut = byte());
        if !f.crash.is_empty() {
            b.acted = u64::from_le_bytes(std::array::from_fn(|_| byte()));
        }
        for (check, due) in self.plan.checks.iter().zip(&mut b.due) {
            if matches!(check.holds, Holds::Leads { .. }) {
                let left = match byte() {
                    u8::MAX => u32::from_le_bytes([byte(), byte(), byte(), byte()]),
                    left => u32::from(left),
                };
                *due = left.checked_sub(1);
            }
        }
        b.stays.clear();
        if self.plan.between {
            for _ in 0..byte() {
                b.stays.push((byte(), byte()));
            }
        }
        self.floor.violation = None;
        self.floor.load_bytes(state.get(at..).unwrap_or(&[]));
    }
}
