//! Packs a cell state into canonical bytes and loads it back: first fault budgets and checks, then the nodes and packets.

use super::order::TickValues;
use super::pause::Asleep;
use super::{Beside, CellMove, OVER, RunState, UNUSED, bit};
use crate::cell::plan::{CellFaults, CellPlan, Holds, Times};
use crate::cell_state::CellState;
use crate::state::{Packed, Violation};
use imrs_protocol::{Decode, Encode, Frame, Ticks, Walk};

/// A marker that replaces the first byte of the cell state if a packed list follows: the values that nodes showed earlier
/// in this tick.
const TICK_VALUES: u8 = 0xff;

/// The remaining faults, one byte for each budget, pause and cut. If every byte is at least as great as in another
/// state, the state allows every move of that other state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::cell) struct Left([u8; 8]);

impl Left {
    /// Whether these remaining faults allow every fault that `other` allows.
    pub fn covers(self, other: Self) -> bool {
        self.0.iter().zip(other.0).all(|(mine, others)| *mine >= others)
    }

    /// How many faults remain in all budgets together.
    pub fn total(self) -> u32 {
        self.0.iter().map(|&left| u32::from(left)).sum()
    }
}

/// The number of bytes at the beginning of a packed state that hold [`Left`].
fn left_len(faults: &CellFaults) -> usize {
    let counted = [faults.loss, faults.dup, faults.reorder, faults.fail, faults.drift];
    let counted = counted.iter().filter(|had| **had > 0).count() + faults.pause.len();
    let len = counted + faults.cut.len();
    // If packets may be copied or overtake each other, cuts are not counted here. An open cut forbids copies and
    // overtaking, a cut that is over allows them, so neither state covers the other. At most 8 bytes fit into [`Left`].
    if faults.dup > 0 || faults.reorder > 0 || len > 8 { counted.min(8) } else { len }
}

impl RunState {
    /// Splits a state into its remaining faults and all other bytes.
    pub fn split<'a>(&self, state: &'a [u8]) -> (Left, &'a [u8]) {
        let len = if self.plan.everything { 0 } else { left_len(&self.faults) };
        let (budgets, core) = state.split_at(len.min(state.len()));
        let mut left = Left::default();
        left.0.iter_mut().zip(budgets).for_each(|(to, from)| *to = *from);
        (left, core)
    }

    /// The packed form of the state, as [`pack`](Self::pack) writes it.
    ///
    /// # Errors
    /// The errors of [`pack`](Self::pack).
    pub fn store(&mut self) -> Result<Box<[u8]>, Violation> {
        self.pack()?;
        Ok(self.packed().into())
    }

    /// The bytes that [`pack`](Self::pack) wrote last.
    pub fn packed(&self) -> &[u8] {
        &self.packed
    }

    /// Packs the canonical state, the remaining faults first ([`RunState::split`]).
    ///
    /// # Errors
    /// The violation of the cell state, or [`Violation::Overflow`] if some value has no packed form.
    pub fn pack(&mut self) -> Result<(), Violation> {
        let mut out = std::mem::take(&mut self.packed);
        out.clear();
        let result = self.pack_into(&mut out);
        self.packed = out;
        result
    }

    fn pack_into(&mut self, out: &mut Vec<u8>) -> Result<(), Violation> {
        self.bury();
        // Packing keeps only the `acted` bits of nodes that may still crash or restart, because no move depends on the
        // other bits.
        let may = self.faults.crash.iter().zip(&self.beside.crashed).filter(|(_, crashed)| **crashed == 0);
        let may = may.fold(0_u64, |mask, (node, _)| mask | bit(node.index()));
        let down = (0..self.cell.nodes.len()).filter(|&node| self.is_down(node));
        let may = down.fold(may, |mask, node| mask | bit(node));
        let acted = self.beside.acted;
        self.beside.acted &= may;
        // These fields hold no rounds and no message numbers, so no value is packed relative to another.
        let frame = Frame { rounds: &[], sequences: &[], incarnations: true };
        let beside = Encode::append(out, &frame, |w| self.walk_beside(w));
        self.beside.acted = acted;
        beside.map_err(|_| Violation::Overflow)?;
        let at = out.len();
        self.cell.append_to(out);
        if let Some(violation) = Violation::from_code(out[at]) {
            return Err(violation);
        }
        if self
            .tick_values
            .iter()
            .flat_map(|tick_values| &tick_values.earlier)
            .any(|earlier| !earlier.is_empty())
        {
            // The first byte of the cell state is 0 without a violation, so the marker may replace this byte.
            out[at] = TICK_VALUES;
            let tick_values = Encode::bytes(&frame, |w| {
                self.tick_values.iter_mut().for_each(|tick_values| tick_values.walk(w));
            });
            out.splice(at + 1..at + 1, tick_values.map_err(|_| Violation::Overflow)?);
        }
        Ok(())
    }

    /// Loads the state that was packed last, so that everything that packing omits is lost.
    pub fn load_packed(&mut self) {
        let packed = std::mem::take(&mut self.packed);
        self.load(&packed);
        self.packed = packed;
    }

    /// Loads a packed state, which then counts as the state that was packed last.
    pub fn load_kept(&mut self, state: &[u8]) {
        self.packed.clear();
        self.packed.extend_from_slice(state);
        self.load_packed();
    }

    /// Loads a packed state.
    pub fn load(&mut self, state: &[u8]) {
        let mut at = Decode::read(state, true, |r| self.walk_beside(r));
        for earlier in self.tick_values.iter_mut().flat_map(|tick_values| &mut tick_values.earlier) {
            earlier.clear();
        }
        if state.get(at) == Some(&TICK_VALUES) {
            at += Decode::read(&state[at + 1..], true, |r| {
                self.tick_values.iter_mut().for_each(|tick_values| tick_values.walk(r));
            });
        }
        self.cell.violation = None;
        self.cell.load_bytes(state.get(at..).unwrap_or_default());
        self.see_anew();
        self.checks.forget();
    }

    /// The packed cell state after an arrival; `None` if it sends a packet, or breaks a check, an invariant or the rule of one owner.
    pub fn after(&mut self, state: &[u8], step: CellMove) -> Option<Packed> {
        self.load(state);
        let in_flight = self.cell.in_flight.len();
        self.apply(step);
        self.cell.turns.iter_mut().for_each(Vec::clear);
        let is_silent = self.cell.in_flight.len() < in_flight;
        let sound = self.broken.is_empty() && !self.both_active && self.cell.violation.is_none();
        (is_silent && sound).then(|| self.cell.store())
    }

    /// The packed cell state without one of its packets in flight.
    pub fn without(&mut self, packet: u8) -> Packed {
        self.cell.in_flight.remove(usize::from(packet));
        self.cell.store()
    }

    fn walk_beside<W: Walk>(&mut self, w: &mut W) {
        self.beside.walk(&self.plan, &self.faults, self.times, &mut self.cell, w);
    }
}

