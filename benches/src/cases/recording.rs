//! Measures what recording and observation cost a node, and how fast a recording is replayed (D62).

use super::cells;
use super::{handoff, network};
use crate::cores::Core;
use crate::sample::{Sample, worked};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use imrs_protocol::{CellTable, Incarnation, NodeId, NodeTable, Usage};
use imrs_runtime::record::{About, FileRecorder, RecordingReader, Replay, Verdict, replay_recording};
use imrs_runtime::{Builder, Context, Observations, Runtime};
use std::io::{self, Write};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// The recorded incarnation, and whether an earlier incarnation may have taken commands.
const INCARNATION: (Incarnation, bool) = (Incarnation(1), false);
/// How many steps are recorded for a round trip between two scripts.
const STEPS: u32 = 5;
/// How many events are observed of a round trip between two scripts.
const EVENTS: u32 = 4;
/// How long the end of a recording may take.
const PATIENCE: Duration = Duration::from_secs(60);

/// Whether and how a node is recorded or observed.
#[derive(Clone, Copy)]
pub enum Watched {
    /// The node is neither recorded nor observed.
    Not,
    /// A recorder writes into a sink that takes all bytes at once.
    Recorded,
    /// A reader takes the node's observations every 20 ms.
    Observed,
}

/// The suite of recording, observation and replay.
#[must_use]
pub fn recording() -> Suite {
    let mut suite = Suite::new("recording");
    for (name, how) in
        [("alone", Watched::Not), ("recorded", Watched::Recorded), ("observed", Watched::Observed)]
    {
        suite.case(
            format!("threads {name}"),
            "send, receive, reply between two Rust tasks of a node, each on a thread that sleeps before every message",
            move |effort| threads(effort, how),
        );
        suite.case(
            format!("UDP {name}"),
            "send, receive, reply between Rust tasks of two nodes of one process; both are recorded or observed",
            move |effort| network::ask(effort, Core::Second, network::Asking { how, ..network::ASLEEP }),
        );
        suite.case(
            format!("scripts {name}"),
            "two scripts of a running node, run by the thread that began them: nothing sleeps, no kernel; that thread's processor time, so that other programs do not count",
            move |effort| handoff::scripts(effort, Usage::Send, how, worked),
        );
    }
    suite.case(
        "replay",
        "a recording in memory is read, run again and compared; nanoseconds per input, one thread; counts bytes per input",
        replay,
    );
    for of in ["threads", "UDP", "scripts"] {
        let (recorded, observed, alone) =
            (format!("{of} recorded"), format!("{of} observed"), format!("{of} alone"));
        suite.row(if of == "scripts" {
            let what = "scripts recorded above scripts alone: nanoseconds a recorded step";
            let cases = [recorded.as_str(), &alone];
            Row::above("D62", what, cases, STEPS, Stat::P50, Goal::AtMost(20.0)).was("<= 1.05 times")
        } else {
            Row::new("D62", recorded, &alone, Stat::P50, Goal::AtMost(1.05))
        });
        suite.row(Row::new("D62", observed, &alone, Stat::P50, Goal::AtMost(1.05)));
    }
    let what = "scripts observed above scripts alone: nanoseconds an observed event";
    let cases = ["scripts observed", "scripts alone"];
    suite.row(Row::above("M5", what, cases, EVENTS, Stat::P50, Goal::AtMost(5.0)));
    let what = "replay: nanoseconds per recorded event (1 M events/s)";
    suite.row(Row::bounded("D62", what, "replay", Stat::Mean, Goal::AtMost(1_000.0)));
    suite
}

/// The recorder or observer of a node. Call [`of`](Self::of) and [`told_by`](Self::told_by) before the node starts,
/// [`look`](Self::look) when it runs, and [`leave`](Self::leave) when it has stopped.
pub struct Onlooker {
    recorder: Option<Arc<FileRecorder>>,
    observer: Option<(std::sync::mpsc::Sender<()>, std::thread::JoinHandle<()>)>,
}

impl Onlooker {
    /// Makes the recorder of a node that is not started yet.
    #[must_use]
    pub fn of(how: Watched, table: &Arc<CellTable>, node: NodeId) -> Self {
        let recorder = matches!(how, Watched::Recorded)
            .then(|| recorder(io::sink(), &NodeTable::new(Arc::clone(table), node)));
        Self { recorder, observer: None }
    }

    /// Adds the recorder to the node.
    pub fn told_by(&self, node: Builder) -> Builder {
        let node = node.incarnation(INCARNATION.0, INCARNATION.1);
        match &self.recorder {
            Some(recorder) => node.recorder(Arc::clone(recorder) as _),
            None => node,
        }
    }

    /// Begins to observe the running node.
    pub fn look(&mut self, how: Watched, node: &Runtime) {
        if matches!(how, Watched::Observed) {
            let (stop, stopped) = channel();
            let observations = node.node().observe();
            self.observer = Some((stop, std::thread::spawn(move || drain(observations, &stopped))));
        }
    }

    /// Ends the observation and the recording of a stopped node.
    pub fn leave(self) {
        if let Some((stop, thread)) = self.observer {
            drop(stop);
            thread.join().expect("it only reads");
        }
        if let Some(recorder) = self.recorder {
            let status = recorder.stop(PATIENCE).expect("stopped once");
            assert!(status.ended, "{status:?}");
        }
    }
}

