//! The user layer, downwards: it carries out the requests of the task (§5.2.1). `machines` takes the inputs from the node:
//! packets and the passing of time.

use super::client::Sent;
use super::machines::Machines;
use super::own::Role;
use super::server::send_answer;
use super::step::{Outbox, Step};
use super::wait::Pending;
use crate::ids::{PortId, TaskId};
use crate::mapping;
use crate::packet::Contents;
use crate::request::{Fault, ReplyTo, Request, Signal, Target};
use crate::ticks::{Instant, Ticks};

/// The signal that answers a request; `None` if the task has already got this signal, or gets it later.
type Answer = Result<Option<Signal>, Fault>;

const ACCEPTED: Option<Signal> = Some(Signal::Accepted(0));

impl Machines {
    /// Carries out a request of the task, which goes before everything else that the communication task does (§5.2.1).
    pub(super) fn request(&mut self, step: &mut Step<'_, impl Outbox>, request: &Request) {
        let done = match *request {
            Request::Cancel => Ok(Some(self.cancel(step))),
            Request::Abandon => Ok(Some(self.abandon(step))),
            Request::Reply { to, contents } => self.reply(step, to, contents),
            Request::Done => self.interrupts.done().map(|()| ACCEPTED),
            // The requests above this line are allowed while another request is outstanding; those below are not (R93).
            _ if !self.interrupts.waits_for_nothing() => Err(Fault::Busy),
            Request::Order(order) => {
                let old = core::mem::replace(&mut step.own.order, order);
                self.server.reorder(step.own, &old);
                Ok(ACCEPTED)
            }
            Request::Send { port, to, contents, time_out } => self.send(step, port, to, (contents, time_out)),
            Request::Part { port, index, contents } => step.own.stage(port, index, contents).map(Some),
            Request::Get { port, source, time_out } => self.get(step, (port, source), time_out),
            Request::Arrive { port, arguments, time_out } => self.arrive(step, port, arguments, time_out),
            Request::Handle { port, handled } => self.set_handled(step, port, handled),
            Request::Delay { id, length } => self.interrupts.delay(id, length, step.out).map(|()| None),
            Request::Start { id, length } => self.interrupts.start(id, length, step.out).map(|()| ACCEPTED),
            Request::Stop { id } => {
                self.interrupts.stop(id, step.out);
                Ok(ACCEPTED)
            }
            Request::Boundary => {
                self.boundary(step);
                Ok(None)
            }
            Request::Work => {
                self.interrupts.wait(Pending::Work);
                Ok(None)
            }
            Request::Return => self.resume(step).map(|()| None),
            Request::Atomic(atomic) => {
                self.interrupts.set_atomic(atomic);
                Ok(ACCEPTED)
            }
            Request::Lease => self.await_lease(),
            Request::Publish(contents) => {
                let lease = self.lease.as_mut().ok_or(Fault::WrongUsage);
                lease.and_then(|lease| lease.publish(contents)).map(|()| ACCEPTED)
            }
            Request::End => {
                if let Some(lease) = &mut self.lease {
                    lease.retire();
                }
                Ok(ACCEPTED)
            }
        };
        match done {
            Ok(Some(signal)) => step.out.signal(signal),
            Ok(None) => {}
            Err(fault) => {
                // If a message is not sent, the fragments that the task has handed over for it must not end up in the
                // next message.
                if let Request::Send { port, .. } | Request::Reply { to: ReplyTo { port, .. }, .. } = *request
                {
                    step.own.unstage(port);
                }
                step.out.signal(Signal::Fault(fault));
            }
        }
    }

    fn send(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        id: PortId,
        to: Target,
        (contents, time_out): (Contents, Option<Ticks>),
    ) -> Answer {
        let (port, party) = mapping::own_end(step.table, id, step.own.task)?;
        let ttl = party.time_out_of(time_out);
        let contents = match port.decl.guard {
            None => contents,
            Some(couple) => self.lease.as_ref().ok_or(Fault::Fenced)?.with_epoch(couple, contents)?,
        };
        match self.client.send(step, (party, to), (port, ttl, contents))? {
            Sent::Copies(copies) => Ok(Some(Signal::Accepted(copies))),
            Sent::Request(request) => {
                self.interrupts.wait(Pending::Reply(request));
                Ok(None)
            }
        }
    }

