//! Reads from the recordings of a run what happened to its messages, without the model. Each recording is replayed
//! through its node's own state machines, and the times of all nodes are compared on the one clock of this machine.

use imrs_launch::cells::{self, Loaded};
use imrs_launch::checks::ReplaySampler;
use imrs_protocol::script::ScriptInput;
use imrs_protocol::{Call, Class, Delivery, Kind, MessageId, NodeTable, Outcome, Signal, TaskId};
use imrs_runtime::record::{Happened, Happening, RecordingReader, Replay, Turn, replay_scripts};
use imrs_runtime::script::Watch;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A message: its sender, and its id.
type Key = (TaskId, u8, u32);

/// What the recordings show about messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Messages {
    /// Commands that left their sender.
    pub commands: u64,
    /// Commands that their receiver began to carry out.
    pub executed: u64,
    /// Commands that were carried out more than once.
    pub twice: u64,
    /// Statuses that were delivered.
    pub delivered: u64,
    /// Statuses that were delivered more than once.
    pub delivered_twice: u64,
    /// Messages of either class that were delivered after their sender's time_out.
    pub stale: u64,
    /// Commands whose sender learned the outcome more than a tick after the time_out.
    pub overdue: u64,
    /// The longest time from the end of a time_out to the outcome, in microseconds.
    pub overdue_us: u64,
}

/// For each message, when it was first sent, the end of its time_out, and its class; in microseconds of the machine's
/// clock. There may be several entries for one id, because a task that has lost its state may use the id again.
type Sent = BTreeMap<Key, BTreeMap<u64, (u64, Class)>>;

/// The facts that the recordings show.
pub struct Evidence {
    pub messages: Messages,
    /// When tasks learned the outcomes of their commands, in microseconds of the machine's clock and in ascending
    /// order, and whether each outcome was an answer.
    outcomes: Vec<(u64, bool)>,
}

/// Reads recordings. A recording with a gap is left out, because a part of it is unknown.
pub fn evidence(cell: &Path, files: &[PathBuf]) -> Evidence {
    let (_, loaded) = cells::open(cell, false).expect("a cell");
    let tasks: Vec<Vec<Happening>> = files.iter().flat_map(|file| happenings(&loaded, file)).collect();
    let mut sent = Sent::new();
    for happening in tasks.iter().flatten() {
        if let Happened::Sent(packet) = &happening.what
            && matches!(packet.kind, Kind::Send | Kind::Query)
            && !packet.resent
        {
            let first = (happening.at + packet.remaining.0, packet.class);
            sent.entry(key(packet.source, packet.id)).or_default().insert(happening.at, first);
        }
    }
    let is_command = |(_, class): &&(u64, Class)| *class == Class::Command;
    let commands = sent.values().flat_map(BTreeMap::values).filter(is_command).count() as u64;
    let mut found = Messages { commands, ..Messages::default() };
    let mut taken = BTreeSet::new();
    for happening in tasks.iter().flatten() {
        if let Some(delivery) = delivery(&happening.what) {
            found.take(&sent, &mut taken, delivery, happening.at);
        }
    }
    let tick = loaded.table.cell().tick.0;
    let mut outcomes: Vec<_> = tasks.iter().flat_map(|task| found.outcomes(task, tick)).collect();
    outcomes.sort_unstable();
    Evidence { messages: found, outcomes }
}

impl Evidence {
    /// How long after this instant a task first learned that a command was answered, or (without `is_answer`) not
    /// answered; in microseconds.
    pub fn first(&self, is_answer: bool, since: u64) -> Option<u64> {
        let is_so = |(at, answered): &&(u64, bool)| *at >= since && *answered == is_answer;
        self.outcomes.iter().find(is_so).map(|(at, _)| at - since)
    }
}

impl Messages {
    /// Counts a delivery at this instant. `taken` has all messages that were delivered earlier.
    fn take(&mut self, sent: &Sent, taken: &mut BTreeSet<(Key, u64)>, delivery: &Delivery, at: u64) {
        let key = key(delivery.from.source, delivery.from.id);
        // The recording of the sender may be missing, or cut off.
        let first = sent.get(&key).and_then(|all| all.range(..=at).next_back());
        let again = u64::from(!taken.insert((key, first.map_or(0, |(sent_at, _)| *sent_at))));
        match delivery.class {
            Class::Command => (self.executed, self.twice) = (self.executed + 1, self.twice + again),
            Class::Status => {
                (self.delivered, self.delivered_twice) = (self.delivered + 1, self.delivered_twice + again);
            }
        }
        self.stale += u64::from(first.is_some_and(|(_, (end, _))| at > *end));
    }

    /// Returns when a task learned the outcomes of its commands, in order, and whether each outcome was an answer.
    fn outcomes(&mut self, task: &[Happening], tick: u64) -> Vec<(u64, bool)> {
        let (mut end, mut outcomes) = (None, Vec::new());
        for happening in task {
            match &happening.what {
                Happened::Sent(packet)
                    if matches!(packet.kind, Kind::Send | Kind::Query)
                        && packet.class == Class::Command
                        && !packet.resent =>
                {
                    end.get_or_insert(happening.at + packet.remaining.0);
                }
                Happened::Turn(Turn { input: ScriptInput::Signal(Signal::Outcome(outcome)), .. }) => {
                    outcomes.push((happening.at, matches!(outcome, Outcome::Reply(_))));
                    let after = end.take().map_or(0, |end: u64| happening.at.saturating_sub(end));
                    self.overdue += u64::from(after > tick);
                    self.overdue_us = self.overdue_us.max(after);
                }
                _ => {}
            }
        }
        outcomes
    }
}

fn key(source: TaskId, id: MessageId) -> Key {
    (source, id.incarnation.0, id.sequence.get())
}

fn delivery(what: &Happened) -> Option<&Delivery> {
    let Happened::Turn(turn) = what else { return None };
    match &turn.input {
        ScriptInput::Signal(Signal::Message(delivery) | Signal::Interrupt(Call::Message(delivery))) => {
            Some(delivery)
        }
        _ => None,
    }
}

/// The events of each task of a node, according to the node's recording.
fn happenings(loaded: &Loaded, file: &Path) -> Vec<Vec<Happening>> {
    let opened = File::open(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let mut reader = RecordingReader::new(BufReader::new(opened)).expect("a recording");
    let node = reader.header().node.expect("of a node");
    let table = NodeTable::new(Arc::clone(&loaded.table), node);
    // The replays keep the events only if something watches them.
    let watch: Arc<dyn Watch> = Arc::new(ReplaySampler::new(loaded));
    let replays = replay_scripts(&mut reader, &table, |task| loaded.program(task), Some(&watch));
    let replays = replays.unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    replays.into_iter().filter_map(Replay::happened).collect()
}