impl Beside {
    /// Takes all faults away that have not begun.
    pub fn use_up_faults(&mut self) {
        (self.loss, self.dup, self.reorder, self.fail, self.drift) = (0, 0, 0, 0, 0);
        self.crashed.fill(1);
        self.paused.fill(0);
        self.cuts.iter_mut().filter(|cut| **cut == UNUSED).for_each(|cut| *cut = OVER);
    }

    fn walk<W: Walk>(
        &mut self,
        plan: &CellPlan,
        had: &CellFaults,
        times: Times,
        cell_state: &mut CellState,
        w: &mut W,
    ) {
        let Self {
            loss,
            dup,
            reorder,
            fail,
            drift,
            crashed,
            cuts,
            paused,
            asleep,
            due,
            stays,
            slow,
            held_back,
            begins,
            acted,
        } = self;
        w.byte_if(had.loss > 0, loss);
        w.byte_if(had.dup > 0, dup);
        w.byte_if(had.reorder > 0, reorder);
        w.byte_if(had.fail > 0, fail);
        w.byte_if(had.drift > 0, drift);
        w.raw(paused);
        w.raw(cuts);
        w.raw(crashed);
        if !had.crash.is_empty() {
            w.long(acted);
        }
        for node in &had.crash {
            walk_left(&mut held_back[node.index()], w);
            w.long(&mut begins[node.index()]);
        }
        for (node, asleep) in asleep.iter_mut().enumerate() {
            let slept = &mut cell_state.nodes[node].asleep;
            if had.pause.iter().any(|pause| pause.is_of(node)) {
                walk_pause(asleep, slept, w);
            } else if W::READS {
                (*slept, *asleep) = (None, None);
            }
        }
        for (_, due) in
            plan.checks.iter().zip(due).filter(|(check, _)| matches!(check.holds, Holds::Leads { .. }))
        {
            walk_left(due, w);
        }
        if W::READS {
            stays.clear();
        }
        if times != Times::Ends {
            w.list(stays, (0, 0), walk_thread);
            w.long(slow);
        }
    }
}

/// Encodes, decodes or visits (as the pass `w` does) a task and one of its activations.
fn walk_thread<W: Walk>((task, level): &mut (u8, u8), w: &mut W) {
    w.byte(task);
    w.byte(level);
}

/// Encodes, decodes or visits an optional number of ticks. In packed form `None` is 0, and `n` is `n + 1`.
fn or_none<W: Walk>(ticks: &mut Option<u32>, w: &mut W) {
    let mut read = ticks.map_or(0, |ticks| ticks + 1);
    w.number(&mut read);
    *ticks = read.checked_sub(1);
}

/// Encodes, decodes or visits an optional time, in the form that `or_none` uses.
fn walk_left<W: Walk>(left: &mut Option<Ticks>, w: &mut W) {
    // A pass that reads ignores the former value, because it may be a symbolic time of another run.
    let mut read = left.filter(|_| !W::READS).map_or(Ticks::ZERO, |left| left + Ticks(1));
    w.left(&mut read, true);
    *left = (!read.is_zero()).then(|| read - Ticks(1));
}

/// Encodes, decodes or visits a pause: the ticks that it may still last, the ticks that it has lasted, and the actions
/// that it holds back.
fn walk_pause<W: Walk>(asleep: &mut Option<Asleep>, slept: &mut Option<u32>, w: &mut W) {
    let mut left = asleep.as_ref().map(|asleep| asleep.left);
    or_none(&mut left, w);
    if W::READS {
        *asleep = left.map(|left| Asleep { left, held: Vec::new() });
        *slept = left;
    }
    let Some(Asleep { left: _, held }) = asleep else { return };
    w.number(slept.get_or_insert(0));
    w.list(held, (0, 0), walk_thread);
}

impl TickValues {
    /// Encodes, decodes or visits what the nodes showed earlier in this tick: the number of groups of values, then the
    /// values.
    fn walk<W: Walk>(&mut self, w: &mut W) {
        let widths: Vec<usize> = self.widths().collect();
        for (earlier, width) in self.earlier.iter_mut().zip(widths) {
            w.list(earlier, vec![None; width], |shown_values, w| {
                shown_values.iter_mut().for_each(|value| walk_value(value, w));
            });
        }
    }
}

fn walk_value<W: Walk>(value: &mut Option<i64>, w: &mut W) {
    let mut bytes = value.unwrap_or(i64::MIN).to_le_bytes();
    w.raw(&mut bytes);
    *value = Some(i64::from_le_bytes(bytes)).filter(|value| *value != i64::MIN);
}
