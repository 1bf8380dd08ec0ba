//! Makes random changes to recordings.

use imrs_protocol::{Contents, Input, Packet, Request, Seq24, Ticks};
use imrs_wire::recording::{Record, ScriptStep};

/// The kind of a change to the records.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Change {
    /// An input is missing.
    Dropped,
    /// An input is recorded twice.
    Doubled,
    /// Two inputs of a task have swapped places.
    Swapped,
    /// An input has another time.
    Time,
    /// A packet or a request has other contents.
    Input,
    /// Another digest of the outputs is recorded.
    Outputs,
    /// A script has another input.
    Script,
}

impl Change {
    pub const ALL: [Self; 7] =
        [Self::Dropped, Self::Doubled, Self::Swapped, Self::Time, Self::Input, Self::Outputs, Self::Script];
}

/// Returns the records with one random change, or `None` if the draw changes nothing.
pub fn change_records(records: &[Record], random: &mut fastrand::Rng) -> Option<(Change, Vec<Record>)> {
    let change = Change::ALL[random.usize(..Change::ALL.len())];
    let wanted = |record: &Record| match (change, record) {
        (Change::Script, record) => matches!(record, Record::Script { .. }),
        (Change::Dropped | Change::Outputs, Record::Script { .. }) => true,
        (_, record) => matches!(record, Record::Input { .. }),
    };
    let places: Vec<usize> = (0..records.len()).filter(|&at| wanted(&records[at])).collect();
    let at = *places.get(random.usize(..places.len().max(1)))?;
    let mut changed = records.to_vec();
    match change {
        Change::Dropped => {
            changed.remove(at);
        }
        Change::Doubled => changed.insert(at, records[at].clone()),
        Change::Swapped => {
            let other =
                (at + 1..records.len()).find(|&other| task_of(&records[other]) == task_of(&records[at]))?;
            // The last record of a task is no input, so it keeps its position.
            if !matches!(records[other], Record::Input { .. }) {
                return None;
            }
            changed.swap(at, other);
        }
        Change::Time | Change::Input | Change::Outputs | Change::Script => {
            alter(&mut changed[at], change, random);
        }
    }
    (changed != records).then_some((change, changed))
}

fn task_of(record: &Record) -> Option<imrs_protocol::TaskId> {
    match record {
        Record::Input { task, .. }
        | Record::Keyframe { task, .. }
        | Record::Script { task, .. }
        | Record::Close { task, .. } => Some(*task),
        Record::Header(_) | Record::Gap { .. } | Record::Frame { .. } | Record::End => None,
    }
}

fn alter(record: &mut Record, change: Change, random: &mut fastrand::Rng) {
    match record {
        Record::Input { elapsed, .. } if change == Change::Time => {
            *elapsed = match random.u8(..4) {
                0 => Ticks(random.u64(..100_000_000)),
                1 => Ticks::ZERO,
                2 => Ticks(elapsed.0 + random.u64(1..5_000)),
                _ => Ticks(elapsed.0.saturating_sub(random.u64(1..5_000))),
            };
        }
        Record::Input { outputs, .. } if change == Change::Outputs => *outputs ^= 1 << random.u8(..64),
        Record::Input { input, .. } => alter_input(input, random),
        Record::Script { done, .. } if change == Change::Outputs => *done ^= 1 << random.u8(..64),
        Record::Script { step, .. } => alter_step(step, random),
        Record::Header(_)
        | Record::Keyframe { .. }
        | Record::Gap { .. }
        | Record::Frame { .. }
        | Record::Close { .. }
        | Record::End => {}
    }
}

fn alter_input(input: &mut Input, random: &mut fastrand::Rng) {
    match input {
        Input::Time => {
            *input = Input::TimeOut { id: imrs_protocol::TimeId(random.u8(..4)), turn: random.u8(..2) }
        }
        Input::Packet(packet) => alter_packet(packet, random),
        Input::Request(request) => alter_request(request, random),
        Input::TimeOut { id, turn } if random.bool() => (id.0, *turn) = (id.0 ^ 1, *turn),
        Input::TimeOut { turn, .. } => *turn = turn.wrapping_add(random.u8(1..)),
        Input::Unsent(id) => id.sequence = Seq24::new(id.sequence.get() ^ 1),
        Input::PeerRestarted(node) | Input::PeerStopped(node) => node.0 ^= 1,
    }
}

fn alter_packet(packet: &mut Packet, random: &mut fastrand::Rng) {
    match random.u8(..6) {
        0 => packet.contents = other(packet.contents.as_bytes(), random),
        1 => packet.remaining = Ticks(packet.remaining.0 ^ 1 << random.u8(..24)),
        2 => packet.id.sequence = Seq24::new(packet.id.sequence.get() ^ 1 << random.u8(..12)),
        3 => packet.source.0 ^= 1,
        4 => packet.port.0 ^= 1 << random.u8(..2),
        _ => packet.resent = !packet.resent,
    }
}

fn alter_request(request: &mut Request, random: &mut fastrand::Rng) {
    match request {
        Request::Send { contents, .. } | Request::Reply { contents, .. } if random.bool() => {
            *contents = other(contents.as_bytes(), random);
        }
        Request::Arrive { arguments, .. } => arguments[random.usize(..8)] ^= 1 << random.u8(..8),
        Request::Get { time_out, .. } | Request::Send { time_out, .. } => {
            *time_out = Some(Ticks(random.u64(..50_000)));
        }
        Request::Delay { length, .. } => length.0 ^= 1 << random.u8(..16),
        other => *other = Request::Cancel,
    }
}

/// Draws other contents of the same length; for empty contents, one byte.
fn other(bytes: &[u8], random: &mut fastrand::Rng) -> Contents {
    let mut bytes = if bytes.is_empty() { vec![0] } else { bytes.to_vec() };
    let at = random.usize(..bytes.len());
    bytes[at] ^= 1 << random.u8(..8);
    Contents::new(&bytes).expect("no longer than before")
}

fn alter_step(step: &mut ScriptStep, random: &mut fastrand::Rng) {
    match step {
        ScriptStep::Begin { at } => *at ^= 1 << random.u8(..40),
        ScriptStep::Acted { value, .. } if random.bool() => *value ^= 1 << random.u8(..31),
        ScriptStep::Acted { ok, .. } => *ok = !*ok,
        ScriptStep::Chosen(choice) => *choice ^= 1,
        ScriptStep::Stopped => *step = ScriptStep::Begin { at: 0 },
    }
}

/// Returns the bytes of a file with one random change.
pub fn change_bytes(bytes: &[u8], random: &mut fastrand::Rng) -> (&'static str, Vec<u8>) {
    let mut changed = bytes.to_vec();
    let at = random.usize(..bytes.len());
    let end = (at + random.usize(1..64)).min(bytes.len());
    let kind = match random.u8(..7) {
        0 | 1 => {
            changed[at] ^= 1 << random.u8(..8);
            "a bit"
        }
        2 => {
            changed[at] = random.u8(..);
            "a byte"
        }
        3 => {
            changed[at..end].iter_mut().for_each(|byte| *byte = random.u8(..));
            "a burst"
        }
        4 => {
            changed.drain(at..end);
            "bytes missing"
        }
        5 => {
            changed.splice(at..at, bytes[at..end].iter().copied());
            "bytes twice"
        }
        _ => {
            changed.truncate(at);
            "cut off"
        }
    };
    (kind, changed)
}
