//! Time of a node that is followed: it counts as the run says, neither past what the run has not shown yet nor less than
//! what it has.

use super::run::{Late, Turn};
use super::{AHEAD, Follower, Group, LATE, No, Rounding};
use imrs_protocol::script::ScriptInput;
use imrs_protocol::{Call, NodeInput, NodeOutbox, Packet, Signal, TaskId, Ticks, TimeId};

impl Follower {
    /// The ticks until time alone makes a node act.
    pub(super) fn expiry(&self, node: usize) -> Option<u64> {
        self.course.floor.stations[node].node.next_expiry().map(|ticks| ticks.0.max(1))
    }

    pub(super) fn count(&mut self, node: usize, ticks: u64) -> Result<(), No> {
        if ticks == 0 {
            return Ok(());
        }
        self.clocks[node] += ticks;
        let step = self.course.floor.step(node, NodeInput::Advance(Ticks(ticks)));
        step.map_err(|violation| No::Never(violation.text().into()))?;
        self.made(node)
    }

    /// Whether so much time shows anything at a node.
    pub(super) fn shows(&self, node: usize, ticks: u64) -> bool {
        let mut look = Look(false);
        self.course.floor.stations[node].node.clone().step(NodeInput::Advance(Ticks(ticks)), &mut look);
        look.0
    }

    /// Lets a node count up to a tick, but not to where time would show: the run shows that later.
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
        let ticks = u32::try_from(now.saturating_sub(self.acts[node])).unwrap_or(u32::MAX);
        self.acts[node] = self.acts[node].max(now);
        for task in 0..self.course.floor.bodies.len() {
            if self.course.floor.station_of(task) == node
                && let Some(actor) = &mut self.course.floor.bodies[task].actor
            {
                self.over.retain(|&(of, level), _| {
                    of != task || actor.running.iter().any(|running| running.level == level)
                });
                for running in actor.running.iter().filter(|running| running.most < ticks) {
                    *self.over.entry((task, running.level)).or_default() += u64::from(ticks - running.most);
                }
                actor.pass(ticks);
            }
        }
    }

    /// A task acts so many ticks after it is time.
    pub(super) fn late(&mut self, task: usize, at: u64, ticks: u64) {
        self.out.behind = self.out.behind.max(ticks);
        if ticks > LATE {
            let address = self.address(task);
            self.out.late.push(Late { at, task: TaskId::from_index(task), address, ticks });
        }
    }

    /// Time makes a task act, as the run says.
    pub(super) fn let_time_show(
        &mut self,
        task: usize,
        node: usize,
        (now, counted): (u64, u64),
        group: &Group,
    ) -> Result<(), No> {
        self.let_actions_go_on(node, now);
        let stepwise = self.steps_timers(task, group);
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
            match self.comes_first(task, group) {
                Some(id) => self.end_first(task, node, id, expiry)?,
                None => {
                    let all = if stepwise { 0 } else { counted.saturating_sub(self.clocks[node]) };
                    self.count(node, expiry.max(all))?;
                }
            }
            self.late(task, group.at, now.saturating_sub(then));
            self.out.ahead = self.out.ahead.max(then.saturating_sub(now));
        }
        Ok(())
    }

    /// The timer or delay that comes first of what ends in its tick, where the run is rounded so and it still runs.
    fn comes_first(&self, task: usize, group: &Group) -> Option<TimeId> {
        if self.roundings.get(&(task, self.next[task])) != Some(&Rounding::First) {
            return None;
        }
        let (id, expiry) = (ends(group.turns.first()?)?, self.expiry(self.course.floor.station_of(task))?);
        let entries =
            self.course.floor.stations[self.course.floor.station_of(task)].node.parts().timer.entries();
        let this = |&&(owner, of, _): &&(TaskId, TimeId, Ticks)| (owner.index(), of) == (task, id);
        entries.iter().find(this).filter(|(.., left)| left.0 <= expiry).map(|_| id)
    }

    /// Counts until right before a tick in which a timer ends, and lets that end before all else in it.
    fn end_first(&mut self, task: usize, node: usize, id: TimeId, expiry: u64) -> Result<(), No> {
        self.count(node, expiry - 1)?;
        self.course.floor.stations[node].node.parts_mut().timer.end_now(TaskId::from_index(task), id);
        let step = self.course.floor.step(node, NodeInput::Advance(Ticks::ZERO));
        step.map_err(|violation| No::Never(violation.text().into()))?;
        self.made(node)
    }

    /// Whether the model's task has sent what the run's did.
    pub(super) fn has_sent(&self, task: usize, group: &Group) -> bool {
        group.sent.iter().all(|packet| self.sends[task].iter().any(|(_, sent)| sent == packet))
    }

    /// A node that is late gives its communication tasks all the time at once, but ends each timer by itself.
    pub(super) fn steps_timers(&self, task: usize, group: &Group) -> bool {
        let otherwise = self.roundings.get(&(task, self.next[task])) == Some(&Rounding::Otherwise);
        group.turns.first().and_then(ends).is_some() != otherwise
    }
}

/// The timer or delay that ends with this turn.
const fn ends(turn: &Turn) -> Option<TimeId> {
    match turn.input {
        ScriptInput::Signal(Signal::TimeOut(id) | Signal::Interrupt(Call::Timer(id))) => Some(id),
        ScriptInput::Signal(_) | ScriptInput::Begin | ScriptInput::Acted { .. } | ScriptInput::Chosen(_) => {
            None
        }
    }
}

/// Whether anything shows.
struct Look(bool);

impl NodeOutbox for Look {
    fn link(&mut self, _: imrs_protocol::NodeId, _: Packet) {
        self.0 = true;
    }

    fn signal(&mut self, _: TaskId, _: Signal) {
        self.0 = true;
    }
}
