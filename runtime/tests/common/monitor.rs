//! An observed node, and a monitor of that node which a test controls.

use super::{A, B, LONG, LONG_TICKS, ask, cell, one_node, report, table};
use imrs_protocol::{PortDecl, Ticks, Usage};
use imrs_runtime::observer::{Observer, Place};
use imrs_runtime::{Runtime, Sent};
use imrs_wire::obs::{
    ClientFrame, FrameReader, FrameWriter, Handshake, Hello, MAX_FRAME, Role, SCHEMA, ServerFrame, Snapshot,
    Subscribe, VERSION, Version, Want,
};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

/// The longest time that an answer of an observer may take. An observer has the lowest priority, so a busy machine may not
/// run it for minutes.
pub const PATIENCE: Duration = LONG.saturating_mul(10);

/// The version and schema of programs that speak version 1.0.
pub const OLD: (Version, u32) = (Version { major: 1, minor: 0 }, 0x3723_afbb);
pub const NEW: (Version, u32) = (VERSION, SCHEMA);

/// A folder that belongs to one test.
pub struct Folder(pub PathBuf);

impl Folder {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("imrs-runtime-{name}-{}", std::process::id()));
        // The folder of the cell, below the folder of all cells. An observer looks in the cell's folder for the sockets
        // of neighbours.
        std::fs::create_dir_all(path.join("cell")).expect("a folder");
        Self(path)
    }

    pub fn socket(&self) -> PathBuf {
        self.0.join("cell").join("n.sock")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A node whose task `a` sends the messages that the test orders, and whose task `b` takes none of them.
pub fn node() -> (Runtime, Sender<u8>) {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(16));
    let (tell, told) = report::<u8>();
    let runtime = one_node(&table(cell))
        .task("a", move |ctx| {
            let news = ctx.port("news")?;
            while let Ok(number) = told.recv() {
                assert_eq!(ctx.send(news, &[number])?, Sent::Copies(1));
            }
            Ok(())
        })
        .task("b", |ctx| {
            let ask = ctx.port("ask")?;
            ctx.receive(Some(ask), None).map(|_| ())
        })
        .start()
        .unwrap();
    (runtime, tell)
}

/// The socket at which the node listens.
pub fn socket(observer: &Observer) -> &Path {
    match observer.place() {
        Place::Unix(path) => path,
        Place::Tcp(address) => panic!("at {address}"),
    }
}

pub fn want() -> Want {
    Want {
        period_us: 10_000,
        queue_limit: 0,
        watched: Vec::new(),
        events: None,
        vitals_us: 0,
        whole_us: 0,
        credit: u16::MAX,
    }
}

pub struct Monitor {
    pub reader: FrameReader<Box<dyn Read>>,
    pub writer: FrameWriter<Box<dyn Write>>,
    patience: Box<dyn Fn(Duration)>,
}

impl Monitor {
    pub fn unix(path: &Path) -> Self {
        let stream = UnixStream::connect(path).expect("a listening node");
        let own = stream.try_clone().unwrap();
        let patience = move |length| own.set_read_timeout(Some(length)).unwrap();
        Self::over(stream.try_clone().unwrap(), stream, patience)
    }

    pub fn tcp(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).expect("a listening node");
        let own = stream.try_clone().unwrap();
        let patience = move |length| own.set_read_timeout(Some(length)).unwrap();
        Self::over(stream.try_clone().unwrap(), stream, patience)
    }

    fn over(
        read: impl Read + 'static,
        write: impl Write + 'static,
        patience: impl Fn(Duration) + 'static,
    ) -> Self {
        patience(PATIENCE);
        Self {
            reader: FrameReader::new(Box::new(read), MAX_FRAME),
            writer: FrameWriter::new(Box::new(write)),
            patience: Box::new(patience),
        }
    }

    /// Sets how long the monitor waits for each frame at most.
    pub fn wait_for(&self, length: Duration) {
        (self.patience)(length);
    }

    pub fn hello(&mut self, (version, schema): (Version, u32)) -> Handshake {
        let hello = Hello { schema, pid: 1, build: "test".into(), mono_us: 0, role: Role::Monitor };
        self.writer.push_bytes(&Handshake::Hello(hello).encode(version)).unwrap();
        self.writer.flush().unwrap();
        Handshake::decode(self.reader.read_frame().expect("an answer")).expect("a hello").1
    }

    /// Says hello, and reads the table of names.
    pub fn attach(mut self, version: (Version, u32)) -> Self {
        let answer = self.hello(version);
        let Handshake::Hello(Hello { role: Role::Node(identity), .. }) = answer else { panic!("{answer:?}") };
        assert_eq!((identity.cell.as_str(), identity.node.as_str(), identity.tick_us), ("test", "n0", 1));
        let ServerFrame::Table(table) = self.next() else { panic!("the table comes first") };
        assert_eq!(table.tasks.len(), 2);
        self
    }

    pub fn say(&mut self, frame: &ClientFrame) {
        self.writer.push(frame).unwrap();
        self.writer.flush().unwrap();
    }

    /// Subscribes as monitors of version 1.0 do.
    pub fn subscribe(&mut self, events: bool, credit: u16) {
        self.say(&ClientFrame::Subscribe(Subscribe { period_us: 10_000, queue_limit: 8, events, credit }));
    }

    pub fn next(&mut self) -> ServerFrame {
        ServerFrame::decode(self.reader.read_frame().expect("a frame")).expect("a known frame")
    }

    /// Reads frames until `wanted` returns a value, and keeps `state` up to date meanwhile.
    pub fn until<T>(
        &mut self,
        state: &mut Snapshot,
        mut wanted: impl FnMut(&ServerFrame, &Snapshot) -> Option<T>,
    ) -> T {
        let start = Instant::now();
        loop {
            assert!(start.elapsed() < PATIENCE, "it never came");
            let frame = self.next();
            if let ServerFrame::Delta(delta) = &frame {
                state.apply(delta).expect("a change of what was told last");
            }
            if let Some(found) = wanted(&frame, state) {
                return found;
            }
        }
    }
}