    /// Takes the most urgent of the first messages of the ports, or waits for a message (procedure `get`, §5.2.1).
    #[inline]
    pub(super) fn get(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (port, source): (Option<PortId>, Option<TaskId>),
        time_out: Option<Ticks>,
    ) -> Answer {
        let inbox = port.map(|port| step.own.receiving(port)).transpose()?;
        if !self.server.has_nothing(inbox) && self.serve(step, inbox, source) {
            return Ok(None);
        }
        if time_out == Some(Ticks::ZERO) {
            return Ok(Some(Signal::Nothing));
        }
        let deadline = time_out.map_or(Instant::NEVER, |t| step.now() + t);
        self.interrupts.wait(Pending::Get { port, source, deadline });
        Ok(None)
    }

    fn reply(&mut self, step: &mut Step<'_, impl Outbox>, to: ReplyTo, contents: Contents) -> Answer {
        let (port, party) = mapping::own_end(step.table, to.port, step.own.task)?;
        let place = usize::from(party.place);
        let left = match step.own.endpoints[place].role {
            Role::Replies => {
                party.peer(to.source).ok_or(Fault::NotAPeer)?;
                step.own.staged(place)?;
                step.own.endpoints[place].counters.sent += 1;
                party.time_out
            }
            Role::Receives(inbox) => {
                let source = party.peer(to.source).ok_or(Fault::NothingToAnswer)?.slot;
                self.server.reply(step, (inbox.into(), source.into()), to, contents)?
            }
            Role::Sends | Role::Asks(_) | Role::Meets(_) | Role::Hears | Role::Heartbeats => {
                return Err(Fault::NothingToAnswer);
            }
        };
        send_answer(step, (port, place), to, left, contents);
        Ok(Some(Signal::Accepted(1)))
    }

    fn arrive(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        id: PortId,
        arguments: [u8; 8],
        time_out: Option<Ticks>,
    ) -> Answer {
        let (_, party) = mapping::own_end(step.table, id, step.own.task)?;
        let meeting = step.own.meeting(id).ok_or(Fault::WrongUsage)?;
        if self.meetings.at(meeting).is_waiting() {
            return Err(Fault::Busy);
        }
        let patience = party.time_out_of(time_out);
        self.interrupts.wait(Pending::Meeting(meeting));
        let ended = self.meetings.reach(step, meeting, (arguments, patience));
        self.end(step, ended);
        Ok(None)
    }

    fn set_handled(&mut self, step: &Step<'_, impl Outbox>, port: PortId, handled: bool) -> Answer {
        let inbox = step.own.receiving(port)?;
        self.server.set_handled(step.own, inbox, handled);
        Ok(ACCEPTED)
    }

    fn await_lease(&mut self) -> Answer {
        let Some(lease) = &mut self.lease else { return Err(Fault::WrongUsage) };
        if self.interrupts.waits(Pending::Lease) {
            return Err(Fault::Busy);
        }
        let epoch = lease.await_it()?;
        if epoch.is_none() {
            self.interrupts.wait(Pending::Lease);
        }
        Ok(epoch.map(Signal::Granted))
    }

    fn cancel(&mut self, step: &mut Step<'_, impl Outbox>) -> Signal {
        match self.interrupts.end_wait() {
            Pending::Meeting(meeting) => self.meetings.leave(step, meeting),
            Pending::Delay(id, _) => step.out.disarm(id),
            Pending::Reply(request) => self.client.close(request),
            Pending::Nothing | Pending::Get { .. } | Pending::Work | Pending::Lease | Pending::Boundary => {}
        }
        Signal::Cancelled
    }

    /// Ends every wait and every handler, because the task starts again from its beginning. Waiting messages stay.
    fn abandon(&mut self, step: &mut Step<'_, impl Outbox>) -> Signal {
        loop {
            self.cancel(step);
            if !self.interrupts.drop_running() {
                break;
            }
        }
        self.client.close_all();
        for endpoint in &mut step.own.endpoints {
            endpoint.staged.clear();
        }
        self.interrupts.stop_all(step.out);
        Signal::Cancelled
    }
}
