//! Advances the clocks of followed nodes: as far as the run has come, but not past an event that the run has not shown yet.

use super::run::Happened;
use super::run::{Late, Turn};
use super::{AHEAD, Follower, Group, LATE, No, Rounding};
use imrs_protocol::script::ScriptInput;
use imrs_protocol::{Call, NodeInput, NodeOutbox, Packet, Signal, TaskId, Ticks, TimeId};

/// A timer or delay: the task, and its id.
pub(super) type Timer = (TaskId, TimeId);

/// How many inputs of a task, before the one that the model cannot follow, `is_tied` examines.
const TIED: usize = 8;

impl Follower {
    /// Ticks until time alone makes a node act.
    pub(super) fn expiry(&self, node: usize) -> Option<u64> {
        self.run_state.cell.nodes[node].node.time_left().map(|ticks| ticks.0.max(1))
    }

    pub(super) fn count(&mut self, node: usize, ticks: u64) -> Result<(), No> {
        if ticks == 0 {
            return Ok(());
        }
        self.clocks[node] += ticks;
        let step = self.run_state.cell.pass(node, Ticks(ticks));
        step.map_err(|violation| No::Never(violation.text().into()))?;
        self.made(node)
    }

    /// Whether a node would signal or send anything if this many ticks passed.
    pub(super) fn shows(&self, node: usize, ticks: u64) -> bool {
        let mut look = Look(false);
        let mut node = self.run_state.cell.nodes[node].node.clone();
        node.step(node.now() + Ticks(ticks), NodeInput::Time, &mut look);
        look.0
    }

    /// Lets a node count up to a tick, but not up to an instant at which it would act: the run shows later when that
    /// action happens.
    pub(super) fn catch_up(&mut self, node: usize, now: u64) -> Result<(), No> {
        while self.clocks[node] < now {
            let left = now - self.clocks[node];
            let Some(expiry) = self.expiry(node).filter(|&expiry| expiry <= left) else {
                return self.count(node, left);
            };
            if self.shows(node, expiry) {
                self.count(node, expiry - 1)?;
                return Ok(());
            }
            self.count(node, expiry)?;
        }
        Ok(())
    }

    pub(super) fn let_actions_go_on(&mut self, node: usize, now: u64) {
        let ticks = Ticks(now.saturating_sub(self.acts[node]));
        self.acts[node] = self.acts[node].max(now);
        for task in 0..self.run_state.cell.bodies.len() {
            if self.run_state.cell.node_state_of(task) == node
                && let Some(actor) = &mut self.run_state.cell.bodies[task].actor
            {
                self.over.retain(|&(of, level), _| {
                    of != task || actor.running.iter().any(|running| running.level == level)
                });
                for running in actor.running.iter().filter(|running| running.most < ticks) {
                    *self.over.entry((task, running.level)).or_default() += (ticks - running.most).0;
                }
                actor.pass(ticks);
            }
        }
    }

    /// Records by how many ticks a task acted late.
    pub(super) fn late(&mut self, task: usize, at: u64, ticks: u64) {
        self.out.behind = self.out.behind.max(ticks);
        if ticks > LATE {
            let address = self.address(task);
            self.out.late.push(Late { at, task: TaskId::from_index(task), address, ticks });
        }
    }

    /// Whether a node acted more than a tick late within the last `inputs` inputs, or will with its next input.
    pub(super) fn was_late(&self, inputs: usize) -> bool {
        let since = self.done.iter().rev().take(inputs).next_back();
        let since = since.map_or(0, |&(task, group)| self.groups[task][group].at);
        let coming = self.next.iter().enumerate().filter_map(|(task, &next)| {
            let node = self.run_state.cell.node_state_of(task);
            let now = self.groups[task].get(next)?.at.saturating_sub(self.starts[node]) / self.tick;
            let due = self.clocks[node] + self.expiry(node)?;
            Some(now.saturating_sub(due))
        });
        self.out.late.iter().any(|late| late.at >= since) || coming.max() > Some(LATE)
    }

