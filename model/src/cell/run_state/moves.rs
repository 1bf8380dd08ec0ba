//! Lists the moves that a cell state allows.

use super::{CellMove, OPEN, RunState, UNUSED, bit, small};
use crate::cell::plan::{Conduct, Times};
use crate::cell_state::script::Running;
use crate::cell_state::{CellState, InFlight};
use imrs_protocol::Ticks;

/// Events that are farther away than this are left out, because packed states have no space for such times.
const LATEST: Ticks = Ticks(u32::MAX as u64);

impl CellState {
    /// Whether another packet is ahead of this one on its link.
    pub(in crate::cell) fn is_behind(&self, packet: usize) -> bool {
        let link = self.in_flight.get(packet).map(|carried| carried.link);
        self.in_flight.iter().take(packet).any(|other| Some(other.link) == link)
    }

    /// Whether another packet is behind this one on its link.
    pub(in crate::cell) fn is_followed(&self, packet: usize) -> bool {
        let link = self.in_flight.get(packet).map(|carried| carried.link);
        self.in_flight.iter().skip(packet + 1).any(|other| Some(other.link) == link)
    }
}

impl RunState {
    /// Adds the possible moves: the moves of the first node that has something to do in this tick. Time passes only if no
    /// node has a move.
    pub fn moves(&self, moves: &mut Vec<CellMove>) {
        for node in 0..self.cell.nodes.len() {
            self.turn(node, moves);
            if !moves.is_empty() {
                return;
            }
        }
        for (at, (&node, &crashed)) in self.faults.crash.iter().zip(&self.beside.crashed).enumerate() {
            let earlier = self.faults.crash[..at].iter().zip(&self.beside.crashed);
            let first = !earlier.into_iter().any(|(&other, &done)| other == node && done == 0);
            let acted = self.plan.everything || self.beside.acted & bit(node.index()) != 0;
            if crashed == 0 && first && acted && self.cell.nodes[node.index()].up {
                moves.push(CellMove::Crash(small(at)));
            }
        }
        let goes_on = self.goes_on();
        let now = |i: usize| self.plan.everything || !goes_on || self.beside.acted & bit(i) != 0;
        self.pauses_between(moves);
        let down = (0..self.cell.nodes.len()).filter(|&i| self.is_down(i) && now(i));
        moves.extend(down.map(|i| CellMove::Restart(small(i))));
        if !goes_on {
            return;
        }
        moves.push(CellMove::Pass);
        if self.beside.drift > 0 {
            let up = (0..self.cell.nodes.len()).filter(|&i| self.cell.nodes[i].up);
            moves.extend(up.flat_map(|i| [true, false].map(|more| CellMove::Drift(small(i), more))));
        }
    }

    /// Adds the moves of a node in this tick.
    fn turn(&self, node: usize, moves: &mut Vec<CellMove>) {
        if self.is_asleep(node) {
            if self.must_wake(node) {
                moves.push(CellMove::Wake(small(node)));
            }
            return;
        }
        let cell_state = &self.cell;
        let here = |&task: &usize| cell_state.node_state_of(task) == node;
        let up = cell_state.nodes[node].up;
        let tasks = || (0..cell_state.bodies.len()).filter(here).filter(|_| up);
        for task in tasks() {
            let chooses = cell_state.bodies[task].actor.as_ref().and_then(|actor| actor.chooses());
            if let Some(alternatives) = chooses {
                moves.extend((0..alternatives).map(|choice| CellMove::Choose(small(task), choice)));
                return;
            }
        }
        let busy = cell_state.is_busy(node) || self.begins_next(node).is_some();
        for task in tasks() {
            let Some(actor) = &cell_state.bodies[task].actor else { continue };
            for action in &actor.running {
                self.ends(task, action, moves);
            }
        }
        let mut comes = false;
        let waited = self.longest_wait(node);
        for (i, carried) in cell_state.in_flight.iter().enumerate() {
            let (_, to, bound) = cell_state.links[usize::from(carried.link)];
            let bound = Ticks(bound.into());
            let ahead = cell_state.in_flight[..i].iter().find(|other| other.link == carried.link);
            match ahead {
                _ if to.index() != node => {}
                None if carried.age - bound < waited => {}
                None if carried.age >= bound => {
                    self.arrivals(small(i), carried.link, moves);
                    comes = true;
                }
                None if up && self.may_come_early(carried) => {
                    // An open cut may end with an early packet, too. Otherwise a state with an open cut would allow
                    // fewer moves than a state whose cut is over.
                    let open = self.cut_of(carried.link, OPEN);
                    let comes = open.map_or(CellMove::Deliver(small(i)), |cut| CellMove::Mend(small(i), cut));
                    moves.extend([comes, CellMove::Stay(carried.link)]);
                }
                // A packet overtakes as late as possible: when the packet ahead is about to arrive. It never overtakes in
                // the tick in which it was sent.
                Some(ahead)
                    if ahead.age >= bound && !carried.age.is_zero() && self.may_overtake(carried.link) =>
                {
                    moves.push(CellMove::Deliver(small(i)));
                }
                None | Some(_) => {}
            }
        }
        if busy {
            return self.turn_within(node, moves);
        }
        if comes && !up && !self.plan.everything {
            moves.push(CellMove::Restart(small(node)));
        }
        if !moves.is_empty() {
            self.pauses(node, moves);
        }
    }

