//! The connection of one monitor to a node.

use super::due::{Subscription, mono_us};
use super::pass::Pass;
use super::stream::Stream;
use super::{MAX_MONITORS, Showing};
use imrs_wire::obs::{
    Bye, Challenge, ClientFrame, DecodeError, Denied, FrameError, FrameReader, FrameWriter, Goodbye,
    Handshake, Hello, MAX_REQUEST, Pong, Refusal, Role, SCHEMA, ServerFrame, Table, VERSION, Version, agree,
};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::{Duration, Instant};

/// How long a new connection has to say hello and to show its token.
const GREETING: Duration = Duration::from_secs(5);
/// A monitor that reads nothing, or wants nothing, for this long makes room for another monitor.
const IDLE: Duration = Duration::from_secs(5);
/// How many requests of one monitor are read before the observer serves the other monitors.
const REQUESTS: usize = 16;
/// The first version in which a monitor proves that it has the token, instead of sending the token.
const PROOFS: Version = Version { major: 1, minor: 3 };

pub(super) struct Client {
    showing: Showing,
    reader: FrameReader<Stream>,
    writer: FrameWriter<Stream>,
    state: State,
    /// The protocol version in use, once the monitor has said hello.
    version: Version,
    /// When the monitor last asked for anything. A monitor that has read everything and wants more counts as active.
    active: Instant,
    /// The answer to the monitor's last ping, until it is sent.
    pong: Option<Pong>,
}

enum State {
    /// The monitor has not said hello yet.
    Greeting {
        until: Instant,
    },
    /// The monitor has not shown yet that it is allowed to look.
    Unproven {
        until: Instant,
        challenge: Challenge,
    },
    /// The monitor may subscribe, and has not done so yet.
    Idle,
    Subscribed(Box<Subscription>),
    /// The pending frame is the last one before the connection ends.
    Leaving,
}

/// The connection to the monitor is over.
struct Gone;

impl From<FrameError> for Gone {
    fn from(_: FrameError) -> Self {
        Self
    }
}

impl Client {
    /// The state for a new connection, or `None` if the system has no resources for it.
    pub fn new(stream: Stream, showing: Showing, now: Instant) -> Option<Self> {
        stream.set_nonblocking().ok()?;
        let reader = FrameReader::new(stream.try_clone().ok()?, MAX_REQUEST);
        let writer = FrameWriter::new(stream);
        let state = State::Greeting { until: now + GREETING };
        Some(Self { showing, reader, writer, state, version: VERSION, active: now, pong: None })
    }

