//! Answers, refusals and restarts that end the task's outstanding requests.

use super::outstanding::{Answer, Outstanding, Phase, Recipient};
use super::{Client, Overdue};
use crate::ids::{MessageId, NodeId};
use crate::observe::{Event, Reason};
use crate::packet::{Control, Kind, Packet};
use crate::request::Outcome;
use crate::table::Ends;
use crate::task::fragments::Progress;
use crate::task::own::index;
use crate::task::step::{Outbox, Step};
use crate::task::wait::{Ended, Finished, Pending};

impl Client {
    /// Records the result for one recipient of a request. The last missing result ends the request.
    fn mark(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (at, recipient): (usize, usize),
        event: Event,
    ) -> Option<Ended> {
        let request = &mut self.requests[at];
        let (port, left) = (request.port, request.deadline - step.now());
        let recipient = &mut request.recipients[recipient];
        let contents = recipient.contents.get(0).copied().unwrap_or_default();
        let (answer, outcome) = match event {
            Event::Answered => (Answer::Answered, Outcome::Reply(contents)),
            Event::RefusedByPeer => (Answer::Refused, Outcome::Refused),
            _ => (Answer::Restarted, Outcome::PeerRestarted),
        };
        recipient.answer = answer;
        let (task, id) = (recipient.task, recipient.id);
        step.count(request.endpoint, |c| match answer {
            Answer::Answered => c.delivered += 1,
            Answer::Refused => c.refused += 1,
            Answer::Restarted | Answer::NotAsked | Answer::Open => {}
        });
        step.note(event, port, task, id, left);
        let waits = self.requests[at].open().next().is_some();
        (!waits).then(|| self.end(at, outcome))
    }

    pub(super) fn end(&mut self, at: usize, outcome: Outcome) -> Ended {
        let (request, at) = (&mut self.requests[at], index(at));
        let is_long = |recipient: &Recipient| recipient.contents.contents.len() > 1;
        let finished = if request.set {
            Finished::Answers(at)
        } else if matches!(outcome, Outcome::Reply(_)) && request.recipients.iter().any(is_long) {
            Finished::Long(at)
        } else {
            // Nothing else of the request needs to be kept.
            request.close();
            return Ended { wait: Some(Pending::Reply(at)), finished: Finished::Outcome(outcome) };
        };
        request.settle();
        request.phase = Phase::Ended;
        Ended { wait: Some(Pending::Reply(at)), finished }
    }

    /// Takes an answer to the task's own class-2 message.
    pub fn answer(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (ends, at): (Ends<'_>, u16),
        packet: &Packet,
    ) -> Option<Ended> {
        let at = usize::from(at);
        let request = &self.requests[at];
        let from = Some(usize::from(ends.peer.recipient))
            .filter(|&from| request.phase == Phase::Open && request.recipients[from].waits_for(packet.id));
        match from {
            Some(recipient) => self.answered(step, ends.own.place, (at, recipient), packet),
            None => self.late(step, ends.own.place, packet),
        }
    }

    /// Takes an answer from another task than the recipient of the request (D11).
    pub fn third_party(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        endpoint: u16,
        packet: &Packet,
    ) -> Option<Ended> {
        let found = self.requests.iter().enumerate().find_map(|(at, d)| Some((at, d.waits_for(packet.id)?)));
        match found {
            Some(place) => self.answered(step, endpoint, place, packet),
            None => self.late(step, endpoint, packet),
        }
    }

    /// Drops an answer that no request waits for. The rule variant with late replies accepts such an answer for the command that
    /// timed out last.
    fn late(&mut self, step: &mut Step<'_, impl Outbox>, endpoint: u16, packet: &Packet) -> Option<Ended> {
        let fits = |o: &Overdue| o.id == packet.id && o.port == packet.port && o.to == packet.source;
        let answers =
            matches!(packet.kind, Kind::Reply | Kind::Response) && self.overdue.is_some_and(|o| fits(&o));
        if answers && !step.table.rules().refuse_late_replies {
            self.overdue = None;
            let finished = Finished::Outcome(Outcome::Reply(packet.contents));
            return Some(Ended { wait: None, finished });
        }
        let stale = packet.id.incarnation.is_older_than(step.own.incarnation);
        step.drop_packet(endpoint, packet, if stale { Reason::StaleIncarnation } else { Reason::Unexpected });
        None
    }

    fn answered(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        endpoint: u16,
        (at, recipient): (usize, usize),
        packet: &Packet,
    ) -> Option<Ended> {
        let entry = &mut self.requests[at].recipients[recipient];
        let unsent = entry.packets_out == 0;
        let event = match (packet.kind, packet.control()) {
            (Kind::Reply | Kind::Response, _) => match entry.take(packet) {
                Ok(Progress::Whole(_)) => Event::Answered,
                Ok(Progress::Waits) => return None,
                Ok(Progress::Again) => {
                    step.duplicate(endpoint, packet);
                    return None;
                }
                Ok(Progress::Broken) => {
                    step.drop_packet(endpoint, packet, Reason::Incomplete);
                    return None;
                }
                Err(reason) => {
                    step.drop_packet(endpoint, packet, reason);
                    return None;
                }
            },
            (_, Some(Control::Refused)) => Event::RefusedByPeer,
            (_, Some(Control::RefusedOnTheWay)) if unsent => Event::RefusedByPeer,
            (_, Some(Control::Restarted)) => Event::PeerRestarted,
            // Another copy may have arrived, so that only the time_out ends the request.
            (_, Some(Control::RefusedOnTheWay)) => return None,
            (_, None) => {
                step.drop_packet(endpoint, packet, Reason::Unexpected);
                return None;
            }
        };
        self.mark(step, (at, recipient), event)
    }

    /// Notes that the transit buffer dropped a packet of one of the task's requests.
    pub fn unsent(&mut self, id: MessageId) {
        for request in &mut self.requests {
            if let Some(at) = request.waits_for(id) {
                request.recipients[at].packets_out = request.recipients[at].packets_out.saturating_sub(1);
            }
        }
    }

    /// Notes that a node has a new incarnation, whose tasks do not answer earlier requests. A call ends at most one wait:
    /// the caller repeats it until it returns `None`.
    pub fn restarted(&mut self, step: &mut Step<'_, impl Outbox>, node: NodeId) -> Option<Ended> {
        let table = step.table;
        let is_there = |recipient: &Recipient| {
            recipient.answer == Answer::Open && table.location(recipient.task) == Some(node)
        };
        let missing = |(at, request): (usize, &Outstanding)| {
            let recipient =
                request.recipients.iter().position(is_there).filter(|_| request.phase == Phase::Open);
            Some((at, recipient?))
        };
        while let Some(place) = self.requests.iter().enumerate().find_map(missing) {
            let ended = self.mark(step, place, Event::PeerRestarted);
            if ended.is_some() {
                return ended;
            }
        }
        None
    }
}
