//! One monitor of a node.

use super::MAX_MONITORS;
use super::stream::Stream;
use crate::clock;
use crate::node::Node;
use crate::snapshot::Observations;
use imrs_wire::obs::{
    Bye, ClientFrame, DecodeError, Events, FrameError, FrameReader, FrameWriter, Goodbye, Handshake, Hello,
    MAX_REQUEST, Refusal, Role, SCHEMA, ServerFrame, Subscribe, Table, VERSION, Version, agree,
};
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How long a new connection may say nothing.
const GREETING: Duration = Duration::from_secs(5);
/// The shortest time between snapshots.
const LEAST_PERIOD: Duration = Duration::from_millis(10);
/// The time between frames of events.
const EVENT_PERIOD: Duration = Duration::from_millis(20);
/// How many events of one machine go into one frame.
const EVENT_ROOM: usize = 512;
/// How many events go into one frame.
const MAX_EVENTS: usize = 16_384;
/// The most waiting messages of a port in a snapshot.
const QUEUE_LIMIT: u8 = 64;
/// How many requests are read before others get their turn.
const REQUESTS: usize = 16;

pub(super) struct Client {
    node: Arc<Node>,
    reader: FrameReader<Stream>,
    writer: FrameWriter<Stream>,
    state: State,
    /// Whether there is room for it. If not it hears so and goes.
    welcome: bool,
}

enum State {
    /// Its hello has not come.
    Greeting {
        until: Instant,
    },
    /// It may subscribe.
    Idle,
    Subscribed(Subscription),
    /// What is pending is the last.
    Leaving,
}

struct Subscription {
    period: Duration,
    queue_limit: u8,
    credit: u16,
    next_snapshot: Instant,
    next_events: Instant,
    events: Option<Observations>,
}

/// The connection is over.
struct Gone;

impl From<FrameError> for Gone {
    fn from(_: FrameError) -> Self {
        Self
    }
}

impl Client {
    /// A new connection, or `None` where the system has no resources for it.
    pub fn new(stream: Stream, node: Arc<Node>, welcome: bool, now: Instant) -> Option<Self> {
        stream.set_nonblocking().ok()?;
        let reader = FrameReader::new(stream.try_clone().ok()?, MAX_REQUEST);
        let writer = FrameWriter::new(stream);
        Some(Self { node, reader, writer, state: State::Greeting { until: now + GREETING }, welcome })
    }