    pub fn as_fd(&self) -> BorrowedFd<'_> {
        self.writer.get_ref().as_fd()
    }

    pub fn has_pending(&self) -> bool {
        !self.writer.is_drained()
    }

    /// When the connection needs service next, even if the monitor sends nothing.
    pub fn due(&self) -> Option<Instant> {
        match &self.state {
            State::Greeting { until } | State::Unproven { until, .. } => Some(*until),
            State::Subscribed(subscription) if self.writer.is_drained() => subscription.due(),
            State::Subscribed(_) | State::Idle | State::Leaving => None,
        }
    }

    /// Reads and writes as much as possible. `room` says whether one more monitor can be served. Returns false if the
    /// connection is over.
    pub fn serve(&mut self, ready: bool, room: bool, pass: &mut Pass) -> bool {
        self.try_serve(ready, room, pass).is_ok()
    }

    /// Whether the monitor has shown that it is allowed to look, and so takes one of the places.
    pub const fn is_served(&self) -> bool {
        matches!(self.state, State::Idle | State::Subscribed(_))
    }

    /// The instant since which the monitor has been idle, if that is at least `IDLE` ago. An idle monitor reads no
    /// frames or wants none, and must make room for another monitor.
    pub fn idle_since(&self, now: Instant) -> Option<Instant> {
        let is_idle = self.is_served() && !self.is_active();
        (is_idle && now.saturating_duration_since(self.active) >= IDLE).then_some(self.active)
    }

    /// Whether the monitor reads the frames that are made for it, and wants more.
    fn is_active(&self) -> bool {
        matches!(&self.state, State::Subscribed(wanted) if wanted.credit > 0) && self.writer.is_drained()
    }

    pub fn say_goodbye(&mut self) {
        if matches!(self.state, State::Idle | State::Subscribed(_)) && self.writer.is_drained() {
            let bye = ServerFrame::Bye(Bye { reason: Goodbye::Stopping });
            // If the monitor does not read this frame now, it only sees the connection end.
            let _ = self.writer.push(&bye).and_then(|()| self.writer.flush());
        }
    }

    fn try_serve(&mut self, ready: bool, room: bool, pass: &mut Pass) -> Result<(), Gone> {
        let now = pass.now;
        if ready {
            self.flush()?;
            self.read(room, now)?;
        }
        // The time limit is checked only after the socket has been read empty: on a busy machine the observer may be
        // late, not the monitor.
        if let State::Greeting { until } | State::Unproven { until, .. } = self.state
            && until <= now
        {
            return Err(Gone);
        }
        if self.is_active() {
            self.active = now;
        }
        if self.writer.is_drained() {
            if matches!(self.state, State::Leaving) {
                return Err(Gone);
            }
            self.push_what_is_due(pass)?;
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

    fn read(&mut self, room: bool, now: Instant) -> Result<(), Gone> {
        for _ in 0..REQUESTS {
            let frame = match self.reader.read_frame() {
                Ok(frame) => frame,
                Err(FrameError::NotReady) => return Ok(()),
                Err(error) => return Err(error.into()),
            };
            self.active = now;
            match self.state {
                State::Greeting { until } => {
                    let hello = Handshake::decode(frame);
                    self.greet(&hello, room, until)?;
                }
                State::Unproven { challenge, .. } => {
                    let frame = ClientFrame::decode(frame);
                    self.prove(&challenge, &frame, room)?;
                }
                State::Idle | State::Subscribed(_) => match ClientFrame::decode(frame) {
                    Ok(frame) => self.take(frame, now),
                    Err(_) => self.misunderstood()?,
                },
                State::Leaving => return Ok(()),
            }
        }
        Ok(())
    }

    fn take(&mut self, frame: ClientFrame, now: Instant) {
        match frame {
            ClientFrame::Subscribe(wanted) => {
                let before = self.subscription();
                self.subscribed(Subscription::old(&wanted, before, &self.showing, now));
            }
            ClientFrame::Want(wanted) => {
                let before = self.subscription();
                self.subscribed(Subscription::new(wanted, before, &self.showing, now, self.version));
            }
            ClientFrame::Credit(more) => {
                if let State::Subscribed(subscription) = &mut self.state {
                    subscription.credit = subscription.credit.saturating_add(more);
                }
            }
            ClientFrame::Whole => {
                if let State::Subscribed(subscription) = &mut self.state {
                    subscription.whole(now);
                }
            }
            ClientFrame::Ping(ping) => self.pong = Some(Pong { echo_us: ping.mono_us, mono_us: mono_us() }),
            // The monitor is allowed to look already, so a token or a proof changes nothing.
            ClientFrame::Token(_) | ClientFrame::Proof(_) => {}
        }
    }

    fn subscription(&mut self) -> Option<Subscription> {
        match std::mem::replace(&mut self.state, State::Idle) {
            State::Subscribed(subscription) => Some(*subscription),
            State::Greeting { .. } | State::Unproven { .. } | State::Idle | State::Leaving => None,
        }
    }

    fn subscribed(&mut self, subscription: Subscription) {
        self.state = State::Subscribed(Box::new(subscription));
    }

    fn greet(
        &mut self,
        hello: &Result<(Version, Handshake), DecodeError>,
        room: bool,
        until: Instant,
    ) -> Result<(), Gone> {
        let refusal = match hello {
            Err(DecodeError::OtherMajor { theirs, .. }) => {
                Some(Refusal::OtherMajor { node: VERSION, monitor: *theirs })
            }
            Err(_) => return Err(Gone),
            Ok((theirs, Handshake::Hello(Hello { role: Role::Monitor, schema, .. }))) => {
                match agree((VERSION, SCHEMA), (*theirs, *schema)) {
                    // A monitor of so old a version can only send the token, and cannot prove that it has it.
                    Ok(version) if self.showing.token.is_some() && version.minor < PROOFS.minor => {
                        Some(Refusal::OtherMajor { node: VERSION, monitor: *theirs })
                    }
                    Ok(version) => {
                        self.version = version;
                        None
                    }
                    Err(refusal) => Some(refusal),
                }
            }
            Ok((_, Handshake::Hello(_) | Handshake::Refused(_))) => Some(Refusal::NotAMonitor),
        };
        let limit = u16::try_from(MAX_MONITORS).unwrap_or(u16::MAX);
        let refusal = refusal.or((!room).then_some(Refusal::TooMany { limit }));
        if let Some(refusal) = refusal {
            self.writer.push_bytes(&Handshake::Refused(refusal).encode(VERSION))?;
            self.state = State::Leaving;
            return Ok(());
        }
        let ours = Hello {
            schema: SCHEMA,
            pid: std::process::id(),
            build: concat!("imrs-runtime ", env!("CARGO_PKG_VERSION")).into(),
            mono_us: mono_us(),
            role: Role::Node(self.showing.node.identity()),
        };
        self.writer.push_bytes(&Handshake::Hello(ours).encode(VERSION))?;
        if self.showing.token.is_some() {
            let mut challenge = Challenge([0; 32]);
            getrandom::fill(&mut challenge.0).map_err(|_| Gone)?;
            self.writer.push(&ServerFrame::Challenge(challenge))?;
            self.state = State::Unproven { until, challenge };
            return Ok(());
        }
        self.admit()
    }

    /// Allows the monitor to look.
    fn admit(&mut self) -> Result<(), Gone> {
        self.writer.push(&ServerFrame::Table(Table::of(self.showing.node.table())))?;
        self.state = State::Idle;
        Ok(())
    }

    /// Checks the monitor's first frame, which must prove that it has the token.
    fn prove(
        &mut self,
        challenge: &Challenge,
        frame: &Result<ClientFrame, DecodeError>,
        room: bool,
    ) -> Result<(), Gone> {
        let denied = match (&self.showing.token, frame) {
            (Some(token), Ok(ClientFrame::Proof(proof))) if !token.is_proven(challenge, proof) => {
                Denied::WrongToken
            }
            (None, _) | (Some(_), Ok(ClientFrame::Proof(_))) if room => return self.admit(),
            // Another monitor has taken the last free place in the meantime. The connection ends; when this monitor
            // connects again, the answer says that there is no place.
            (None, _) | (Some(_), Ok(ClientFrame::Proof(_))) => return Err(Gone),
            (Some(_), _) => Denied::NoToken,
        };
        self.writer.push(&ServerFrame::Denied(denied))?;
        self.state = State::Leaving;
        Ok(())
    }

    fn misunderstood(&mut self) -> Result<(), Gone> {
        self.writer.push(&ServerFrame::Bye(Bye { reason: Goodbye::Misunderstood }))?;
        self.state = State::Leaving;
        Ok(())
    }

    /// Makes at most one frame, and none while an earlier frame is still being sent.
    fn push_what_is_due(&mut self, pass: &mut Pass) -> Result<(), Gone> {
        if let Some(pong) = self.pong.take() {
            return Ok(self.writer.push(&ServerFrame::Pong(pong))?);
        }
        let State::Subscribed(subscription) = &mut self.state else { return Ok(()) };
        Ok(subscription.push(&self.showing, pass, &mut self.writer)?)
    }
}
