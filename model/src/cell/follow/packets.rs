//! Follows the packets of a run: the model must send each of them before it arrives.

use super::words::{named, port_name};
use super::{AHEAD, Follower, No, Rounding};
use crate::cell::judge::name;
use crate::cell_state::InFlight;
use imrs_protocol::{MessageId, NodeInput, Packet, TaskId};

/// The greatest number of moves of a killed node that are guessed for one packet.
const GUESSES: usize = 8;
/// How many of the latest arrived packets are kept, because a copy of a packet arrives soon after it.
const REPEATED: usize = 64;

impl Follower {
    /// Follows the arrival of a packet at a task, which the run shows.
    pub(super) fn packet(
        &mut self,
        task: usize,
        node: usize,
        (now, counted): (u64, u64),
        packet: Packet,
    ) -> Result<(), No> {
        let from = self.run_state.cell.node_state_of(packet.source.index());
        if from == node {
            return Ok(());
        }
        let known =
            self.under_way(&packet).is_some() || self.guess(from, task, &packet) || self.copied(&packet);
        if !known {
            let table = &self.run_state.plan.table;
            let (from, kind) = (name(table, packet.source.index()), packet.kind);
            let port = port_name(table, packet.port);
            let why = format!("{kind:?} of {from} on {port} arrives that the model has not sent");
            return Err(if self.was_sent(&packet) { No::NotYet(why) } else { No::However(why) });
        }
        self.quiet(task, "a packet comes")?;
        self.let_actions_go_on(node, now);
        self.catch_up(node, counted)?;
        let more = u64::from(self.roundings.get(&(task, self.next[task])) == Some(&Rounding::Charged));
        match self.carry(&packet, node, Some(more))? {
            true => Ok(()),
            false => Err(No::Never("a packet arrives that a node on the route drops in the model".into())),
        }
    }

    /// Removes a command's packet that never left its node in the run. In the model every packet leaves at once. The
    /// node of the run reports such a packet before it ends the command, so no time passes here.
    pub(super) fn unsent(&mut self, task: usize, node: usize, id: MessageId) -> Result<(), No> {
        let cell_state = &mut self.run_state.cell;
        let is_it = |carried: &InFlight| {
            let (from, ..) = cell_state.links[usize::from(carried.link)];
            let packet = &carried.packet;
            from.index() == node && packet.source.index() == task && packet.id == id
        };
        // The model, too, never sends a copy that has no time left. Then the sender's node in the model knows this
        // already.
        let Some(at) = cell_state.in_flight.iter().position(is_it) else { return Ok(()) };
        cell_state.in_flight.remove(at);
        let step = cell_state.step(node, NodeInput::Unsent(TaskId::from_index(task), id));
        step.map_err(|violation| No::Never(violation.text().into()))?;
        self.made(node)
    }

    /// Whether the recording of the packet's source shows this packet, or is incomplete.
    fn was_sent(&self, packet: &Packet) -> bool {
        let source = packet.source.index();
        let mut sent = self.groups[source].iter().flat_map(|group| &group.sent);
        let is_whole = self.whole.get(self.run_state.cell.node_state_of(source)).copied().unwrap_or(true);
        !is_whole || sent.any(|sent| *sent == named(packet))
    }