    /// Adds the moves of a node in which inputs of tasks wait or scripts are about to begin (D170). Other moves are added
    /// only if they give a task an input, or let the next packet of a link give one. Postponing an action or packet, and
    /// losing the last packet of a link, change nothing for tasks with waiting inputs, so these moves are tried when no
    /// input waits.
    fn turn_within(&self, node: usize, moves: &mut Vec<CellMove>) {
        let cell_state = &self.cell;
        // A task takes no other input before it has noticed the time.
        let knows = |task: usize| cell_state.notices_all(node, task);
        let comes = |i: u8| knows(cell_state.in_flight[usize::from(i)].packet.destination.index());
        moves.retain(|&step| match step {
            CellMove::Acted(task, ..) => knows(usize::from(task)),
            CellMove::Deliver(i) | CellMove::Duplicate(i) | CellMove::Mend(i, _) => comes(i),
            CellMove::Lose(i) | CellMove::Cut(i, _) | CellMove::Vanish(i) => {
                cell_state.is_followed(usize::from(i))
            }
            _ => false,
        });
        let takes = cell_state.next_inputs(node).map(|at| CellMove::Take(small(node), small(at)));
        moves.splice(..0, takes.chain(self.may_begin(node).then_some(CellMove::Begin(small(node)))));
    }

    /// Whether packets may overtake each other on a link: not while the link is cut.
    fn may_overtake(&self, link: u8) -> bool {
        self.beside.reorder > 0 && self.cut_of(link, OPEN).is_none()
    }

    /// The first declared cut of a link, in either direction, whose state (not begun, open or over) is `at`.
    fn cut_of(&self, link: u8, at: u8) -> Option<u8> {
        let mut cuts = self.faults.cut.iter().zip(&self.beside.cuts);
        cuts.position(|(&of, &state)| of == usize::from(link) / 2 && state == at).map(small)
    }

    fn may_come_early(&self, carried: &InFlight) -> bool {
        self.times != Times::Ends
            && !carried.age.is_zero()
            && self.beside.slow & bit(usize::from(carried.link)) == 0
    }

    fn ends(&self, task: usize, action: &Running, moves: &mut Vec<CellMove>) {
        if !action.least.is_zero() || self.beside.stays.contains(&(small(task), action.level)) {
            return;
        }
        let (task, level) = (small(task), action.level);
        let values = self.values(usize::from(task), action.action).len().max(1);
        moves.extend((0..values).map(|value| CellMove::Acted(task, level, true, small(value))));
        if self.beside.fail > 0 {
            moves.push(CellMove::Acted(task, level, false, 0));
        }
        // With symbolic times, the search by zones chooses the times at which the action goes on.
        if self.cell.is_symbolic || !action.most.is_zero() {
            moves.push(CellMove::GoOn(task, level));
        }
    }

    fn values(&self, task: usize, action: u16) -> &[i32] {
        match &self.plan.tasks[task] {
            Conduct::Program { values, .. } => values.get(usize::from(action)).map_or(&[], Vec::as_slice),
            Conduct::Extern(_) => &[],
        }
    }

    /// The result of an action at a position among its values; 0 if the action has no values.
    pub fn value(&self, task: usize, level: u8, value: u8) -> i32 {
        let actor = self.cell.bodies[task].actor.as_ref();
        let running = actor.and_then(|actor| actor.runs(level));
        let values = running.map_or(&[][..], |action| self.values(task, action.action));
        values.get(usize::from(value)).copied().unwrap_or(0)
    }

