//! Pauses: for a while a node takes no step, as when its process is stopped (SIGSTOP) or frozen, or gets no processor.
//!
//! ```text
//!   a step is due at the node --Pause--> asleep: packets wait at the end of their links, actions go on, nothing is noticed
//!                                           |
//!                                          Wake: time first (all of it at once: leases and deadlines), then what waits,
//!                                                charged with its wait; then actions that ended meanwhile
//! ```
//!
//! A pause begins right before something that its node would do: to everybody it is the same pause if it began earlier,
//! after the node's last step, and it may last longest so. It ends after any event of the cell, when the node's own next
//! deadline or lease is over, or when it has lasted as long as it may.
//!
//! An action of a paused node goes on by itself. One that began in the tick of the pause may also begin only after it: the
//! process was stopped between the decision and the deed. The lease of a paused task ends on time: what drives its robot
//! stops it then (D149), so from then on the task does not act, although it does not know it yet.

use super::{CellMove, Course, bit, small};
use crate::cell::plan::Pause;
use crate::floor::Floor;
use crate::floor::script::{Actor, Running};
use crate::state::Violation;
use imrs_protocol::Ticks;
use imrs_protocol::script::Op;

/// A node that is paused. How long it has slept is in the floor: see [`Station::asleep`](crate::floor::Station::asleep).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::cell) struct Asleep {
    /// For how many ticks it may stay so.
    pub left: u32,
    /// Actions that begin only when it goes on: task and thread.
    pub held: Vec<(u8, u8)>,
}

impl Floor {
    /// How many ticks have passed since the node's pause began; none where it is not paused.
    pub(in crate::cell) fn slept(&self, node: usize) -> Option<u32> {
        self.stations[node].asleep
    }
}

impl Course {
    pub fn is_asleep(&self, node: usize) -> bool {
        self.beside.asleep[node].is_some()
    }

    /// Whether a node has been paused for as long as it may be.
    pub fn must_wake(&self, node: usize) -> bool {
        self.beside.asleep[node].as_ref().is_some_and(|asleep| asleep.left == 0)
    }

    /// The pauses that may begin at a node now, by their numbers. Of equal ones only the first.
    fn unused(&self, node: usize) -> impl Iterator<Item = u8> {
        let all = || self.faults.pause.iter().zip(&self.beside.paused);
        let unused = move |&(at, (pause, &left)): &(usize, (&Pause, &u8))| {
            left > 0 && pause.is_of(node) && !all().take(at).any(|(other, &left)| left > 0 && other == pause)
        };
        all().enumerate().filter(unused).map(|(at, _)| small(at))
    }

    /// Instead of what a node would do in this tick, it may pause.
    pub fn pauses(&self, node: usize, moves: &mut Vec<CellMove>) {
        if self.faults.pause.is_empty() || !self.floor.stations[node].up {
            return;
        }
        moves.extend(self.unused(node).map(|number| CellMove::Pause(number, small(node))));
        self.pauses_before(node, moves);
    }

    /// A node may pause before the actions that it has just begun.
    fn pauses_before(&self, node: usize, moves: &mut Vec<CellMove>) {
        if !self.fresh(node).is_empty() {
            moves.extend(self.unused(node).map(|number| CellMove::PauseBefore(number, small(node))));
        }
    }

    /// What pauses may do when no node has anything to do in this tick.
    pub fn pauses_between(&self, next: Option<u32>, moves: &mut Vec<CellMove>) {
        if self.faults.pause.is_empty() {
            return;
        }
        for node in (0..self.floor.stations.len()).filter(|&node| self.floor.stations[node].up) {
            if self.is_asleep(node) {
                // Without a tick that passed it is no pause.
                if self.floor.slept(node) > Some(0) {
                    moves.push(CellMove::Wake(small(node)));
                }
                continue;
            }
            let at = small(node);
            self.pauses_before(node, moves);
            if next.is_some_and(|next| self.notices(node, next)) {
                moves.extend(self.unused(node).map(|number| CellMove::PauseNext(number, at)));
            } else if self.plan.everything && next.is_some() {
                moves.extend(self.unused(node).map(|number| CellMove::Pause(number, at)));
            }
        }
    }

    /// Whether a node does something by itself when so many ticks pass.
    fn notices(&self, node: usize, ticks: u32) -> bool {
        let due = self.floor.stations[node].node.time_left().map(|due| due.0);
        let begins = self.next_begin(node);
        due.into_iter().chain(begins).any(|due| due <= u64::from(ticks))
    }

    /// The actions of a node that began in this tick: those whose times are still what their statements say.
    fn fresh(&self, node: usize) -> Vec<(u8, u8)> {
        let floor = &self.floor;
        let here = (0..floor.bodies.len()).filter(|&task| floor.station_of(task) == node);
        let actions = here.flat_map(|task| {
            let actor = floor.bodies[task].actor.as_ref();
            let running =
                actor.into_iter().flat_map(|actor| actor.running.iter().map(move |one| (actor, one)));
            running
                .filter(|(actor, action)| self.has_just_begun(actor, action))
                .map(move |(_, action)| (small(task), action.level))
        });
        actions.collect()
    }

