//! One connection of the monitor to one node, from connecting to its end.

#[cfg(test)]
mod tests;

use super::{Feed, Sink, SourceId, Wishes};
use crate::options::Endpoint;
use imrs_wire::obs::{
    Challenge, ClientFrame, DecodeError, FrameError, FrameReader, FrameWriter, Handshake, Hello, MAX_FRAME,
    MAX_WATCHED, NodeIdentity, Ping, Places, Role, SCHEMA, ServerFrame, Subscribe, Token, VERSION, Version,
    Want, agree,
};
use std::fmt::Display;
use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The first minor version in which a monitor proves that it has the token.
const PROOFS: u16 = 3;

/// How long a node may take to answer a hello: on a busy machine its thread for monitors runs last.
const PATIENCE: Duration = Duration::from_secs(3);
/// How often a waiting session checks whether the subscription has changed, and whether the session must stop.
const LOOK: Duration = Duration::from_millis(100);
/// How many frames a node may send without new credit.
const CREDIT: u16 = 8;
/// How often the clocks are compared.
const PING: Duration = Duration::from_secs(1);
/// How often a node sends metrics of its process.
const VITALS: Duration = Duration::from_secs(1);

/// The part of a subscription that is the same on all screens.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    pub period: Duration,
}

/// The data that a session needs besides its connection.
pub(super) struct Talk<'a> {
    pub id: SourceId,
    pub pace: Pace,
    pub wishes: &'a Wishes,
    pub token: Option<&'a Token>,
    pub sink: &'a Sink,
    pub stop: &'a AtomicBool,
    /// Called with the node's identity and the addresses that the node reports for other nodes.
    pub told: &'a dyn Fn(&NodeIdentity, &Places),
}

/// How a session ended.
#[derive(Debug)]
pub(super) enum End {
    /// The monitor told the session to stop.
    Stopped,
    /// No process listens at the node's address.
    Refused(String),
    /// The session never attached to the node.
    Failed(String),
    /// The session lost its connection after attaching.
    Lost(String),
}

/// Attaches to `endpoint` and delivers its frames until either side ends.
pub(super) fn run(endpoint: &Endpoint, with: &Talk<'_>) -> End {
    match endpoint {
        Endpoint::Unix(path) => match UnixStream::connect(path).and_then(|s| {
            s.set_read_timeout(Some(LOOK))?;
            s.set_write_timeout(Some(PATIENCE))?;
            Ok((s.try_clone()?, s))
        }) {
            Ok((reader, writer)) => talk(endpoint, with, reader, writer),
            Err(e) => unreachable_end(endpoint, &e),
        },
        Endpoint::Tcp(address) => match connect_tcp(address) {
            Ok((reader, writer)) => talk(endpoint, with, reader, writer),
            Err(e) => unreachable_end(endpoint, &e),
        },
    }
}

fn unreachable_end(endpoint: &Endpoint, error: &io::Error) -> End {
    let why = format!("{endpoint}: {error}");
    match error.kind() {
        io::ErrorKind::ConnectionRefused | io::ErrorKind::NotFound => End::Refused(why),
        _ => End::Failed(why),
    }
}

fn connect_tcp(address: &str) -> io::Result<(TcpStream, TcpStream)> {
    let mut last = io::Error::new(io::ErrorKind::NotFound, "no such host");
    for one in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&one, PATIENCE) {
            Ok(stream) => {
                stream.set_read_timeout(Some(LOOK))?;
                stream.set_write_timeout(Some(PATIENCE))?;
                stream.set_nodelay(true)?;
                return Ok((stream.try_clone()?, stream));
            }
            Err(e) => last = e,
        }
    }
    Err(last)
}