    pub fn as_fd(&self) -> BorrowedFd<'_> {
        self.writer.get_ref().as_fd()
    }

    pub fn has_pending(&self) -> bool {
        !self.writer.is_drained()
    }

    /// When something is to do for it though nothing comes from it.
    pub fn due(&self) -> Option<Instant> {
        match &self.state {
            State::Greeting { until } => Some(*until),
            State::Subscribed(s) if s.credit > 0 && self.writer.is_drained() => {
                let events = s.events.as_ref().map(|_| s.next_events);
                Some(events.map_or(s.next_snapshot, |at| at.min(s.next_snapshot)))
            }
            State::Subscribed(_) | State::Idle | State::Leaving => None,
        }
    }

    /// Reads and writes what can be. False: the connection is over.
    pub fn serve(&mut self, ready: bool, now: Instant) -> bool {
        self.try_serve(ready, now).is_ok()
    }

    pub fn say_goodbye(&mut self) {
        if matches!(self.state, State::Idle | State::Subscribed(_)) && self.writer.is_drained() {
            let bye = ServerFrame::Bye(Bye { reason: Goodbye::Stopping });
            // Whoever does not take it now sees the connection end.
            let _ = self.writer.push(&bye).and_then(|()| self.writer.flush());
        }
    }

    fn try_serve(&mut self, ready: bool, now: Instant) -> Result<(), Gone> {
        if let State::Greeting { until } = self.state
            && until <= now
        {
            return Err(Gone);
        }
        if ready {
            self.flush()?;
            self.read(now)?;
        }
        if self.writer.is_drained() {
            if matches!(self.state, State::Leaving) {
                return Err(Gone);
            }
            self.push_what_is_due(now)?;
        }
        self.flush()?;
        if matches!(self.state, State::Leaving) && self.writer.is_drained() { Err(Gone) } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<(), Gone> {
        match self.writer.flush() {
            Ok(()) | Err(FrameError::NotReady) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    fn read(&mut self, now: Instant) -> Result<(), Gone> {
        for _ in 0..REQUESTS {
            let frame = match self.reader.read_frame() {
                Ok(frame) => frame,
                Err(FrameError::NotReady) => return Ok(()),
                Err(error) => return Err(error.into()),
            };
            match &mut self.state {
                State::Greeting { .. } => {
                    let hello = Handshake::decode(frame);
                    self.greet(&hello)?;
                }
                State::Idle => match ClientFrame::decode(frame) {
                    Ok(ClientFrame::Subscribe(wanted)) => self.subscribe(&wanted, now),
                    Ok(ClientFrame::Credit(_)) => {}
                    Err(_) => self.misunderstood()?,
                },
                State::Subscribed(subscription) => match ClientFrame::decode(frame) {
                    Ok(ClientFrame::Subscribe(wanted)) => self.subscribe(&wanted, now),
                    Ok(ClientFrame::Credit(more)) => {
                        subscription.credit = subscription.credit.saturating_add(more);
                    }
                    Err(_) => self.misunderstood()?,
                },
                State::Leaving => return Ok(()),
            }
        }
        Ok(())
    }

    fn greet(&mut self, hello: &Result<(Version, Handshake), DecodeError>) -> Result<(), Gone> {
        let refusal = match hello {
            Err(DecodeError::OtherMajor { theirs, .. }) => {
                Some(Refusal::OtherMajor { node: VERSION, monitor: *theirs })
            }
            Err(_) => return Err(Gone),
            Ok((theirs, Handshake::Hello(Hello { role: Role::Monitor, schema, .. }))) => {
                agree((VERSION, SCHEMA), (*theirs, *schema)).err()
            }
            Ok((_, Handshake::Hello(_) | Handshake::Refused(_))) => Some(Refusal::NotAMonitor),
        };
        let limit = u16::try_from(MAX_MONITORS).unwrap_or(u16::MAX);
        let refusal = refusal.or((!self.welcome).then_some(Refusal::TooMany { limit }));
        if let Some(refusal) = refusal {
            self.writer.push_bytes(&Handshake::Refused(refusal).encode(VERSION))?;
            self.state = State::Leaving;
            return Ok(());
        }
        let ours = Hello {
            schema: SCHEMA,
            pid: std::process::id(),
            build: concat!("imrs-runtime ", env!("CARGO_PKG_VERSION")).into(),
            mono_us: clock::now(),
            role: Role::Node(self.node.identity()),
        };
        self.writer.push_bytes(&Handshake::Hello(ours).encode(VERSION))?;
        self.writer.push(&ServerFrame::Table(Table::of(self.node.table())))?;
        self.state = State::Idle;
        Ok(())
    }

    fn subscribe(&mut self, wanted: &Subscribe, now: Instant) {
        let events = match &mut self.state {
            State::Subscribed(before) => before.events.take(),
            State::Greeting { .. } | State::Idle | State::Leaving => None,
        };
        let events = wanted.events.then(|| events.unwrap_or_else(|| self.node.observe()));
        self.state = State::Subscribed(Subscription {
            period: Duration::from_micros(wanted.period_us.into()).max(LEAST_PERIOD),
            queue_limit: wanted.queue_limit.min(QUEUE_LIMIT),
            credit: wanted.credit,
            next_snapshot: now,
            next_events: now,
            events,
        });
    }

    fn misunderstood(&mut self) -> Result<(), Gone> {
        self.writer.push(&ServerFrame::Bye(Bye { reason: Goodbye::Misunderstood }))?;
        self.state = State::Leaving;
        Ok(())
    }

    /// At most one frame: while it is on its way, nothing else is made.
    fn push_what_is_due(&mut self, now: Instant) -> Result<(), Gone> {
        let State::Subscribed(subscription) = &mut self.state else { return Ok(()) };
        if subscription.credit == 0 {
            return Ok(());
        }
        if subscription.next_snapshot <= now {
            subscription.next_snapshot = now + subscription.period;
            push_snapshot(&self.node, subscription.queue_limit, &mut self.writer)?;
            subscription.credit -= 1;
        } else if let Some(observations) = &mut subscription.events
            && subscription.next_events <= now
        {
            subscription.next_events = now + EVENT_PERIOD;
            let mut frame = Events::default();
            frame.lost = observations.drain(EVENT_ROOM, &mut frame.events);
            if !frame.events.is_empty() || frame.lost > 0 {
                frame.lost += frame.events.len().saturating_sub(MAX_EVENTS) as u64;
                frame.events.truncate(MAX_EVENTS);
                self.writer.push(&ServerFrame::Events(frame))?;
                subscription.credit -= 1;
            }
        }
        Ok(())
    }
}

/// The snapshot, with fewer and fewer waiting messages until it fits a frame.
fn push_snapshot(
    node: &Node,
    mut queue_limit: u8,
    writer: &mut FrameWriter<Stream>,
) -> Result<(), FrameError> {
    loop {
        let snapshot = ServerFrame::Snapshot(node.snapshot(queue_limit.into()));
        match writer.push(&snapshot) {
            Err(FrameError::TooLong { .. }) if queue_limit > 0 => queue_limit /= 2,
            other => return other,
        }
    }
}
