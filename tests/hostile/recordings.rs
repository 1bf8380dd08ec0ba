//! Tests of recordings with correct checksums and hostile contents: tags, lengths, ids, times and states that no
//! program wrote. A command must refuse each such recording with an error, or judge it, and must not panic.
//! `IMRS_HOSTILE_RECORDINGS` sets the number of recordings.

use super::{ended, fault_of};
use crate::support::tape::Tape;
use crate::support::{bound, example, imrs, run_in, runtime_dir};
use imrs_language::{Source, Unit, compile};
use imrs_protocol::{
    CONTENTS_BYTES, CellTable, CommTask, Input, NodeId, NodeTable, Outbox, Packet, Signal, Ticks, TimeId,
};
use imrs_wire::recording::{MAGIC, Record, ScriptStep, Stream, VERSION};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;

/// Genuine recordings of nodes and monitors.
struct Originals {
    cell: String,
    nodes: Vec<(PathBuf, Tape)>,
    /// Recordings of monitors and of the checker.
    seen: Vec<Tape>,
    table: Arc<CellTable>,
}

const NODES: [&str; 3] = ["nl", "nr", "nh"];

impl Originals {
    fn record(folder: &Path) -> Self {
        let at = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
        let cell = example("beam_lift.cell");
        let run =
            ["run", &cell, "--in-process", "--for", "600ms", "--seed", "1", "--record", &at("run.imrs")];
        let monitor = thread::scope(|scope| {
            let seen =
                scope.spawn(|| run_in(folder, &["monitor", "--record", &at("seen.imrs"), "--for", "600ms"]));
            let said = run_in(folder, &run);
            assert!(matches!(said.code, Some(0 | 1 | 5)), "{said:?}");
            seen.join().expect("the monitor ends")
        });
        let faulty = example("faulty/feeder_and_press_wait_for_each_other.cell");
        let found = run_in(folder, &["verify", &faulty, "--save", &at("found.imrs")]);
        assert_eq!(found.code, Some(1), "{found:?}");
        let mut seen = vec![Tape::read(Path::new(&at("found.imrs")))];
        // The monitor may have started after the nodes had ended.
        if monitor.code == Some(0) {
            seen.push(Tape::read(Path::new(&at("seen.imrs"))));
        }
        let text = std::fs::read(&cell).expect("the cell");
        let lowered =
            compile(&Source::new(&text).expect("a text")).lower(Unit::Microseconds).expect("a cell");
        let table = Arc::new(CellTable::new(lowered.cell).expect("a sound cell"));
        let nodes = NODES.map(|node| PathBuf::from(at(&format!("run.{node}.imrs"))));
        let nodes = nodes.map(|path| (path.clone(), Tape::read(&path))).into();
        Self { cell, nodes, seen, table }
    }
}

/// The checksum that recordings use.
fn checksum(bytes: &[u8]) -> u32 {
    static CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_MEF);
    CRC.checksum(bytes)
}

/// A recording with any contents of its records, and correct lengths and checksums.
fn sealed(contents: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = [&MAGIC[..], &VERSION.to_le_bytes(), &[0, 0]].concat();
    for contents in contents {
        let length = u32::try_from(contents.len()).expect("short").to_le_bytes();
        bytes.extend(length);
        bytes.extend(checksum(&length).to_le_bytes());
        bytes.extend(checksum(contents).to_le_bytes());
        bytes.extend(contents);
    }
    bytes
}

/// Numbers at the ends of various ranges.
const EXTREME: [u64; 14] =
    [0, 1, 12, 13, 15, 16, 255, 256, 65_535, (1 << 24) - 1, 1 << 24, u32::MAX as u64, 1 << 63, u64::MAX];

fn extreme(random: &mut fastrand::Rng) -> u64 {
    EXTREME[random.usize(..EXTREME.len())]
}

/// Damages postcard bytes: flips a bit, replaces a byte or a number, removes or repeats some bytes.
fn spoil(bytes: &mut Vec<u8>, random: &mut fastrand::Rng) {
    for _ in 0..random.usize(1..4) {
        let at = random.usize(..bytes.len().max(1));
        let end = (at + random.usize(1..12)).min(bytes.len());
        match random.u8(..7) {
            0 if at < end => bytes[at] ^= 1 << random.u8(..8),
            1 if at < end => bytes[at] = random.u8(..),
            2 if at < end => bytes[at] = [0, 1, 12, 13, 0x7f, 0x80, 0xff][random.usize(..7)],
            3 => {
                let number = postcard::to_allocvec(&extreme(random)).expect("a number");
                bytes.splice(at..(at + 1).min(bytes.len()), number);
            }
            4 => drop(bytes.drain(at.min(end)..end)),
            5 => {
                let again = bytes[at.min(end)..end].to_vec();
                bytes.splice(at..at, again);
            }
            _ => bytes.truncate(at),
        }
    }
}

