//! Time in a world: ticks, late timers, and the properties that are judged by counting ticks or steps.

use super::World;
use crate::cell_state::NodeState;
use crate::network::InFlight;
use crate::scenario::{Behaviour, Watch};
use crate::state::Violation;
use imrs_protocol::rules::TimeStamp;
use imrs_protocol::{Kind, NodeInput, Seq24, TaskId, Ticks};

impl World {
    /// Lets a tick pass. The timer of node `late` fires only at the next tick, or at the node's next input: a node
    /// reads its clock at every input (D42).
    pub(super) fn tick(&mut self, late: Option<usize>) -> Result<(), Violation> {
        self.steps = 0;
        for carried in &mut self.in_flight {
            carried.age += 1;
        }
        for i in 0..self.n() {
            if late == Some(i) {
                self.nodes[i].owed = 1;
            } else if self.nodes[i].up {
                let elapsed = Ticks(1 + u64::from(std::mem::take(&mut self.nodes[i].owed)));
                self.step(i, elapsed, NodeInput::Time)?;
                self.keep_clock(i);
            }
            self.count_tick(i)?;
        }
        if self.scenario.cell.cell().rules.time_stamp == TimeStamp::Absolute {
            for carried in self.in_flight.iter_mut().filter(|carried| carried.packet.kind == Kind::Send) {
                carried.packet.remaining = carried.packet.remaining - Ticks(1);
            }
        }
        Ok(())
    }

    /// Counts a tick for a task in its specification state: true remaining times, and how long each wait has lasted.
    fn count_tick(&mut self, i: usize) -> Result<(), Violation> {
        let lateness = Ticks(1 + u64::from(self.scenario.timing.late > 0));
        let limit = self.patience(i) + lateness;
        let spec_state = &mut self.spec_states[i];
        spec_state.statuses.retain_mut(|(_, left)| {
            *left -= 1;
            *left > 0
        });
        if let Some(open) = &mut spec_state.open {
            *open += 1;
            if matches!(self.scenario.watch, Watch::Resolves | Watch::Waits)
                && limit < Ticks::FAR
                && Ticks(u64::from(*open)) > limit
            {
                return Err(Violation::NoOutcome);
            }
        }
        Ok(())
    }

    /// Lets a node whose timer is late read its clock, before the node takes any other input.
    pub(super) fn catch_up(&mut self, i: usize) -> Result<(), Violation> {
        if std::mem::take(&mut self.nodes[i].owed) > 0 && self.nodes[i].up {
            self.step(i, Ticks(1), NodeInput::Time)?;
            self.keep_clock(i);
        }
        Ok(())
    }

    /// Sets a node's clock back to its initial offset, because packed states hold offsets between clocks, and not how long
    /// the clocks have run. [`World::tick`] subtracts the same tick from absolute time stamps in flight.
    fn keep_clock(&mut self, i: usize) {
        let ahead = Ticks(self.scenario.clocks[i]);
        if self.scenario.cell.cell().rules.time_stamp == TimeStamp::Absolute {
            let NodeState { node, table, .. } = &mut self.nodes[i];
            let task = &mut node.parts_mut().tasks[0];
            task.rebase(table);
            task.set_ahead(table, ahead);
        }
    }

    /// The declared time_out of the port that task `i` uses.
    fn patience(&self, i: usize) -> Ticks {
        match self.scenario.behaviours[i] {
            Behaviour::Member { port, .. } | Behaviour::Sender { port, .. } => {
                let task = TaskId::from_index(i);
                self.scenario.cell.port(port).and_then(|p| p.party(task)).map_or(Ticks::FAR, |p| p.time_out)
            }
            Behaviour::Receiver => Ticks::FAR,
        }
    }

    /// Maps a packet's sequence number to the latest message with this number, under the variant in which sequence numbers
    /// wrap after `wrap` messages.
    pub(super) fn wrap_around(&self, carried: &mut InFlight) {
        let Some(wrap) = self.scenario.wrap.map(u32::from) else { return };
        let source = match carried.packet.kind {
            Kind::Reply | Kind::Response | Kind::Control => carried.packet.destination,
            Kind::Send | Kind::Query | Kind::Arrive | Kind::Confirm | Kind::Abort => carried.packet.source,
        };
        let next = self.next_sequence(source.index());
        let back = next.steps_from(carried.packet.id.sequence);
        if back > 0 {
            carried.packet.id.sequence = next.plus(Seq24::MODULUS - ((back - 1) % wrap + 1));
        }
    }

    /// A bound on the steps between two ticks: for each round that a task can begin, and for each packet in flight, a node
    /// sends at most two packets to each other node. Each of these packets arrives once.
    pub(super) fn most_steps(&self) -> u16 {
        let n = self.n();
        let attempts = |behaviour: &Behaviour| match behaviour {
            Behaviour::Member { attempts, .. } => usize::from(attempts.unwrap_or(u8::MAX)),
            Behaviour::Sender { sends, .. } => usize::from(*sends),
            Behaviour::Receiver => 1,
        };
        let rounds: usize = 1 + self.scenario.behaviours.iter().map(attempts).sum::<usize>();
        let ticks = usize::from(self.scenario.delay.unwrap_or(0)) + 2;
        let faults = usize::from(self.scenario.budget.dup) + usize::from(self.scenario.budget.loss);
        u16::try_from(rounds * (1 + 2 * n * (n - 1) * ticks) + faults).unwrap_or(u16::MAX)
    }

    /// Judges progress after a step: there must be no endless loop between two ticks, and no deadlock.
    pub(super) fn judge_progress(&self) -> Result<(), Violation> {
        if self.scenario.watch != Watch::Waits {
            return Ok(());
        }
        if self.steps > self.most_steps() {
            return Err(Violation::Zeno);
        }
        let mut actions = Vec::new();
        self.free_actions(&mut actions);
        if actions.is_empty() && !self.is_finished() { Err(Violation::Stuck) } else { Ok(()) }
    }
}
