//! Which packets no future of a communication task can notice (a reduction for the model checker).

use super::rendezvous::Rendezvous;
use super::{CommTask, Role};
use crate::ids::Round;
use crate::packet::{Kind, Packet};
use crate::table::NodeTable;

impl CommTask {
    /// Whether this task's behaviour is the same with and without `packet`, whenever it arrives. Conservative: false
    /// where that is not certain. Counters and observations do not count.
    #[must_use]
    pub fn ignores(&self, table: &NodeTable, packet: &Packet) -> bool {
        match self.role(packet.port) {
            Some(Role::Meets(meeting)) => {
                let first_life = self.incarnation == packet.id.incarnation;
                first_life && self.meetings[usize::from(meeting)].ignores(table, packet)
            }
            // An answer to a request that has ended, or to none.
            Some(Role::Sends) if matches!(packet.kind, Kind::Reply | Kind::Control) => {
                table.rules().refuse_late_replies && self.awaits().is_none_or(|(_, id)| id != packet.id)
            }
            Some(Role::Sends | Role::Receives(_)) | None => false,
        }
    }
}

impl Rendezvous {
    fn ignores(&self, table: &NodeTable, packet: &Packet) -> bool {
        if !self.numbered {
            return false;
        }
        let meeting = packet.meeting();
        let waiting = self.deadline.is_some();
        // Rounds only grow: this one will never be waited in again.
        let over = |round: Round| {
            self.announced.is_newer_than(round) || (round == self.announced && !waiting && !self.owes_confirm)
        };
        let hint = meeting.released != meeting.round && waiting && meeting.released == self.announced;
        match packet.kind {
            Kind::Confirm => over(meeting.round),
            Kind::Arrive => !table.rules().answer_late_arrivals && over(meeting.round) && !hint,
            Kind::Abort => {
                over(meeting.round) && !meeting.next_round().is_newer_than(self.announced) && !hint
            }
            Kind::Send | Kind::Query | Kind::Reply | Kind::Response | Kind::Control => false,
        }
    }
}
