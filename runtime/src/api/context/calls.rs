//! The calls of a program. Each call is written once, for threads and futures: a thread blocks in [`Calls::ask`], and a
//! future awaits it.

use super::answers::{encoded, wrong_usage};
use super::caller::Caller;
use super::outcome::{Asked, Received, Rendezvous, Sent, TaskError};
use crate::api::message::{LONGEST, Message};
use crate::clock;
use imrs_protocol::{
    CONTENTS_BYTES, Class, Contents, Delivery, PUBLISHED_BYTES, PortDecl, PortId, Ranked, ReplyTo, Request,
    ServiceOrder, Signal, Target, TaskId, Ticks, TimeId,
};
use std::future::Future;
use std::pin::pin;
use std::task::{Context as Poller, Poll, Waker};
use std::time::Duration;

/// How many bytes one packet carries.
const PACKET: usize = CONTENTS_BYTES;

/// The result of a call that does not wait, or that blocks the calling thread instead of awaiting.
pub(super) fn at_once<T>(call: impl Future<Output = Result<T, TaskError>>) -> Result<T, TaskError> {
    match pin!(call).poll(&mut Poller::from_waker(Waker::noop())) {
        Poll::Ready(result) => result,
        // This happens only by a fault in this library: a call that must not wait made a request that was not
        // answered at once.
        Poll::Pending => Err(wrong_usage()),
    }
}

/// The requests of a program to its communication task. A [`Context`](super::Context) and an
/// [`AsyncContext`](super::AsyncContext) differ in [`ask`](Self::ask) alone.
pub(super) trait Calls {
    fn caller(&mut self) -> &mut Caller;

    /// Makes a request and waits for its answer. Handlers run during the wait. Returns the answer and its age. A
    /// `reply` is sent first, and the request is made only if the communication task accepts the reply.
    fn ask_after(
        &mut self,
        reply: Option<Request>,
        request: Request,
    ) -> impl Future<Output = Result<(Signal, Ticks), TaskError>>;

    /// As [`ask_after`](Self::ask_after), without a reply.
    fn ask(&mut self, request: Request) -> impl Future<Output = Result<(Signal, Ticks), TaskError>> {
        self.ask_after(None, request)
    }

    /// Whether a received message may be kept for a later call, if its own call's future was dropped.
    fn keeps(&self) -> bool {
        false
    }

    /// A kept message: the task received it for an earlier call, whose future was then dropped.
    fn kept(&mut self, port: Option<PortId>, source: Option<TaskId>) -> Option<Delivery> {
        let _ = (port, source);
        None
    }

    /// Makes a request that the communication task answers at once. Returns how many copies were sent, if the request
    /// sends any.
    async fn accepted(&mut self, request: Request) -> Result<u16, TaskError> {
        match self.ask(request).await?.0 {
            Signal::Accepted(copies) => Ok(copies),
            other => mismatch(&request, &other),
        }
    }

    /// Hands the fragments of a long message, except the first, to the communication task. Returns the first fragment (D28).
    async fn staged(
        &mut self,
        port: PortId,
        bytes: &[u8],
        packets: impl FnOnce(&PortDecl) -> u8,
    ) -> Result<Contents, TaskError> {
        let packets = self.caller().node.table.port(port).map_or(1, |port| packets(&port.decl));
        let too_long = || TaskError::TooLong(bytes.len());
        if bytes.len() > PACKET * usize::from(packets.max(1)) {
            return Err(too_long());
        }
        let (first, rest) = bytes.split_at(bytes.len().min(PACKET));
        for (index, part) in (1..).zip(rest.chunks(PACKET)) {
            let contents = Contents::new(part).ok_or_else(too_long)?;
            self.accepted(Request::Part { port, index, contents }).await?;
        }
        Contents::new(first).ok_or_else(too_long)
    }