    /// Whether two inputs of a task are less than a tick apart, and one of them is the end of a time_out, timer or
    /// delay. The model may order such inputs otherwise than the run, because it puts time_outs first in their tick.
    pub(super) fn is_tied(&self, task: usize) -> bool {
        let next = self.next[task];
        let near = &self.groups[task];
        let near = &near[next.saturating_sub(TIED)..near.len().min(next + 2)];
        near.windows(2).any(|pair| {
            let is_time = |group: &Group| matches!(group.cause, Happened::Time);
            pair[1].at.saturating_sub(pair[0].at) < self.tick && (is_time(&pair[0]) || is_time(&pair[1]))
        })
    }

    /// Lets time pass until a task has done in the model what the run shows for this input.
    pub(super) fn let_time_show(
        &mut self,
        task: usize,
        node: usize,
        (now, counted): (u64, u64),
        group: &Group,
    ) -> Result<(), No> {
        self.let_actions_go_on(node, now);
        let rounding = self.roundings.get(&(task, self.next[task])).copied();
        while self.pending[task].len() < group.turns.len() || !self.has_sent(task, group) {
            let what = || match (group.turns.first(), group.sent.first()) {
                (Some(turn), _) => self.tell(task, turn),
                (None, Some(packet)) => self.sends_what(packet),
                (None, None) => String::new(),
            };
            let Some(expiry) = self.expiry(node) else {
                return Err(No::Never(format!("{}: in the model no time_out runs", what())));
            };
            let then = self.clocks[node] + expiry;
            if then > now + AHEAD {
                let early = then - now;
                return Err(No::Never(format!("{}: in the model {early} ticks later", what())));
            }
            let all = counted.saturating_sub(self.clocks[node]);
            let timer = group.turns.first().and_then(ends).map(|id| (TaskId::from_index(task), id));
            let due = match (timer, rounding) {
                (Some(_), Some(Rounding::Otherwise)) | (None, None) => None,
                (Some(timer), Some(Rounding::First)) => self.end_before_others(node, timer, expiry)?,
                (Some(timer), _) => self.end_one(node, timer, all)?,
                (None, _) => None,
            };
            let due = match due {
                Some(due) => due,
                None => {
                    // A late node counts all missed time at once for communication tasks, but ends timers one by one.
                    let at_once = timer.is_some() == (rounding == Some(Rounding::Otherwise));
                    let ticks = if at_once { expiry.max(all) } else { expiry };
                    if timer.is_none() && self.rest(node).is_some_and(|rest| rest <= ticks) {
                        self.put_timers_off(node, ticks);
                    }
                    self.count(node, ticks)?;
                    then
                }
            };
            self.late(task, group.at, now.saturating_sub(due));
            self.out.ahead = self.out.ahead.max(due.saturating_sub(now));
        }
        Ok(())
    }

    /// The timers and delays of a node, each with the ticks until it ends and the ticks until it was due. The second number
    /// is smaller, perhaps below 0, if the end was put off because a late node has not noticed the end yet.
    fn timers(&mut self, node: usize) -> Vec<(Timer, u64, i64)> {
        let entries = self.run_state.cell.nodes[node].node.parts().timer.entries();
        // A timer that was put off ends with the next tick. If it does not, the timer was started again.
        let known = |timer: &Timer| entries.iter().any(|&(of, id, left)| (of, id) == *timer && left.0 <= 1);
        let here = |of: TaskId| self.run_state.cell.node_state_of(of.index()) == node;
        self.put_off.retain(|timer, _| !here(timer.0) || known(timer));
        let entry = |(of, id, left): (TaskId, TimeId, Ticks)| {
            let put_off = self.put_off.get(&(of, id)).copied().unwrap_or(0);
            let left_once = i64::try_from(left.0).unwrap_or(i64::MAX).saturating_sub_unsigned(put_off);
            ((of, id), left.0, left_once)
        };
        entries.into_iter().map(entry).collect()
    }