    /// Whether an action has the times that its statement gives it: no tick has passed since it began.
    fn has_just_begun(&self, actor: &Actor, running: &Running) -> bool {
        let length = |ticks: Ticks| u32::try_from(ticks.0).unwrap_or(Running::FOREVER);
        let at = actor.script.position_at(running.level);
        match at.and_then(|at| actor.program.code.get(usize::from(at))) {
            Some(&Op::Run { action, least, most, .. }) => {
                action == running.action
                    && running.most > 0
                    && (length(least), length(most)) == (running.least, running.most)
            }
            _ => false,
        }
    }

    /// A pause begins.
    pub fn fall_asleep(&mut self, number: u8, node: usize, held: Vec<(u8, u8)>) {
        let number = usize::from(number);
        self.beside.paused[number] = 0;
        self.beside.asleep[node] = Some(Asleep { left: self.faults.pause[number].most, held });
        self.floor.stations[node].asleep = Some(0);
    }

    /// A pause begins before the actions that began in this tick.
    pub fn fall_asleep_before(&mut self, number: u8, node: usize) {
        let held = self.fresh(node);
        self.fall_asleep(number, node, held);
    }

    /// A node that stops is not paused any more.
    pub fn forget_pause(&mut self, node: usize) {
        self.beside.asleep[node] = None;
        self.floor.stations[node].asleep = None;
    }

    /// A node goes on: first it looks at the time, and so at its leases and deadlines; then it takes what waits for it.
    pub fn wake(&mut self, node: usize) -> Result<(), Violation> {
        let slept = self.floor.slept(node).unwrap_or(0);
        self.forget_pause(node);
        self.notice(node, slept, slept)
    }

    /// Time passes for a node that is paused.
    pub fn sleep_on(&mut self, node: usize, (ticks, counted): (u32, u32)) {
        if let (Some(slept), Some(asleep)) =
            (&mut self.floor.stations[node].asleep, &mut self.beside.asleep[node])
        {
            *slept = slept.saturating_add(counted);
            asleep.left = asleep.left.saturating_sub(ticks);
        }
    }

    /// A node notices that so many ticks have passed, of which its clock has counted so many.
    pub fn notice(&mut self, node: usize, ticks: u32, counted: u32) -> Result<(), Violation> {
        let due = self.floor.stations[node].node.time_left();
        if due.is_some_and(|due| due.0 <= u64::from(counted)) {
            self.beside.acted |= bit(node);
        }
        if counted > 0 {
            self.floor.pass(node, Ticks(u64::from(counted)))?;
        }
        self.hold_back_on(node, ticks);
        Ok(())
    }

    /// Time passes for actions, whether their nodes notice or not, but not for those that have not really begun.
    pub fn act_on(&mut self, ticks: u32) {
        for task in 0..self.floor.bodies.len() {
            let node = self.floor.station_of(task);
            let up = self.floor.stations[node].up;
            let Some(actor) = self.floor.bodies[task].actor.as_mut().filter(|_| up) else { continue };
            match &self.beside.asleep[node] {
                Some(asleep) if !asleep.held.is_empty() => {
                    let begun = |level| !asleep.held.contains(&(small(task), level));
                    actor.pass_for(ticks, begun);
                }
                _ => actor.pass(ticks),
            }
        }
    }

    /// Whether an action goes on: not one that begins only after a pause.
    pub fn has_begun(&self, task: usize, level: u8) -> bool {
        let asleep = self.beside.asleep[self.floor.station_of(task)].as_ref();
        asleep.is_none_or(|asleep| !asleep.held.contains(&(small(task), level)))
    }

    /// In how many ticks a node that is paused may go on, or what it would have done by itself is due.
    pub fn events_asleep(&self, node: usize) -> impl Iterator<Item = u64> {
        let slept = u64::from(self.floor.slept(node).unwrap_or(0));
        let left = self.beside.asleep[node].as_ref().map(|asleep| asleep.left);
        let machines = &self.floor.stations[node].node;
        let due = machines.time_left();
        let leases = machines.parts().tasks.iter().filter_map(imrs_protocol::CommTask::lease_left);
        let own = leases.chain(due).filter_map(move |due| due.0.checked_sub(slept)).filter(|left| *left > 0);
        own.chain(left.filter(|left| *left > 0).map(|left| u64::from(self.to_next_step(left))))
    }

    /// For how long a packet has waited at the end of its link for a node that was paused.
    pub fn has_waited(&self, packet: usize) -> u32 {
        self.floor.crossings.get(packet).map_or(0, |crossing| {
            let bound = self.floor.links[usize::from(crossing.link)].2;
            crossing.age.saturating_sub(u32::from(bound))
        })
    }

    /// The longest that a packet has waited for a node. Packets are taken in the order in which they came.
    pub fn longest_wait(&self, node: usize) -> u32 {
        if self.faults.pause.is_empty() {
            return 0;
        }
        let here = (0..self.floor.crossings.len()).filter(|&i| {
            let link = usize::from(self.floor.crossings[i].link);
            self.floor.links[link].1.index() == node && !self.floor.is_behind(i)
        });
        here.map(|i| self.has_waited(i)).max().unwrap_or(0)
    }
}