struct Nowhere;

impl Outbox for Nowhere {
    fn transmit(&mut self, _: Packet) {}
    fn signal(&mut self, _: Signal) {}
    fn arm(&mut self, _: TimeId, _: u8, _: Ticks) {}
    fn disarm(&mut self, _: TimeId) {}
}

/// A damaged recording of a node.
fn spoilt_inputs(of: &Originals, node: usize, random: &mut fastrand::Rng) -> Vec<u8> {
    let Tape { header, records } = &of.nodes[node].1;
    let mut records = records.clone();
    let mut header = header.clone();
    let at = random.usize(..records.len());
    let kind = random.u8(..11);
    match kind {
        0 | 1 => spoil_state(of, node, &header, &mut records, at, random),
        2 => spoil_times(&mut records, at, random),
        3 => spoil_ids(&mut records, random),
        4 => header.build = "\u{1b}]0;x\u{7}\u{9b}2J\n".repeat(random.usize(1..4)),
        _ => {}
    }
    let mut contents = vec![postcard::to_allocvec(&Record::Header(header)).expect("a header")];
    contents.extend(records.iter().map(|record| postcard::to_allocvec(record).expect("a record")));
    match kind {
        5 => spoil(&mut contents[0], random),
        6 => spoil_lengths(&mut contents, &records, random),
        7..11 => {
            for _ in 0..random.usize(1..4) {
                let one = random.usize(1..contents.len());
                spoil(&mut contents[one], random);
            }
        }
        _ => {}
    }
    sealed(&contents)
}

/// Inserts a gap, and after it a state that no machine wrote.
fn spoil_state(
    of: &Originals,
    node: usize,
    header: &imrs_wire::recording::Header,
    records: &mut Vec<Record>,
    at: usize,
    random: &mut fastrand::Rng,
) {
    let table = NodeTable::new(Arc::clone(&of.table), NodeId(u16::try_from(node).expect("a few")));
    let Some(task) = table.tasks_on(table.node).next() else { return };
    let mut machine = CommTask::new(&table, task, header.incarnation, header.restarted);
    let mut digest = 0;
    for record in &records[..at] {
        if let Record::Input { task: whose, elapsed, input, outputs } = record
            && *whose == task
        {
            machine.handle(&table, machine.now() + *elapsed, input, &mut Nowhere);
            digest = *outputs;
        }
    }
    let mut state = postcard::to_allocvec(&machine).expect("a state");
    spoil(&mut state, random);
    let gap = Record::Gap { stream: Stream::Task(task), lost: 1 };
    records.splice(at..at, [gap, Record::Keyframe { task, state, outputs: digest }]);
}

/// Makes packets claim more contents than they may have, or gives them bytes after the end of their contents.
fn spoil_lengths(contents: &mut [Vec<u8>], records: &[Record], random: &mut fastrand::Rng) {
    for (record, bytes) in records.iter().zip(&mut contents[1..]) {
        let Record::Input { input: Input::Packet(_), outputs, .. } = record else { continue };
        let behind = postcard::to_allocvec(outputs).expect("a number").len();
        let length = bytes.len() - behind - CONTENTS_BYTES - 1;
        if random.bool() {
            bytes[length] = [13, 16, 128, 255][random.usize(..4)];
        } else {
            let end = length + CONTENTS_BYTES;
            (bytes[length], bytes[end]) = (random.u8(..13), 1);
        }
    }
}

fn spoil_times(records: &mut [Record], at: usize, random: &mut fastrand::Rng) {
    for record in &mut records[at..] {
        match record {
            Record::Input { elapsed, .. } => *elapsed = Ticks(extreme(random)),
            Record::Script { step: ScriptStep::Begin { at }, .. } => *at = extreme(random),
            _ => continue,
        }
        if random.bool() {
            return;
        }
    }
}