fn talk(endpoint: &Endpoint, with: &Talk<'_>, reader: impl Read, writer: impl Write) -> End {
    let mut reader = FrameReader::new(reader, MAX_FRAME);
    let mut writer = FrameWriter::new(writer);
    let (version, attached) = match greet(&mut reader, &mut writer, with) {
        Ok(Some(attached)) => attached,
        Ok(None) => return End::Stopped,
        Err(why) => return End::Failed(format!("{endpoint}: {why}")),
    };
    let Feed::Attached { identity, .. } = &attached else { return End::Stopped };
    let identity = identity.clone();
    let mut session = Session::new(with, identity, writer, version.minor >= 1);
    let mut attached = Some(attached);
    let ended = |attached: &Option<Feed>, why: &dyn Display| match attached {
        Some(_) => End::Failed(format!("{endpoint}: {why}")),
        None => End::Lost(why.to_string()),
    };
    // A node that requires a token first sends a challenge, and no other frame before the proof. A node of a version
    // without challenges gets no token, because any process could take the node's place and read it.
    if (with.token.is_none() || version.minor < PROOFS)
        && let Err(error) = session.begin()
    {
        return ended(&attached, &error);
    }
    loop {
        if with.stop.load(Ordering::Relaxed) {
            return End::Stopped;
        }
        if let Err(error) = session.keep_up() {
            return ended(&attached, &error);
        }
        let frame = match reader.read_frame() {
            Ok(bytes) => ServerFrame::decode(bytes),
            Err(FrameError::NotReady) if session.deaf => return ended(&attached, &FrameError::Closed),
            Err(FrameError::NotReady) => continue,
            Err(error) => return ended(&attached, &error),
        };
        let frame = match frame {
            Ok(ServerFrame::Denied(denied)) => return End::Failed(format!("{endpoint}: {denied}")),
            Ok(ServerFrame::Challenge(challenge)) => match session.prove(&challenge) {
                Ok(()) => continue,
                Err(error) => return ended(&attached, &error),
            },
            Ok(frame) => frame,
            // The node should not have sent a frame of a later minor version, but such a frame can be skipped.
            Err(DecodeError::UnknownKind(_)) => continue,
            Err(error) => return ended(&attached, &format!("it sent {error}")),
        };
        if !session.begun
            && let Err(error) = session.begin()
        {
            return ended(&attached, &error);
        }
        if let Some(attached) = attached.take()
            && !with.sink.deliver(with.id, attached)
        {
            return End::Stopped;
        }
        match session.take(frame) {
            Ok(true) => {}
            Ok(false) => return End::Stopped,
            Err(error) => return End::Lost(error.to_string()),
        }
    }
}

/// A connection that is attached to a node.
struct Session<'a, W> {
    with: &'a Talk<'a>,
    identity: NodeIdentity,
    writer: FrameWriter<W>,
    /// Whether the node speaks version 1.1 of the protocol or a later one.
    new: bool,
    /// Whether the node has been told what the monitor wants.
    begun: bool,
    /// How many frames were received for which no credit was returned yet.
    owed: u16,
    /// The versions of the subscription that were sent to the node.
    known: (u64, u64),
    /// The node's clock at the snapshot to which the next delta applies.
    told: Option<u64>,
    ping_at: Instant,
    /// Whether the node no longer reads. The frames that it had sent before are still to be read.
    deaf: bool,
}

impl<'a, W: Write> Session<'a, W> {
    fn new(with: &'a Talk<'a>, identity: NodeIdentity, writer: FrameWriter<W>, new: bool) -> Self {
        let ping_at = Instant::now();
        Self {
            with,
            identity,
            writer,
            new,
            begun: false,
            owed: 0,
            known: (0, 0),
            told: None,
            ping_at,
            deaf: false,
        }
    }

    fn say(&mut self, frame: &ClientFrame) -> Result<(), FrameError> {
        if self.deaf {
            return Ok(());
        }
        match self.writer.push(frame).and_then(|()| self.writer.flush()) {
            Err(FrameError::Closed) => {
                self.deaf = true;
                Ok(())
            }
            said => said,
        }
    }

    /// Proves to the node that this monitor has the token. Without a token it sends nothing, and the node then denies access.
    fn prove(&mut self, challenge: &Challenge) -> Result<(), FrameError> {
        let Some(token) = self.with.token.filter(|_| !self.begun) else { return Ok(()) };
        self.say(&ClientFrame::Proof(token.proof(challenge)))?;
        self.begin()
    }

    fn begin(&mut self) -> Result<(), FrameError> {
        self.begun = true;
        if !self.new {
            let wanted = self.with.wishes.present().0;
            let subscribe = Subscribe {
                period_us: micros(self.with.pace.period),
                queue_limit: wanted.queue_limit.max(if wanted.watched.is_empty() { 0 } else { u8::MAX }),
                events: wanted.events.is_some(),
                credit: CREDIT,
            };
            return self.say(&ClientFrame::Subscribe(subscribe));
        }
        self.known.1 = self.with.wishes.whole();
        self.want()
    }

