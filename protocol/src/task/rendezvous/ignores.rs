//! Packets that a rendezvous will never notice, whatever happens later: a reduction for the model checker.

use super::{Meetings, Rendezvous};
use crate::ids::{Incarnation, Round, TaskId};
use crate::packet::{Kind, Packet};
use crate::table::{NodeTable, Port};
use crate::ticks::Instant;

impl Rendezvous {
    /// The incarnation of a member from which this task last heard.
    pub fn heard_in(&self, port: &Port, member: TaskId) -> Option<Incarnation> {
        self.members[port.party_index(member)?].incarnation
    }

    /// The round for which this task has yet to send CONFIRM, or to send it again.
    pub fn owes(&self) -> Option<Round> {
        self.released.filter(|_| self.owes_confirm || self.copies_left > 0)
    }

    /// Whether the task will never again wait in `round`.
    pub fn never_again(&self, round: Round) -> bool {
        self.numbered && self.is_over(round)
    }

    /// Whether the task behaves the same with and without a packet of another member. `over_there` says that the sender
    /// would ignore an answer.
    pub fn ignores(&self, table: &NodeTable, packet: &Packet, over_there: bool) -> bool {
        if !self.numbered {
            return false;
        }
        let meeting = packet.meeting();
        let over =
            self.is_over(meeting.round) && !(self.owes_confirm && self.released == Some(meeting.round));
        let told = meeting.released != meeting.round && meeting.released == self.announced;
        let hint = told && self.deadline.is_some();
        match packet.kind {
            Kind::Confirm | Kind::Abort => over,
            Kind::Arrive => over && !hint && (over_there || !table.rules().answer_late_arrivals),
            Kind::Send | Kind::Query | Kind::Reply | Kind::Response | Kind::Control => false,
        }
    }
}

impl Meetings {
    /// Drops the CONFIRM that a rendezvous has yet to send.
    pub fn settle(&mut self, meeting: u16) {
        let rendezvous = &mut self.list[usize::from(meeting)];
        rendezvous.owes_confirm = false;
        (rendezvous.copies_left, rendezvous.copy_at) = (0, Instant::NEVER);
        self.touch(meeting);
    }
}