fn spoil_ids(records: &mut [Record], random: &mut fastrand::Rng) {
    #[expect(clippy::cast_possible_truncation, reason = "any number will do")]
    let number = extreme(random) as u16;
    let at = random.usize(..records.len());
    match &mut records[at] {
        Record::Input { task, .. } | Record::Script { task, .. } | Record::Close { task, .. }
            if random.bool() =>
        {
            task.0 = number;
        }
        Record::Input { input: Input::Packet(packet), .. } => match random.u8(..4) {
            0 => packet.source.0 = number,
            1 => packet.destination.0 = number,
            2 => packet.port.0 = number,
            _ => packet.remaining = Ticks(extreme(random)),
        },
        Record::Script { step, .. } => {
            *step = match random.u8(..3) {
                0 => ScriptStep::Acted { level: number.to_le_bytes()[0], ok: true, value: i32::MIN },
                1 => ScriptStep::Chosen(number),
                _ => ScriptStep::Stopped,
            }
        }
        Record::Close { inputs, .. } => *inputs = extreme(random),
        _ => {}
    }
}

/// A damaged recording of a monitor.
fn spoilt_frames(of: &Tape, random: &mut fastrand::Rng) -> Vec<u8> {
    let Tape { header, mut records } = of.clone();
    let (many, inner) = (random.usize(1..6), random.u8(..4));
    for _ in 0..many {
        let at = random.usize(..records.len());
        match &mut records[at] {
            Record::Frame { at, .. } if inner == 0 => *at = extreme(random),
            Record::Frame { source, .. } if inner == 1 => *source ^= 1,
            Record::Frame { bytes, .. } if bytes.len() > 2 => spoil(bytes, random),
            _ => {}
        }
    }
    let mut contents = vec![postcard::to_allocvec(&Record::Header(header)).expect("a header")];
    contents.extend(records.iter().map(|record| postcard::to_allocvec(record).expect("a record")));
    sealed(&contents)
}

/// The commands that read a damaged recording of a node: its replay, and the judgement of the whole run.
fn judged(of: &Originals, node: usize, spoilt: &str) -> Vec<Vec<String>> {
    let own = |args: &[&str]| args.iter().map(|&arg| arg.to_owned()).collect::<Vec<String>>();
    let mut files: Vec<&str> = of.nodes.iter().map(|(path, _)| path.to_str().expect("UTF-8")).collect();
    files[node] = spoilt;
    let model = ["--cell", &of.cell, "--model", "--within", "300ms"];
    vec![own(&["replay", spoilt, "--cell", &of.cell]), own(&[&["replay"], &files[..], &model[..]].concat())]
}

/// The commands that show a monitor's recording, with the options that `number` selects.
fn shown(number: u64, spoilt: &str) -> Vec<Vec<String>> {
    let own = |args: &[&str]| args.iter().map(|&arg| arg.to_owned()).collect::<Vec<String>>();
    let form = ["jsonl", "svg", "asciicast", "mcap"][usize::try_from(number % 4).expect("small")];
    let how = [&["--once"][..], &["--text", "--speed", "1000"], &["--once", "--format", "json"]];
    let how = how[usize::try_from(number % 3).expect("small")];
    let mut monitor = own(&["monitor", "--replay", spoilt]);
    monitor.extend(own(how));
    vec![monitor, own(&["export", spoilt, "--to", form, "--out", "-"])]
}

#[test]
fn recordings_with_right_checksums_and_hostile_contents_are_refused_or_judged() {
    let folder = runtime_dir();
    let originals = Originals::record(folder.path());
    let (first, number) = (bound("IMRS_SEED", 1), bound("IMRS_HOSTILE_RECORDINGS", 48));
    let mut codes = std::collections::BTreeMap::new();
    let mut faults = Vec::new();
    for seed in first..first + number {
        let mut random = fastrand::Rng::with_seed(seed);
        let path = folder.path().join("spoilt.imrs");
        let name = path.to_str().expect("UTF-8");
        let (bytes, commands) = if seed % 3 == 0 {
            let of = &originals.seen[random.usize(..originals.seen.len())];
            (spoilt_frames(of, &mut random), shown(seed / 3, name))
        } else {
            let node = random.usize(..NODES.len());
            (spoilt_inputs(&originals, node, &mut random), judged(&originals, node, name))
        };
        std::fs::write(&path, bytes).expect("written");
        for command in commands {
            let args: Vec<&str> = command.iter().map(String::as_str).collect();
            let said = ended(imrs(folder.path(), &args));
            *codes.entry((command[0].clone(), said.code)).or_insert(0) += 1;
            let raw = said.err.chars().any(|c| c.is_control() && c != '\n' && c != '\t');
            let fault = fault_of(&said).or_else(|| raw.then(|| "it lets a control character through".into()));
            faults.extend(fault.map(|fault| format!("seed {seed}: {fault}: {args:?}: {:?}", said.err)));
        }
    }
    println!("{number} recordings: {codes:?}");
    assert!(faults.is_empty(), "{} faults:\n{}", faults.len(), faults.join("\n"));
}