fn drain(mut observations: Observations, stopped: &std::sync::mpsc::Receiver<()>) {
    let mut events = Vec::new();
    while stopped.recv_timeout(Duration::from_millis(20)) == Err(std::sync::mpsc::RecvTimeoutError::Timeout) {
        events.clear();
        let _lost = observations.drain(usize::MAX, &mut events);
    }
}

fn recorder(sink: impl Write + Send + 'static, table: &NodeTable) -> Arc<FileRecorder> {
    let failed = |error: &_| panic!("memory takes everything: {error}");
    let about = About { incarnation: INCARNATION, insecure: true, build: "bench", statements: 0 };
    FileRecorder::start(sink, table, &about, failed).expect("a recording")
}

fn threads(effort: Effort, how: Watched) -> Sample {
    let table = cells::asking(1, Usage::Send);
    let (tell, told) = channel();
    let times = effort.of(1_500);
    let mut onlooker = Onlooker::of(how, &table, NodeId(0));
    let node = onlooker.told_by(Runtime::builder(table, NodeId(0)));
    let node = node
        .task("t0", move |ctx| {
            tell.send(cells::ask(ctx, &cells::FULL, times, 1)?).expect("the harness listens");
            Ok(())
        })
        .task("t1", cells::answer)
        .start()
        .expect("a node that starts");
    onlooker.look(how, &node);
    let sample = cells::hear(node, &told);
    onlooker.leave();
    sample
}

/// A sink that keeps all written bytes.
#[derive(Clone, Default)]
struct Kept(Arc<Mutex<Vec<u8>>>);

impl Write for Kept {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().expect("nobody panics here").extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The table of a node whose tasks asked and answered, and the node's recording.
fn recorded(times: u32) -> (Arc<CellTable>, Vec<u8>) {
    let table = cells::asking(1, Usage::Send);
    let kept = Kept::default();
    let recorder = recorder(kept.clone(), &NodeTable::new(Arc::clone(&table), NodeId(0)));
    let (tell, told) = channel();
    let ask = move |ctx: &mut Context| {
        for _ in 0..times {
            let _outcome = ctx.send(cells::ASK, &cells::FULL)?;
        }
        tell.send(()).expect("the harness listens");
        Ok(())
    };
    let node = Runtime::builder(Arc::clone(&table), NodeId(0))
        .incarnation(INCARNATION.0, INCARNATION.1)
        .recorder(Arc::clone(&recorder) as _)
        .task("t0", ask)
        .task("t1", cells::answer)
        .start()
        .expect("a node that starts");
    cells::hear(node, &told);
    let status = recorder.stop(PATIENCE).expect("stopped once");
    assert!(status.ended && status.lost == 0, "{status:?}");
    let bytes = std::mem::take(&mut *kept.0.lock().expect("nobody panics here"));
    (table, bytes)
}

fn replay(effort: Effort) -> Sample {
    // All of these steps fit into the buffer before the sink, so none is lost even if the writing thread runs late.
    let (table, bytes) = recorded(3_500);
    let table = NodeTable::new(table, NodeId(0));
    let (times, mut events) = (effort.of(20), 0);
    let begins = Instant::now();
    for _ in 0..times {
        let mut reader = RecordingReader::new(&bytes[..]).expect("a recording");
        let replays = replay_recording(&mut reader, &table).expect("whole");
        assert!(replays.iter().all(|replay| replay.verdict() == Verdict::Same));
        events += replays.iter().map(Replay::judged).sum::<usize>();
    }
    Sample::of_all(begins.elapsed(), events as u64)
        .with(bytes.len() as f64 * f64::from(times) / events as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many steps the recording of two scripts has that make this many round trips.
    fn steps(trips: u32) -> usize {
        let table = cells::asking(1, Usage::Send);
        let (kept, of_node) = (Kept::default(), NodeTable::new(Arc::clone(&table), NodeId(0)));
        let recorder = recorder(kept.clone(), &of_node);
        let node = Runtime::builder(table, NodeId(0))
            .incarnation(INCARNATION.0, INCARNATION.1)
            .recorder(Arc::clone(&recorder) as _)
            .script("t0", cells::asker(trips))
            .script("t1", cells::answerer())
            .hold_scripts()
            .start()
            .expect("a node that starts");
        node.begin();
        cells::stop(node);
        assert!(recorder.stop(PATIENCE).expect("stopped once").ended);
        let bytes = std::mem::take(&mut *kept.0.lock().expect("nobody panics here"));
        let mut reader = RecordingReader::new(&bytes[..]).expect("a recording");
        let replays = replay_recording(&mut reader, &of_node).expect("whole");
        replays.iter().map(Replay::judged).sum()
    }

    /// How many events are observed of two scripts that make this many round trips.
    fn events(trips: u32) -> usize {
        let node = Runtime::builder(cells::asking(1, Usage::Send), NodeId(0))
            .script("t0", cells::asker(trips))
            .script("t1", cells::answerer())
            .hold_scripts()
            .start()
            .expect("a node that starts");
        let mut observations = node.node().observe();
        node.begin();
        let mut events = Vec::new();
        assert_eq!(observations.drain(usize::MAX, &mut events), 0, "events were lost");
        cells::stop(node);
        events.len()
    }

    #[test]
    fn what_observing_costs_is_shared_by_the_events_that_are_observed() {
        assert_eq!(events(30) - events(20), 10 * EVENTS as usize);
    }

    #[test]
    fn what_recording_costs_is_shared_by_the_steps_that_are_recorded() {
        assert_eq!(steps(30) - steps(20), 10 * STEPS as usize);
    }
}
