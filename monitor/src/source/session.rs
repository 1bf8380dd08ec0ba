//! One connection to one node, from connecting to its end.

use super::{Feed, Sink, SourceId};
use crate::options::Endpoint;
use imrs_wire::obs::{
    ClientFrame, DecodeError, FrameError, FrameReader, FrameWriter, Handshake, Hello, MAX_FRAME, Role,
    SCHEMA, ServerFrame, Subscribe, VERSION, agree,
};
use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long a node has to answer a hello.
const PATIENCE: Duration = Duration::from_secs(1);
/// How often a waiting session looks whether it should stop.
const LOOK: Duration = Duration::from_millis(100);
/// How many frames a node may send ahead.
const CREDIT: u16 = 8;

/// What a session asks of a node.
#[derive(Clone, Copy, Debug)]
pub(super) struct Want {
    pub period: Duration,
    pub queue_limit: u8,
    pub events: bool,
}

/// How a session ended.
#[derive(Debug)]
pub(super) enum End {
    /// It was told to stop.
    Stopped,
    /// Nobody listens there.
    Refused(String),
    /// It never got through.
    Failed(String),
    /// It was attached, and is no longer.
    Lost(String),
}

/// Attaches to `endpoint` and delivers what it says until either side ends.
pub(super) fn run(endpoint: &Endpoint, id: SourceId, want: Want, sink: &Sink, stop: &AtomicBool) -> End {
    match endpoint {
        Endpoint::Unix(path) => match UnixStream::connect(path).and_then(|s| {
            s.set_read_timeout(Some(LOOK))?;
            s.set_write_timeout(Some(PATIENCE))?;
            Ok((s.try_clone()?, s))
        }) {
            Ok((reader, writer)) => talk(endpoint, id, want, sink, stop, reader, writer),
            Err(e) => unreachable_end(endpoint, &e),
        },
        Endpoint::Tcp(address) => match connect_tcp(address) {
            Ok((reader, writer)) => talk(endpoint, id, want, sink, stop, reader, writer),
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

fn talk(
    endpoint: &Endpoint,
    id: SourceId,
    want: Want,
    sink: &Sink,
    stop: &AtomicBool,
    reader: impl Read,
    writer: impl Write,
) -> End {
    let mut reader = FrameReader::new(reader, MAX_FRAME);
    let mut writer = FrameWriter::new(writer);
    let attached = match greet(&mut reader, &mut writer, want, stop) {
        Ok(Some(attached)) => attached,
        Ok(None) => return End::Stopped,
        Err(why) => return End::Failed(format!("{endpoint}: {why}")),
    };
    if !sink.deliver(id, attached) {
        return End::Stopped;
    }
    let mut owed = 0;
    loop {
        if stop.load(Ordering::Relaxed) {
            return End::Stopped;
        }
        let frame = match reader.read_frame() {
            Ok(bytes) => ServerFrame::decode(bytes),
            Err(FrameError::NotReady) => continue,
            Err(e) => return End::Lost(e.to_string()),
        };
        match frame {
            Ok(frame) => {
                owed += u16::from(matches!(frame, ServerFrame::Snapshot(_) | ServerFrame::Events(_)));
                if !sink.deliver(id, Feed::Frame(Box::new(frame))) {
                    return End::Stopped;
                }
            }
            // A kind of a later minor version that the node should not have sent: it can be passed over.
            Err(DecodeError::UnknownKind(_)) => {}
            Err(e) => return End::Lost(format!("it sent {e}")),
        }
        // Credit is given back when a frame has been taken, so a busy monitor slows its own frames, never the node.
        if owed >= CREDIT / 2 {
            if let Err(e) = say(&mut writer, &ClientFrame::Credit(owed)) {
                return End::Lost(e.to_string());
            }
            owed = 0;
        }
    }
}

fn say(writer: &mut FrameWriter<impl Write>, frame: &ClientFrame) -> Result<(), FrameError> {
    writer.push(frame)?;
    writer.flush()
}

/// The handshake and the subscription. `None`: told to stop.
fn greet(
    reader: &mut FrameReader<impl Read>,
    writer: &mut FrameWriter<impl Write>,
    want: Want,
    stop: &AtomicBool,
) -> Result<Option<Feed>, String> {
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
            Err(FrameError::NotReady) if stop.load(Ordering::Relaxed) => return Ok(None),
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
    agree((version, hello.schema), (VERSION, SCHEMA)).map_err(|refusal| refusal.to_string())?;
    let Role::Node(identity) = hello.role else {
        return Err("a monitor answered, not a node".to_owned());
    };
    let subscribe = Subscribe {
        period_us: u32::try_from(want.period.as_micros()).unwrap_or(u32::MAX),
        queue_limit: want.queue_limit,
        events: want.events,
        credit: CREDIT,
    };
    say(writer, &ClientFrame::Subscribe(subscribe)).map_err(text)?;
    Ok(Some(Feed::Attached { identity, pid: hello.pid, build: hello.build }))
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
