//! Which packets no future of a communication task can notice (a reduction for the model checker).

use super::rendezvous::Rendezvous;
use super::{CommTask, Role};
use crate::ids::{Incarnation, PortId, Round, TaskId};
use crate::packet::{Kind, Packet};
use crate::table::NodeTable;
use crate::ticks::Ticks;

impl CommTask {
    /// Whether this task's behaviour is the same with and without `packet`, whenever it arrives. Conservative: false
    /// where that is not certain. Counters and observations do not count. `source` is the packet's sender now; in a
    /// world whose nodes never restart, an answer that it would ignore need not be provoked.
    #[must_use]
    pub fn ignores(&self, table: &NodeTable, packet: &Packet, source: &Self) -> bool {
        match self.role(packet.port) {
            Some(Role::Meets(meeting)) => {
                // An ABORT in answer would still take an arrival from a CONFIRM that the source owes.
                let round = packet.meeting().round;
                let over_there =
                    source.is_over(packet.port, round) && source.owes(packet.port) != Some(round);
                self.meetings[usize::from(meeting)].ignores(table, packet, over_there)
            }
            // An answer to a request that has ended, or to none.
            Some(Role::Asks(_) | Role::Hears)
                if matches!(packet.kind, Kind::Reply | Kind::Response | Kind::Control) =>
            {
                let awaited = self.outstanding().any(|(_, _, id)| id == packet.id);
                table.rules().refuse_late_replies && !awaited
            }
            Some(
                Role::Sends | Role::Asks(_) | Role::Receives(_) | Role::Replies | Role::Hears | Role::Beats,
            )
            | None => false,
        }
    }

    /// Whether this task will never again wait in `round` of a waitfor port, or never does at all.
    #[must_use]
    pub fn is_over(&self, port: PortId, round: Round) -> bool {
        let Some(Role::Meets(meeting)) = self.role(port) else { return true };
        let rendezvous = &self.meetings[usize::from(meeting)];
        rendezvous.numbered && rendezvous.is_over(round)
    }

    /// The round of a waitfor port whose CONFIRM this task still has to send, or to send again.
    #[must_use]
    pub fn owes(&self, port: PortId) -> Option<Round> {
        let Some(Role::Meets(meeting)) = self.role(port) else { return None };
        let rendezvous = &self.meetings[usize::from(meeting)];
        rendezvous.released.filter(|_| rendezvous.owes_confirm || rendezvous.copies_left > 0)
    }

    /// The life in which this task last heard a member of a waitfor port.
    #[must_use]
    pub fn heard_in(&self, table: &NodeTable, port: PortId, member: TaskId) -> Option<Incarnation> {
        let Some(Role::Meets(meeting)) = self.role(port) else { return None };
        let member = table.port(port)?.party_index(member)?;
        self.meetings[usize::from(meeting)].members[member].life
    }

    /// Forgets the CONFIRM that is still to be sent: for a checker that knows that everybody would ignore it.
    pub fn settle(&mut self, port: PortId) {
        if let Some(Role::Meets(meeting)) = self.role(port) {
            let rendezvous = &mut self.meetings[usize::from(meeting)];
            rendezvous.owes_confirm = false;
            (rendezvous.copies_left, rendezvous.copy_at) = (0, Ticks::FAR);
            self.heads.touch_meeting(&self.meetings, meeting);
        }
    }
}

impl Rendezvous {
    fn ignores(&self, table: &NodeTable, packet: &Packet, over_there: bool) -> bool {
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