    fn arrivals(&self, i: u8, link: u8, moves: &mut Vec<CellMove>) {
        if let Some(number) = self.cut_of(link, OPEN) {
            moves.extend([CellMove::Vanish(i), CellMove::Mend(i, number)]);
            return;
        }
        moves.push(CellMove::Deliver(i));
        if self.beside.loss > 0 {
            moves.push(CellMove::Lose(i));
        }
        if self.beside.dup > 0 {
            moves.push(CellMove::Duplicate(i));
        }
        if let Some(number) = self.cut_of(link, UNUSED) {
            moves.push(CellMove::Cut(i, number));
        }
    }

    /// The time until the next event, at least a tick; `None` if no event is to come. With symbolic times the result is
    /// always one tick: `zones` has already let all ticks pass in which nothing happens.
    pub fn next_event(&self) -> Option<Ticks> {
        if self.cell.is_symbolic {
            return Some(Ticks(1));
        }
        let next = self.events().min()?.max(Ticks(1));
        (next <= LATEST).then_some(next)
    }

    /// Whether any event is to come.
    fn goes_on(&self) -> bool {
        // With symbolic times, `events` asks the zone which events come in the next tick; this code asks only whether
        // any event comes.
        if self.cell.is_symbolic {
            return self.limits().any(|left| left <= LATEST);
        }
        self.events().any(|left| left <= LATEST)
    }

    /// The times until all events that are to come.
    fn events(&self) -> impl Iterator<Item = Ticks> {
        let cell_state = &self.cell;
        let packets = cell_state.in_flight.iter().filter(|carried| !self.waits(carried)).map(|carried| {
            let left = self.left_of(carried);
            match self.times {
                Times::Between | Times::Every if carried.age.is_zero() => left.min(Ticks(1)),
                _ => self.to_next_step(left),
            }
        });
        let ends = (0..cell_state.bodies.len())
            .flat_map(|task| self.going(task))
            .map(|action| if action.least.is_zero() { self.to_next_step(action.most) } else { action.least });
        packets.chain(ends).chain(self.fixed_events())
    }

    /// The times that may not pass without an event: until the bounds of packets, the most times of actions, and all events
    /// that do not happen earlier.
    pub fn limits(&self) -> impl Iterator<Item = Ticks> {
        let packets = self.cell.in_flight.iter().filter(|carried| !self.waits(carried));
        let ends = (0..self.cell.bodies.len()).flat_map(|task| self.going(task));
        // An action without an end may end at its least time, or right after an event.
        let ends =
            ends.map(|action| if action.most == Running::FOREVER { action.least } else { action.most });
        packets.map(|carried| self.left_of(carried)).chain(ends).chain(self.fixed_events())
    }

    /// The times until all events to come that cannot happen earlier than at a fixed instant.
    fn fixed_events(&self) -> impl Iterator<Item = Ticks> {
        let cell_state = &self.cell;
        let up = || (0..cell_state.nodes.len()).filter(|&i| cell_state.nodes[i].up);
        let awake = || up().filter(|&i| !self.is_asleep(i));
        let nodes = awake().flat_map(|i| cell_state.nodes[i].node.times_left());
        let paused = up().filter(|&i| self.is_asleep(i)).flat_map(|i| self.events_asleep(i)).map(Ticks);
        // A `leads` check fails only after the last tick of its bound, which is one tick later.
        let due = self.beside.due.iter().flatten().map(|&left| left + Ticks(1));
        let held_back = awake().filter_map(|i| self.next_begin(i));
        nodes.chain(paused).chain(due).chain(held_back)
    }

    /// Whether a packet waits at the end of its link for a paused node.
    fn waits(&self, carried: &InFlight) -> bool {
        let (_, to, bound) = self.cell.links[usize::from(carried.link)];
        self.is_asleep(to.index()) && carried.age >= Ticks(bound.into())
    }

    /// The time until a packet reaches its link's bound.
    fn left_of(&self, carried: &InFlight) -> Ticks {
        Ticks(self.cell.links[usize::from(carried.link)].2.into()) - carried.age
    }

    /// The actions of this task that still may or must end. An action that is over on a paused node is no event.
    fn going(&self, task: usize) -> impl Iterator<Item = &Running> {
        let asleep = self.is_asleep(self.cell.node_state_of(task));
        let running = self.cell.bodies[task].actor.iter().flat_map(|actor| &actor.running);
        running.filter(move |action| {
            let endless = action.most == Running::FOREVER && action.least.is_zero();
            let over = asleep && action.most.is_zero();
            !endless && !over && self.has_begun(task, action.level)
        })
    }
}
