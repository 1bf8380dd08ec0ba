//! A fake node: it serves the observation protocol from a thread, correctly or with faults.

use super::{identity, snapshot, table};
use imrs_wire::obs::{
    ClientFrame, FrameError, FrameReader, FrameWriter, Handshake, Hello, MAX_REQUEST, Role, SCHEMA,
    ServerFrame, VERSION, Version, place,
};
use std::io::Write;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

/// The longest time that a server blocks in a read or write.
const LONG: Duration = Duration::from_secs(150);

pub struct Peer {
    pub reader: FrameReader<UnixStream>,
    pub writer: FrameWriter<UnixStream>,
}

impl Peer {
    pub fn hello(&mut self, node: usize, version: Version, schema: u32) -> Result<(), FrameError> {
        let request = self.reader.read_frame()?;
        let (_, theirs) = Handshake::decode(request).expect("a monitor's hello");
        assert!(matches!(theirs, Handshake::Hello(Hello { role: Role::Monitor, .. })));
        let role = Role::Node(identity(node, 1));
        let hello = Hello { schema, pid: std::process::id(), build: "fake 1".into(), mono_us: 0, role };
        self.writer.push_bytes(&Handshake::Hello(hello).encode(version))?;
        self.writer.flush()
    }

    pub fn say(&mut self, frame: &ServerFrame) -> Result<(), FrameError> {
        self.writer.push(frame)?;
        self.writer.flush()
    }

    /// The next frame of the monitor, except pings.
    pub fn hear(&mut self) -> Result<ClientFrame, FrameError> {
        loop {
            match ClientFrame::decode(self.reader.read_frame()?).expect("a monitor's frame") {
                ClientFrame::Ping(_) => {}
                frame => return Ok(frame),
            }
        }
    }

    pub fn raw(&mut self, bytes: &[u8]) {
        let mut stream = self.writer.get_ref();
        stream.write_all(bytes).unwrap();
    }

    /// Does the handshake, sends the table, and reads the subscription. Returns the subscription's credit.
    pub fn greet(&mut self, node: usize) -> Result<u16, FrameError> {
        self.hello(node, VERSION, SCHEMA)?;
        self.say(&ServerFrame::Table(table()))?;
        match self.hear()? {
            ClientFrame::Want(want) => Ok(want.credit),
            other => panic!("{other:?}"),
        }
    }

    /// Serves snapshots, one per credit, until the monitor leaves.
    pub fn serve(&mut self, node: usize) {
        if let Ok(credit) = self.greet(node) {
            self.serve_on(node, credit);
        }
    }

    /// As [`serve`](Self::serve), for a connection after its handshake.
    pub fn serve_on(&mut self, node: usize, mut credit: u16) {
        loop {
            while credit > 0 {
                if self.say(&ServerFrame::Snapshot(snapshot(node))).is_err() {
                    return;
                }
                credit -= 1;
                thread::sleep(Duration::from_millis(5));
            }
            match self.hear() {
                Ok(ClientFrame::Credit(more)) => credit += more,
                Ok(ClientFrame::Want(want)) => credit = want.credit,
                Ok(ClientFrame::Whole) => {}
                _ => return,
            }
        }
    }
}

/// Creates a socket in `base`. `each` serves every connection in a thread of its own, until the test process ends. The
/// folder must belong to the test.
pub fn listen(base: &Path, node: &str, each: impl Fn(Peer) + Send + Clone + 'static) -> PathBuf {
    let path = place::prepare_in(base, "beam-lift", node, std::process::id()).unwrap();
    let listener = UnixListener::bind(&path).unwrap();
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            stream.set_read_timeout(Some(LONG)).unwrap();
            stream.set_write_timeout(Some(LONG)).unwrap();
            let reader = FrameReader::new(stream.try_clone().unwrap(), MAX_REQUEST);
            let peer = Peer { reader, writer: FrameWriter::new(stream) };
            let each = each.clone();
            thread::spawn(move || each(peer));
        }
    });
    path
}
