//! Tests of sessions with simulated nodes.

use super::*;
use crate::clock::Clock;
use imrs_protocol::Incarnation;
use imrs_wire::obs::Table;
use std::sync::{Arc, Mutex};

/// A writer that accepts one write, the hello; later writes fail.
struct Closed(bool);

impl Write for Closed {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if std::mem::replace(&mut self.0, true) {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A writer that keeps all written bytes.
#[derive(Clone, Default)]
struct Kept(Arc<Mutex<Vec<u8>>>);

impl Write for Kept {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The bytes that a node of this version sends: its hello, and these frames.
fn said((version, schema): (Version, u32), frames: &[ServerFrame]) -> Vec<u8> {
    let mut said = FrameWriter::new(Vec::new());
    let role = Role::Node(NodeIdentity {
        cell: "beam-lift".into(),
        digest: 1,
        node: "nl".into(),
        id: 0,
        incarnation: Incarnation(1),
        tick_us: 1,
    });
    let hello = Hello { schema, pid: 1, build: "fake 1".into(), mono_us: 0, role };
    said.push_bytes(&Handshake::Hello(hello).encode(version)).unwrap();
    frames.iter().for_each(|frame| said.push(frame).unwrap());
    said.flush().unwrap();
    said.get_ref().clone()
}

/// Runs a session with a node that sends these bytes and closes. Returns how the session ended, and which messages
/// reached the sink.
fn talked(said: &[u8], token: Option<&Token>, writer: impl Write) -> (End, Vec<Feed>) {
    let heard = Arc::new(Mutex::new(Vec::new()));
    let hears = heard.clone();
    let sink = Sink::new(Clock::start(), move |arrival| {
        hears.lock().unwrap().push(arrival.feed);
        true
    });
    let with = Talk {
        id: SourceId(0),
        pace: Pace { period: Duration::from_millis(100) },
        wishes: &Wishes::default(),
        token,
        sink: &sink,
        stop: &AtomicBool::new(false),
        told: &|_, _| {},
    };
    let end = talk(&Endpoint::Tcp("here".into()), &with, said, writer);
    let heard = std::mem::take(&mut *heard.lock().unwrap());
    (end, heard)
}

#[test]
fn what_a_node_said_before_it_went_is_read_although_it_can_be_told_nothing() {
    let last = ServerFrame::Table(Table::default());
    let said = said((VERSION, SCHEMA), std::slice::from_ref(&last));
    let (end, heard) = talked(&said, None, Closed(false));
    assert!(matches!(&end, End::Lost(why) if why == "the connection was closed"), "{end:?}");
    assert!(
        matches!(heard.as_slice(), [Feed::Attached { .. }, Feed::Frame(frame)] if **frame == last),
        "{heard:?}"
    );
}

/// The frames that a monitor sent after its hello, without its pings.
fn frames(kept: &Kept) -> Vec<ClientFrame> {
    let bytes = kept.0.lock().unwrap().clone();
    let mut reader = FrameReader::new(bytes.as_slice(), MAX_FRAME);
    reader.read_frame().expect("its hello");
    let frames = std::iter::from_fn(|| ClientFrame::decode(reader.read_frame().ok()?).ok());
    frames.filter(|frame| !matches!(frame, ClientFrame::Ping(_))).collect()
}

#[test]
fn a_token_is_proven_first_and_never_sent() {
    let token = Token::of("a token of this test").unwrap();
    let (table, challenge) = (ServerFrame::Table(Table::default()), Challenge([5; 32]));
    let asks = said((VERSION, SCHEMA), &[ServerFrame::Challenge(challenge), table.clone()]);
    let kept = Kept::default();
    let (_, heard) = talked(&asks, Some(&token), kept.clone());
    assert_eq!(heard.len(), 2, "{heard:?}");
    let sent = frames(&kept);
    assert_eq!(sent[0], ClientFrame::Proof(token.proof(&challenge)));
    assert!(matches!(sent[1..], [ClientFrame::Want(_)]), "{sent:?}");
    // In both cases the monitor subscribes: the first node requires no token, and the second, of an earlier version,
    // gets none.
    let old = (Version { major: 1, minor: 2 }, 0xed49_0a48);
    for node in [(VERSION, SCHEMA), old] {
        let kept = Kept::default();
        talked(&said(node, std::slice::from_ref(&table)), Some(&token), kept.clone());
        assert!(matches!(frames(&kept)[..], [ClientFrame::Want(_)]), "{:?}", frames(&kept));
    }
}
