//! Recordings of nodes and of monitors, in memory.

use imrs_wire::obs::ServerFrame;
use imrs_wire::recording::{Header, Record, RecordingReader, RecordingWriter, Shown};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// A recording in memory.
#[derive(Clone)]
pub struct Tape {
    pub header: Header,
    pub records: Vec<Record>,
}

impl Tape {
    pub fn read(path: &Path) -> Self {
        let file = File::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut reader = RecordingReader::new(BufReader::new(file)).expect("a recording");
        let header = reader.header().clone();
        Self { header, records: reader.by_ref().map(|record| record.expect("a record")).collect() }
    }

    pub fn write(&self, path: &Path) {
        let sink = File::create(path).expect("a file");
        let mut writer = RecordingWriter::new(sink, &self.header).expect("begun");
        self.records.iter().for_each(|record| writer.append(record).expect("written"));
        writer.flush().expect("written");
    }
}

/// Whether a recording, which may still grow, has a record of a script.
pub fn has_begun(path: &Path) -> bool {
    let reader = File::open(path).ok().and_then(|file| RecordingReader::new(BufReader::new(file)).ok());
    let mut records = reader.into_iter().flatten().map_while(Result::ok);
    records.any(|record| matches!(record, Record::Script { .. }))
}

/// The frames of nodes in a monitor's recording, which may still grow: the source, the time in microseconds, and the frame.
pub fn frames(path: &Path) -> Vec<(u16, u64, ServerFrame)> {
    let reader = File::open(path).ok().and_then(|file| RecordingReader::new(BufReader::new(file)).ok());
    let records = reader.into_iter().flatten().map_while(Result::ok);
    let said = |record| match record {
        Record::Frame { source, at, bytes } => match Shown::decode(&bytes) {
            Ok(Shown::Said(frame)) => Some((source, at, frame)),
            _ => None,
        },
        _ => None,
    };
    records.filter_map(said).collect()
}

/// Copies the recording `from` to `to`, with a change.
pub fn change(from: &Path, to: &Path, change: impl FnOnce(&mut Vec<Record>)) {
    let mut tape = Tape::read(from);
    change(&mut tape.records);
    tape.write(to);
}
