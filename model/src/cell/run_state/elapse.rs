//! Lets time pass.

use super::RunState;
use crate::state::Violation;
use imrs_protocol::Ticks;

impl RunState {
    /// Lets time pass until the next event. `drift` names a node that counts a tick more (`true`) or less.
    pub(super) fn pass(
        &mut self,
        next: Option<Ticks>,
        drift: Option<(usize, bool)>,
    ) -> Result<(), Violation> {
        let Some(ticks) = next else { return Ok(()) };
        self.passed += ticks.0;
        self.end_instant();
        self.elapse(ticks, drift)?;
        if self.beside.acted != 0 {
            self.stir();
        } else {
            self.next_step();
        }
        Ok(())
    }

    /// Ends an instant: forgets which nodes acted in it, and what they showed.
    pub fn end_instant(&mut self) {
        self.beside.acted = 0;
        self.begin_tick();
    }

    /// Lets time pass for the whole cell. The nodes notice the time one after the other.
    pub fn elapse(&mut self, ticks: Ticks, drift: Option<(usize, bool)>) -> Result<(), Violation> {
        for (check, due) in self.beside.due.iter_mut().enumerate() {
            match *due {
                Some(left) if left < ticks => {
                    *due = None;
                    self.broken.push(check);
                }
                Some(left) => *due = Some(left - ticks),
                None => {}
            }
        }
        self.cell.in_flight.iter_mut().for_each(|carried| carried.age += ticks);
        self.act_on(ticks);
        for node in (0..self.cell.nodes.len()).filter(|&i| self.cell.nodes[i].up).collect::<Vec<_>>() {
            let counted = match drift {
                Some((at, true)) if at == node => ticks + Ticks(1),
                Some((at, false)) if at == node => ticks - Ticks(1),
                Some(_) | None => ticks,
            };
            if self.is_asleep(node) {
                self.sleep_on(node, (ticks, counted));
            } else {
                self.notice(node, counted)?;
            }
        }
        Ok(())
    }
}