    /// Carries a packet along its route to a node. Returns false if a node on the route drops the packet. `more`: by how
    /// many ticks the packet was charged more in the run than in the model; `None` if the run does not show its remaining
    /// time.
    fn carry(&mut self, packet: &Packet, node: usize, more: Option<u64>) -> Result<bool, No> {
        while let Some(i) = self.under_way(packet) {
            let carried = self.run_state.cell.in_flight.remove(i);
            let (_, to, bound) = self.run_state.cell.links[usize::from(carried.link)];
            let last = to.index() == node;
            // Ticks that the packet was charged beyond the link's bound, rounded down (D20).
            let left = carried.packet.remaining.0.saturating_sub(u64::from(bound)) * self.tick;
            let over = match more.filter(|_| last) {
                Some(more) => left.saturating_sub(packet.remaining.0) / self.tick + more,
                None => 0,
            };
            if last {
                self.arrived.truncate(REPEATED - 1);
                self.arrived.push_front(carried);
            }
            let step = self.run_state.cell.deliver(carried, u8::try_from(over).unwrap_or(u8::MAX));
            step.map_err(|violation| No::Never(violation.text().into()))?;
            self.made(to.index())?;
            if last {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Guesses moves of a killed node that lead to this packet, because the node may have done more than its recording
    /// shows. The function tries the newest packet in flight to the node first.
    fn guess(&mut self, node: usize, task: usize, wanted: &Packet) -> bool {
        let over = (0..self.next.len()).filter(|&task| self.run_state.cell.node_state_of(task) == node);
        let mut over = over.map(|task| self.next[task] == self.groups[task].len());
        if self.whole.get(node).copied().unwrap_or(true) || !over.all(|over| over) {
            return false;
        }
        let at = self.groups[task].get(self.next[task]).map_or(0, |group| group.at);
        let now = at.saturating_sub(self.starts[node]) / self.tick;
        self.let_actions_go_on(node, now);
        for _ in 0..GUESSES {
            let to = |packet: &Packet| self.run_state.cell.node_state_of(packet.destination.index()) == node;
            let coming = self.run_state.cell.in_flight.iter().map(|carried| carried.packet);
            let coming: Vec<Packet> = coming.filter(to).collect();
            let mut trials: Vec<Self> = Vec::new();
            for packet in coming.iter().rev() {
                let mut trial = self.clone();
                if matches!(trial.carry(packet, node, None), Ok(true)) {
                    trials.push(trial);
                }
            }
            for (task, level) in self.may_end(node) {
                let mut trial = self.clone();
                trial.run_state.cell.acted(task, level, true, 0);
                if trial.made(node).is_ok() {
                    trials.push(trial);
                }
            }
            let mut later = self.clone();
            if let Some(expiry) = later.expiry(node)
                && later.clocks[node] + expiry <= now + AHEAD
                && later.count(node, expiry).is_ok()
            {
                trials.push(later);
            }
            let found = trials.iter().position(|trial| trial.like(wanted).is_some());
            let Some(next) = (!trials.is_empty()).then(|| trials.swap_remove(found.unwrap_or(0))) else {
                return false;
            };
            *self = next;
            self.guessed += 1;
            if let Some(at) = self.like(wanted) {
                // The recording does not show the results of the killed node's actions, nor the contents that follow from
                // them.
                self.run_state.cell.in_flight[at].packet.contents = wanted.contents;
                return true;
            }
        }
        false
    }

    /// Puts a copy of a packet in flight if a link may have made the copy: the packet has arrived before, and its source
    /// does not send it again.
    fn copied(&mut self, packet: &Packet) -> bool {
        let source = packet.source.index();
        let mut to_come = self.groups[source][self.next[source]..].iter().flat_map(|group| &group.sent);
        let again = to_come.any(|sent| *sent == named(packet));
        let before = self.arrived.iter().find(|carried| named(&carried.packet) == named(packet)).copied();
        let Some(carried) = before.filter(|_| !again) else { return false };
        self.run_state.cell.in_flight.push(carried);
        true
    }

    /// The actions on a node that may end now.
    fn may_end(&self, node: usize) -> Vec<(usize, u8)> {
        let cell_state = &self.run_state.cell;
        let here = (0..cell_state.bodies.len()).filter(|&task| cell_state.node_state_of(task) == node);
        let actors = here.filter_map(|task| Some((task, cell_state.bodies[task].actor.as_ref()?)));
        let running = actors.flat_map(|(task, actor)| actor.running.iter().map(move |action| (task, action)));
        running
            .filter(|(_, action)| action.least.is_zero())
            .map(|(task, action)| (task, action.level))
            .collect()
    }

    /// The packet in flight that differs from `packet` only in its contents.
    fn like(&self, packet: &Packet) -> Option<usize> {
        let like = |other: &Packet| named(&Packet { contents: packet.contents, ..*other }) == named(packet);
        self.run_state.cell.in_flight.iter().position(|carried| like(&carried.packet))
    }

    /// Of the packets in flight in the model that equal `packet`, the one whose remaining time is nearest to that of
    /// `packet`.
    pub(super) fn under_way(&self, packet: &Packet) -> Option<usize> {
        let left = packet.remaining.0 / self.tick;
        let same = |other: &Packet| named(other) == named(packet);
        let cell_state = &self.run_state.cell;
        let all = cell_state.in_flight.iter().enumerate().filter(|(_, carried)| same(&carried.packet));
        let distance = |at: usize| {
            let carried = &cell_state.in_flight[at];
            let charge = u64::from(cell_state.links[usize::from(carried.link)].2);
            carried.packet.remaining.0.saturating_sub(charge).abs_diff(left)
        };
        all.map(|(at, _)| at).min_by_key(|&at| distance(at))
    }

    /// Counts packets in flight at the end of the run as lost. This includes packets that were sent just before the end.
    pub(super) fn count_lost(&mut self) {
        let cell_state = &self.run_state.cell;
        for (at, (from, to, _)) in cell_state.links.iter().enumerate() {
            let left = cell_state.in_flight.iter().filter(|carried| usize::from(carried.link) == at).count();
            if left > 0 {
                self.out.lost.push((from.index(), to.index(), left as u64));
            }
        }
    }
}
