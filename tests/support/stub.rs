//! A stub of a node. It reports to monitors what a test gives it.

use imrs_wire::obs::{
    Events, FrameReader, FrameWriter, Handshake, Hello, MAX_REQUEST, NodeIdentity, Role, SCHEMA, ServerFrame,
    Snapshot, Table, TimedEvent, VERSION, Vitals, place,
};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// The interval between two reports of the state. With every `VITALS`-th report the stub also reports the vitals of its
/// process.
const PERIOD: Duration = Duration::from_millis(50);
const VITALS: u32 = 10;

/// What the stub reports.
#[derive(Debug, Default)]
pub struct Tells {
    /// The node's state, without the time.
    pub snapshot: Snapshot,
    /// The events that have not been reported yet.
    pub events: Vec<TimedEvent>,
    /// The vitals of the stub's process, without the time.
    pub vitals: Vitals,
}

/// Notes when a periodic activity last happened, and when it was last late.
#[derive(Clone, Debug)]
pub struct Beat(Arc<Mutex<(Instant, Option<Instant>)>>);

impl Beat {
    /// The activity is late if the time since it last happened is longer than this.
    const LATE: Duration = Duration::from_millis(500);

    fn start() -> Self {
        Self(Arc::new(Mutex::new((Instant::now(), None))))
    }

    fn beat(&self) {
        let (mut beat, now) = (self.0.lock().expect("no panic before"), Instant::now());
        if now > beat.0 + Self::LATE {
            beat.1 = Some(now);
        }
        beat.0 = now;
    }

    /// Whether the activity is late now, or was late within this time.
    pub fn was_late(&self, within: Duration) -> bool {
        let (last, late) = *self.0.lock().expect("no panic before");
        last.elapsed() > Self::LATE || late.is_some_and(|late| late.elapsed() < within)
    }
}

/// A stub of a node. It accepts monitors until the test's process ends.
pub struct Stub {
    tells: Arc<Mutex<Tells>>,
    since: Instant,
    /// When the stub last reported. A busy machine may delay the reports.
    pub beat: Beat,
}

impl Stub {
    /// Starts a stub whose socket is in this runtime folder, where monitors look for nodes.
    pub fn start(dir: &Path, identity: NodeIdentity, table: Table, tells: Tells) -> Self {
        let base = dir.join("imrs");
        let path = place::prepare_in(&base, &identity.cell, &identity.node, std::process::id());
        let listener = UnixListener::bind(path.expect("a place for the socket")).expect("a socket");
        let stub = Self { tells: Arc::new(Mutex::new(tells)), since: Instant::now(), beat: Beat::start() };
        let (tells, since, beat) = (Arc::clone(&stub.tells), stub.since, stub.beat.clone());
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let (identity, table, tells) = (identity.clone(), table.clone(), Arc::clone(&tells));
                let beat = beat.clone();
                // The thread ends when its monitor disconnects.
                thread::spawn(move || serve(stream, identity, table, &tells, (since, &beat)));
            }
        });
        stub
    }

    /// Changes what the stub reports to monitors from now on.
    pub fn change(&self, change: impl FnOnce(&mut Tells)) {
        change(&mut self.tells.lock().expect("no panic before"));
    }

    /// The present time on the stub's clock, in microseconds.
    pub fn mono_us(&self) -> u64 {
        mono_us(self.since)
    }
}

fn mono_us(since: Instant) -> u64 {
    1_000_000_000 + u64::try_from(since.elapsed().as_micros()).expect("a short time")
}

fn serve(
    stream: UnixStream,
    identity: NodeIdentity,
    table: Table,
    tells: &Mutex<Tells>,
    (since, beat): (Instant, &Beat),
) -> Option<()> {
    let mut reader = FrameReader::new(stream.try_clone().ok()?, MAX_REQUEST);
    let mut writer = FrameWriter::new(stream);
    let _hello = reader.read_frame().ok()?;
    let (build, mono) = ("stub 1".to_owned(), mono_us(since));
    let role = Role::Node(identity);
    let hello = Hello { schema: SCHEMA, pid: std::process::id(), build, mono_us: mono, role };
    writer.push_bytes(&Handshake::Hello(hello).encode(VERSION)).ok()?;
    writer.push(&ServerFrame::Table(table)).ok()?;
    writer.flush().ok()?;
    // The monitor's requests are read, but not carried out.
    thread::spawn(move || while reader.read_frame().is_ok() {});
    for round in 0.. {
        let mono_us = mono_us(since);
        let mut frames = Vec::new();
        {
            let mut tells = tells.lock().expect("no panic before");
            let snapshot = Snapshot { mono_us, uptime_us: mono_us - 900_000_000, ..tells.snapshot.clone() };
            frames.push(ServerFrame::Snapshot(snapshot));
            let events = std::mem::take(&mut tells.events);
            if !events.is_empty() {
                frames.push(ServerFrame::Events(Events { lost: 0, events }));
            }
            if round % VITALS == 0 {
                frames.push(ServerFrame::Vitals(Vitals { mono_us, ..tells.vitals.clone() }));
            }
        }
        for frame in &frames {
            writer.push(frame).ok()?;
        }
        writer.flush().ok()?;
        beat.beat();
        thread::sleep(PERIOD);
    }
    None
}