    async fn sent(
        &mut self,
        port: PortId,
        to: Target,
        contents: &[u8],
        time_out: Option<Duration>,
    ) -> Result<Sent, TaskError> {
        let contents = match Contents::new(contents) {
            Some(short) => short,
            None => self.staged(port, contents, |decl| decl.fragments).await?,
        };
        let time_out = time_out.map(ticks);
        let request = Request::Send { port, to, contents, time_out };
        match self.ask(request).await?.0 {
            Signal::Accepted(copies) => Ok(Sent::Copies(copies)),
            Signal::Outcome(outcome) => Ok(Sent::Outcome(outcome)),
            Signal::Answers { answers, .. } => Ok(Sent::Several(answers)),
            other => mismatch(&request, &other),
        }
    }

    async fn reply_of(&mut self, to: &ReplyTo, contents: &[u8]) -> Result<Request, TaskError> {
        let contents = match Contents::new(contents) {
            Some(short) => short,
            None => self.staged(to.port, contents, |decl| decl.answer_fragments).await?,
        };
        Ok(Request::Reply { to: *to, contents })
    }

    async fn replied(&mut self, to: &ReplyTo, contents: &[u8]) -> Result<(), TaskError> {
        let reply = self.reply_of(to, contents).await?;
        self.accepted(reply).await.map(|_| ())
    }

    async fn received(
        &mut self,
        port: Option<PortId>,
        source: Option<TaskId>,
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        self.received_after(None, (port, source), time_out).await
    }

    async fn replied_and_received(
        &mut self,
        to: &ReplyTo,
        contents: &[u8],
        port: Option<PortId>,
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        let mut reply = Some(self.reply_of(to, contents).await?);
        if self.keeps()
            && let Some(reply) = reply.take()
        {
            // A kept message may already be the next one, so the reply must not wait for another message.
            self.accepted(reply).await?;
        }
        self.received_after(reply, (port, None), time_out).await
    }

    /// Waits for a message. Before that it sends `reply`, if there is one.
    async fn received_after(
        &mut self,
        mut reply: Option<Request>,
        (port, source): (Option<PortId>, Option<TaskId>),
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        if let Some(kept) = self.kept(port, source) {
            return Ok(Some(kept));
        }
        let until = time_out.map(|time_out| clock::now().saturating_add(clock::micros(time_out)));
        let mut left = time_out.map(ticks);
        loop {
            let request = Request::Get { port, source, time_out: left };
            match self.ask_after(reply.take(), request).await? {
                (Signal::Message(message), age) => {
                    if let Some(message) = self.caller().in_hand(&message, age) {
                        return Ok(Some(message));
                    }
                }
                (Signal::Nothing, _) => return Ok(None),
                (other, _) => mismatch(&request, &other),
            }
            left = until.map(|until| Ticks(until.saturating_sub(clock::now())));
        }
    }

    async fn met(
        &mut self,
        port: PortId,
        arguments: [u8; 8],
        time_out: Option<Duration>,
    ) -> Result<Rendezvous, TaskError> {
        let request = Request::Arrive { port, arguments, time_out: time_out.map(ticks) };
        match self.ask(request).await?.0 {
            Signal::Released { round, by, .. } => Ok(Rendezvous::Released { round, by }),
            Signal::GaveUp { round, missing, .. } => Ok(Rendezvous::GaveUp { round, missing }),
            other => mismatch(&request, &other),
        }
    }

    async fn ordered(&mut self, named: &[Ranked]) -> Result<(), TaskError> {
        let order = ServiceOrder::new(named).ok_or(TaskError::TooManyLevels(named.len()))?;
        self.accepted(Request::Order(order)).await.map(|_| ())
    }

    async fn delayed(&mut self, length: Duration) -> Result<(), TaskError> {
        // A handler may delay while the thread that it interrupted delays, too. So each depth of nesting has an id of
        // its own for its delay, above the ids of timers.
        let request = Request::Delay { id: TimeId(u8::MAX - self.caller().depth), length: ticks(length) };
        match self.ask(request).await?.0 {
            Signal::TimeOut(_) => Ok(()),
            other => mismatch(&request, &other),
        }
    }