    fn want(&mut self) -> Result<(), FrameError> {
        let (wanted, version) = self.with.wishes.present();
        self.known.0 = version;
        self.owed = 0;
        let here = wanted.cell.is_none_or(|cell| cell == self.identity.cell);
        let own = |&(node, task, port): &(imrs_protocol::NodeId, _, _)| {
            (here && node.0 == self.identity.id).then_some((task, port))
        };
        let want = Want {
            period_us: micros(self.with.pace.period),
            queue_limit: wanted.queue_limit,
            watched: wanted.watched.iter().filter_map(own).take(MAX_WATCHED).collect(),
            events: wanted.events,
            vitals_us: micros(VITALS),
            whole_us: 0,
            credit: CREDIT,
        };
        self.say(&ClientFrame::Want(want))
    }

    /// Sends the subscription if it has changed, and a ping when one is due.
    fn keep_up(&mut self) -> Result<(), FrameError> {
        if !self.new || !self.begun {
            return Ok(());
        }
        if self.known.0 != self.with.wishes.version() {
            self.want()?;
        }
        let whole = self.with.wishes.whole();
        if self.known.1 != whole {
            self.known.1 = whole;
            self.say(&ClientFrame::Whole)?;
        }
        if self.ping_at <= Instant::now() {
            self.ping_at = Instant::now() + PING;
            let mono_us = crate::clock::micros(self.with.sink.now());
            self.say(&ClientFrame::Ping(Ping { mono_us }))?;
        }
        Ok(())
    }

    /// Passes a frame on. Returns false if the receiver wants no more frames.
    fn take(&mut self, frame: ServerFrame) -> Result<bool, FrameError> {
        self.owed += u16::from(frame.costs());
        let mut fits = true;
        if let ServerFrame::Delta(delta) = &frame {
            fits = delta.base_us.is_none() || delta.base_us == self.told;
            self.told = Some(delta.base_us.unwrap_or(0).wrapping_add(delta.passed_us)).filter(|_| fits);
        }
        if let ServerFrame::Places(places) = &frame {
            (self.with.told)(&self.identity, places);
        }
        if !fits {
            self.say(&ClientFrame::Whole)?;
        } else if !self.with.sink.deliver(self.with.id, Feed::Frame(Box::new(frame))) {
            return Ok(false);
        }
        // Credit is returned after a frame has been handled, so a busy monitor slows its own frames and never the node.
        if self.owed >= CREDIT / 2 {
            self.say(&ClientFrame::Credit(self.owed))?;
            self.owed = 0;
        }
        Ok(true)
    }
}

fn micros(length: Duration) -> u32 {
    u32::try_from(length.as_micros()).unwrap_or(u32::MAX)
}

/// Exchanges the handshake. Returns `None` if the session must stop.
fn greet(
    reader: &mut FrameReader<impl Read>,
    writer: &mut FrameWriter<impl Write>,
    with: &Talk<'_>,
) -> Result<Option<(Version, Feed)>, String> {
    let hello = Hello {
        schema: SCHEMA,
        pid: std::process::id(),
        build: concat!("imrs-monitor ", env!("CARGO_PKG_VERSION")).to_owned(),
        mono_us: 0,
        role: Role::Monitor,
    };
    let text = |e: FrameError| e.to_string();
    writer.push_bytes(&Handshake::Hello(hello).encode(VERSION)).map_err(text)?;
    writer.flush().map_err(text)?;
    let deadline = Instant::now() + PATIENCE;
    let (version, theirs) = loop {
        match reader.read_frame() {
            Ok(bytes) => break Handshake::decode(bytes).map_err(explained)?,
            Err(FrameError::NotReady) if with.stop.load(Ordering::Relaxed) => return Ok(None),
            Err(FrameError::NotReady) if Instant::now() < deadline => {}
            Err(FrameError::NotReady) => {
                return Err(format!("no answer in {PATIENCE:?}; is the node stopped?"));
            }
            Err(e) => return Err(e.to_string()),
        }
    };
    let hello = match theirs {
        Handshake::Hello(hello) => hello,
        Handshake::Refused(refusal) => return Err(refusal.to_string()),
    };
    let version = agree((version, hello.schema), (VERSION, SCHEMA)).map_err(|refusal| refusal.to_string())?;
    let Role::Node(identity) = hello.role else {
        return Err("a monitor answered, not a node".to_owned());
    };
    Ok(Some((version, Feed::Attached { identity, pid: hello.pid, build: hello.build })))
}

fn explained(error: DecodeError) -> String {
    match error {
        DecodeError::OtherMajor { theirs, ours } => {
            format!(
                "it speaks imrs-obs {theirs}, this monitor {ours}: use a node and a monitor of one release"
            )
        }
        other => other.to_string(),
    }
}
