//! Packets that a communication task will never notice, whatever happens later: a reduction for the model checker.

use super::{CommTask, Role};
use crate::ids::{Incarnation, PortId, Round, TaskId};
use crate::packet::{Kind, Packet};
use crate::table::NodeTable;

impl CommTask {
    /// Whether this task behaves the same with and without `packet`, whenever the packet arrives. Conservative: false if
    /// this is not certain. Counters and observations do not count. `source` is the present state of the packet's sender:
    /// in a world whose nodes never restart, an answer that the sender would ignore may be left out.
    #[must_use]
    pub fn ignores(&self, table: &NodeTable, packet: &Packet, source: &Self) -> bool {
        if let Some(meeting) = self.own.meeting(packet.port) {
            // A source that owes a CONFIRM would not ignore an ABORT as the answer: the ABORT would void an arrival that it
            // still needs.
            let round = packet.meeting().round;
            let over_there = source.is_over(packet.port, round) && source.owes(packet.port) != Some(round);
            return self.machines.meetings.at(meeting).ignores(table, packet, over_there);
        }
        // The packet answers a request that has ended, or no request at all.
        matches!(self.own.role(packet.port), Some(Role::Asks(_) | Role::Hears))
            && matches!(packet.kind, Kind::Reply | Kind::Response | Kind::Control)
            && table.rules().refuse_late_replies
            && !self.outstanding().any(|(_, _, id)| id == packet.id)
    }

    /// Whether this task never waits again in `round` of the rendezvous at a port, or takes no part in that
    /// rendezvous.
    #[must_use]
    pub fn is_over(&self, port: PortId, round: Round) -> bool {
        let meeting = self.own.meeting(port);
        meeting.is_none_or(|meeting| self.machines.meetings.at(meeting).never_again(round))
    }

    /// The round of the rendezvous at a port for which this task has yet to send CONFIRM, or to send it again.
    #[must_use]
    pub fn owes(&self, port: PortId) -> Option<Round> {
        self.machines.meetings.at(self.own.meeting(port)?).owes()
    }

    /// The incarnation of a member of a rendezvous from which this task last heard.
    #[must_use]
    pub fn heard_in(&self, table: &NodeTable, port: PortId, member: TaskId) -> Option<Incarnation> {
        self.machines.meetings.at(self.own.meeting(port)?).heard_in(table.port(port)?, member)
    }

    /// Drops the CONFIRM that this task has yet to send. A checker calls this if it knows that every receiver would ignore
    /// the CONFIRM.
    pub fn settle(&mut self, port: PortId) {
        self.due = None;
        if let Some(meeting) = self.own.meeting(port) {
            self.machines.meetings.settle(meeting);
        }
    }
}