    async fn leased(&mut self) -> Result<u8, TaskError> {
        match self.ask(Request::Lease).await?.0 {
            Signal::Granted(epoch) => Ok(epoch),
            other => mismatch(&Request::Lease, &other),
        }
    }

    async fn publishes(&mut self, bytes: &[u8]) -> Result<(), TaskError> {
        let few = Some(bytes).filter(|bytes| bytes.len() <= PUBLISHED_BYTES);
        let contents = few.and_then(Contents::new).ok_or(TaskError::TooLong(bytes.len()))?;
        self.accepted(Request::Publish(contents)).await.map(|_| ())
    }

    async fn told<M: Message>(&mut self, port: PortId, message: &M) -> Result<u16, TaskError> {
        self.caller().expect_class(port, Class::Status)?;
        let mut room = [0; LONGEST];
        match self.sent(port, Target::All, encoded(message, &mut room)?, None).await? {
            Sent::Copies(copies) => Ok(copies),
            Sent::Outcome(_) | Sent::Several(_) => Err(wrong_usage()),
        }
    }

    async fn asked<M: Message, R: Message>(
        &mut self,
        port: PortId,
        to: Target,
        question: &M,
        time_out: Option<Duration>,
    ) -> Result<Asked<R>, TaskError> {
        self.caller().expect_class(port, Class::Command)?;
        let peer = self.caller().peer(port, to)?;
        let mut room = [0; LONGEST];
        let bytes = encoded(question, &mut room)?;
        match self.sent(port, Target::One(peer), bytes, time_out).await? {
            Sent::Outcome(outcome) => self.caller().asked(port, peer, outcome),
            Sent::Copies(_) | Sent::Several(_) => Err(wrong_usage()),
        }
    }

    async fn asked_all<M: Message, R: Message>(
        &mut self,
        port: PortId,
        to: Target,
        question: &M,
        mut each: impl FnMut(TaskId, Asked<R>),
    ) -> Result<(), TaskError> {
        self.caller().expect_class(port, Class::Command)?;
        let mut room = [0; LONGEST];
        let bytes = encoded(question, &mut room)?;
        match self.sent(port, to, bytes, None).await? {
            Sent::Copies(_) => Err(wrong_usage()),
            Sent::Outcome(outcome) => {
                let peer = self.caller().peer(port, to)?;
                each(peer, self.caller().asked(port, peer, outcome)?);
                Ok(())
            }
            Sent::Several(answers) => self.caller().each_answer(port, &answers, each),
        }
    }

    async fn taken<M: Message>(
        &mut self,
        port: PortId,
        time_out: Option<Duration>,
    ) -> Result<Option<Received<M>>, TaskError> {
        let next = self.received(Some(port), None, time_out).await?;
        next.map(|delivery| self.caller().decoded(&delivery)).transpose()
    }

    async fn answered_and_taken<R: Message, M: Message>(
        &mut self,
        (to, answer): (&ReplyTo, &R),
        port: PortId,
        time_out: Option<Duration>,
    ) -> Result<Option<Received<M>>, TaskError> {
        let mut room = [0; LONGEST];
        let answer = encoded(answer, &mut room)?;
        let next = self.replied_and_received(to, answer, Some(port), time_out).await?;
        next.map(|delivery| self.caller().decoded(&delivery)).transpose()
    }

    async fn answered<R: Message>(&mut self, to: &ReplyTo, answer: &R) -> Result<(), TaskError> {
        let mut room = [0; LONGEST];
        self.replied(to, encoded(answer, &mut room)?).await
    }
}

pub(super) fn ticks(length: Duration) -> Ticks {
    Ticks(clock::micros(length))
}

/// Ends the program. This happens only by a fault in the state machine.
#[cold]
pub(super) fn mismatch(request: &Request, signal: &Signal) -> ! {
    panic!("the communication task answered {request:?} with {signal:?}")
}