    /// Lets `all` ticks pass at once, then ends the given timer, and puts off other timers that are over. If several timers
    /// are due in one tick, any of them may end first; otherwise only the earliest may. Returns the tick in which the timer
    /// was due; `None` if another event comes first, and then nothing was done.
    fn end_one(&mut self, node: usize, timer: Timer, all: u64) -> Result<Option<u64>, No> {
        let timers = self.timers(node);
        let Some(&(.., left)) = timers.iter().find(|(one, ..)| *one == timer) else { return Ok(None) };
        let ticks = all.max(u64::try_from(left).unwrap_or(0));
        let is_first = timers.iter().all(|(.., other)| *other >= left);
        if !is_first || self.rest(node).is_some_and(|rest| rest <= ticks) {
            return Ok(None);
        }
        let due = self.clocks[node].saturating_add_signed(left);
        self.put_timers_off(node, ticks);
        self.count(node, ticks)?;
        self.end_now(node, timer)?;
        Ok(Some(due))
    }

    /// Ticks until time alone makes a node act, apart from its Timer.
    fn rest(&self, node: usize) -> Option<u64> {
        let mut rest = self.run_state.cell.nodes[node].node.clone();
        for (of, id, _) in rest.parts().timer.entries() {
            rest.parts_mut().timer.disarm(of, id);
        }
        rest.time_left().map(|ticks| ticks.0)
    }

    /// Puts off the timers that end within `ticks` to the tick after these: the run shows later when they end.
    fn put_timers_off(&mut self, node: usize, ticks: u64) {
        for ((of, id), left, _) in self.timers(node).into_iter().filter(|(_, left, _)| *left <= ticks) {
            self.run_state.cell.nodes[node].node.parts_mut().timer.put(of, id, Ticks(ticks + 1));
            *self.put_off.entry((of, id)).or_default() += ticks + 1 - left;
        }
    }

    /// Ends a timer before all other events of its tick. Returns that tick. Returns `None` if the timer does not end in the
    /// next tick that has an event.
    fn end_before_others(&mut self, node: usize, timer: Timer, expiry: u64) -> Result<Option<u64>, No> {
        if !self.timers(node).iter().any(|(one, left, _)| *one == timer && *left <= expiry) {
            return Ok(None);
        }
        let due = self.clocks[node] + expiry;
        self.count(node, expiry - 1)?;
        self.end_now(node, timer)?;
        Ok(Some(due))
    }

    fn end_now(&mut self, node: usize, (of, id): Timer) -> Result<(), No> {
        self.put_off.remove(&(of, id));
        self.run_state.cell.nodes[node].node.parts_mut().timer.put(of, id, Ticks::ZERO);
        let step = self.run_state.cell.pass(node, Ticks::ZERO);
        step.map_err(|violation| No::Never(violation.text().into()))?;
        self.made(node)
    }

    /// Whether the task has sent in the model what it sent in the run.
    pub(super) fn has_sent(&self, task: usize, group: &Group) -> bool {
        group.sent.iter().all(|packet| self.sends[task].iter().any(|(_, sent)| sent == packet))
    }
}

/// The timer or delay that ends in this script step.
const fn ends(turn: &Turn) -> Option<TimeId> {
    match turn.input {
        ScriptInput::Signal(Signal::TimeOut(id) | Signal::Interrupt(Call::Timer(id))) => Some(id),
        ScriptInput::Signal(_) | ScriptInput::Begin | ScriptInput::Acted { .. } | ScriptInput::Chosen(_) => {
            None
        }
    }
}

/// Notes whether a node signals or sends anything.
struct Look(bool);

impl NodeOutbox for Look {
    fn link(&mut self, _: imrs_protocol::NodeId, _: Packet) {
        self.0 = true;
    }

    fn signal(&mut self, _: TaskId, _: Signal) {
        self.0 = true;
    }
}
