//! A rendezvous as its task and a monitor see it.

use super::{Member, Rendezvous};
use crate::ids::{Round, TaskId};
use crate::observe::{MeetingState, MeetingView, MemberView, TaskState};
use crate::table::{Party, Port};
use crate::task::own::Own;
use crate::ticks::Instant;
use alloc::vec::Vec;

impl Rendezvous {
    /// The round that the task announced last. While the task waits, it waits in this round.
    pub fn announced(&self) -> Round {
        self.announced
    }

    /// Whether the task waits in this rendezvous.
    pub fn is_waiting(&self) -> bool {
        self.deadline.is_some()
    }

    /// Another member's arguments in the round that this task left last; `None` if that member had not arrived.
    pub fn told(&self, port: &Port, of: TaskId) -> Option<[u8; 8]> {
        self.members.get(port.party_index(of)?)?.told
    }

    /// The state of the task while it waits in this rendezvous.
    pub fn state(&self, now: Instant) -> TaskState {
        TaskState::Waiting { port: self.port, round: self.announced, remaining: self.left(now) }
    }

    /// This rendezvous as a monitor sees it.
    pub(super) fn view(&self, own: &Own, port: &Port) -> MeetingView {
        let waiting = self.deadline.is_some();
        let round = if waiting { self.announced } else { self.announced.next().fresher(self.fresh) };
        let member = |(member, party): (&Member, &Party)| {
            let is_own = party.task == own.task;
            let held = member.arrived.filter(|a| a.round == round && a.expires > own.now);
            let remaining = if is_own { self.deadline } else { held.map(|a| a.expires) };
            MemberView {
                task: party.task,
                arrived: if is_own { waiting } else { held.is_some() },
                confirmed: waiting && member.confirmed,
                remaining: remaining.map(|expires| expires - own.now),
            }
        };
        let members: Vec<_> = self.members.iter().zip(&port.parties).map(member).collect();
        let complete = members.iter().all(|m| m.arrived);
        let state = match (waiting, complete) {
            (false, _) => MeetingState::Away,
            (true, false) => MeetingState::Gathering,
            (true, true) => MeetingState::WithinMargin,
        };
        MeetingView {
            port: self.port,
            round,
            released: self.released.unwrap_or_default(),
            state,
            remaining: self.deadline.map(|deadline| deadline - own.now),
            members,
        }
    }
}
