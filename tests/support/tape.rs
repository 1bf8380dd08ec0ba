//! The recording of a node, in memory.

use imrs_wire::recording::{Header, Record, RecordingReader, RecordingWriter};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// The recording of a node.
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

/// Writes the recording `from` as `to`, changed.
pub fn change(from: &Path, to: &Path, change: impl FnOnce(&mut Vec<Record>)) {
    let mut tape = Tape::read(from);
    change(&mut tape.records);
    tape.write(to);
}
