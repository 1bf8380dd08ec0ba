//! Reads whole recordings of nodes and of monitors into memory.

use imrs_wire::obs::ServerFrame;
use imrs_wire::recording::{Header, Record, RecordingReader, RecordingWriter, Shown};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// A whole recording in memory.
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

/// Whether a recording already contains a record of a script. The recording may still be written.
pub fn has_begun(path: &Path) -> bool {
    let reader = File::open(path).ok().and_then(|file| RecordingReader::new(BufReader::new(file)).ok());
    let mut records = reader.into_iter().flatten().map_while(Result::ok);
    records.any(|record| matches!(record, Record::Script { .. }))
}

/// The nodes' frames in a monitor's recording, which may still be written. Each has its source, its time in
/// microseconds, and its contents.
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

/// Copies the recording `from` to `to`, and applies `change` to the records of the copy.
pub fn change(from: &Path, to: &Path, change: impl FnOnce(&mut Vec<Record>)) {
    let mut tape = Tape::read(from);
    change(&mut tape.records);
    tape.write(to);
}
