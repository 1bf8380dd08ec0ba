//! Helpers of the tests of recordings: a header, and a reader of all records.

use imrs_protocol::{Incarnation, NodeId};
use imrs_wire::recording::{Cause, Ending, Header, Record, RecordingReader};

pub fn header() -> Header {
    Header {
        cell: "beam".into(),
        digest: 0xdead_beef,
        statements: 0x0bad_cafe,
        node: Some(NodeId(2)),
        incarnation: Incarnation(7),
        restarted: true,
        build: "0.1.0".into(),
        insecure: true,
        began: 1_700_000_000_000_000,
    }
}

/// All readable records, and the ending or the error after them.
pub fn read(bytes: &[u8]) -> (Vec<Record>, Result<Ending, (u64, Cause)>) {
    let mut reader = RecordingReader::new(bytes).unwrap();
    let mut records = Vec::new();
    loop {
        match reader.next_record() {
            Ok(Some(record)) => records.push(record),
            Ok(None) => return (records, Ok(reader.ending())),
            Err(error) => return (records, Err((error.offset, error.cause))),
        }
    }
}
