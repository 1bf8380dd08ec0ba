//! Tests of the file format of recordings: golden bytes, files cut off anywhere, and damage.

use super::rig::{header, read};
use imrs_protocol::{
    Contents, Incarnation, Input, MessageId, NodeId, PortId, Request, Seq24, Target, TaskId, Ticks, TimeId,
};
use imrs_wire::recording::{
    Cause, Ending, Record, RecordingReader, RecordingWriter, ScriptStep, Stream, WriteError,
};
use proptest::prelude::*;
use std::io::{self, Cursor, Read};
use std::sync::{Arc, Mutex};

fn records() -> Vec<Record> {
    let (task, frames) = (TaskId(3), Stream::Frames(1));
    let send = Request::Send {
        port: PortId(5),
        to: Target::One(TaskId(4)),
        contents: Contents::new(b"go").unwrap(),
        time_out: Some(Ticks(2_000)),
    };
    let id = MessageId { incarnation: Incarnation(7), sequence: Seq24::new(300) };
    let input = |elapsed, input| Record::Input {
        task,
        elapsed: Ticks(elapsed),
        input,
        outputs: 0x0102_0304_0506_0708,
    };
    let script = |step| Record::Script { task, step, done: 0x1112_1314_1516_1718 };
    vec![
        input(1_000, Input::Request(send)),
        input(0, Input::Time),
        input(20, Input::TimeOut { id: TimeId(9), turn: 3 }),
        input(1, Input::Unsent(id)),
        input(1, Input::PeerRestarted(NodeId(1))),
        input(1, Input::PeerStopped(NodeId(1))),
        script(ScriptStep::Begin { at: 86_400_000_000 }),
        script(ScriptStep::Acted { level: 1, ok: true, value: -7 }),
        script(ScriptStep::Chosen(2)),
        script(ScriptStep::Stopped),
        Record::Gap { stream: Stream::Task(task), lost: 12 },
        Record::Keyframe { task, state: vec![1, 2, 3], outputs: 5 },
        Record::Gap { stream: frames, lost: 1 },
        Record::Frame { source: 1, at: 1_000_000, bytes: b"frame".to_vec() },
        Record::Close { task, inputs: 5, outputs: 0x0102_0304_0506_0708 },
    ]
}

fn written(records: &[Record]) -> Vec<u8> {
    let mut writer = RecordingWriter::new(Vec::new(), &header()).unwrap();
    for record in records {
        writer.append(record).unwrap();
    }
    writer.finish().unwrap()
}

/// The offset of each record, starting with the header, and the offset of the end.
fn boundaries(records: &[Record]) -> Vec<u64> {
    let mut writer = RecordingWriter::new(Vec::new(), &header()).unwrap();
    let mut at = vec![12, writer.written()];
    for record in records.iter().chain([&Record::End]) {
        writer.append(record).unwrap();
        at.push(writer.written());
    }
    at
}

fn hex(bytes: &[u8]) -> String {
    let lines =
        bytes.chunks(32).map(|line| line.iter().map(|b| format!("{b:02x}")).collect::<String>() + "\n");
    lines.collect()
}

/// The bytes of a version never change. `IMRS_WRITE_GOLDEN=1` writes the bytes of a new version.
#[test]
fn version_12_is_these_bytes() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recording_golden/12.hex");
    if std::env::var_os("IMRS_WRITE_GOLDEN").is_some() {
        std::fs::write(&path, hex(&written(&records()))).unwrap();
    }
    assert_eq!(hex(&written(&records())), std::fs::read_to_string(path).unwrap());
}

/// This list says why recordings of each older version cannot be replayed today. Versions 1 and 2: their machines had no
/// handlers, and announced no epoch before they acted in it. Version 3: no checksum of the lengths, and no script inputs.
/// Version 4: no digest of the statements, and no number of inputs. Version 5: other digests. Version 6: keyframes with equal
/// space for every port. Version 7: no arrivals for a finished meeting. Version 8: one state machine per task (D167). Version
/// 9: a time input carries its length (D168). Version 10: a packet has a mark that no program set.
#[test]
fn older_versions_are_refused_by_their_numbers() {
    let kept = [
        include_str!("../recording_golden/1.hex"),
        include_str!("../recording_golden/2.hex"),
        include_str!("../recording_golden/3.hex"),
        include_str!("../recording_golden/4.hex"),
        include_str!("../recording_golden/5.hex"),
        include_str!("../recording_golden/6.hex"),
        include_str!("../recording_golden/7.hex"),
        include_str!("../recording_golden/8.hex"),
        include_str!("../recording_golden/9.hex"),
        include_str!("../recording_golden/10.hex"),
        include_str!("../recording_golden/11.hex"),
    ];
    for (version, text) in (1..).zip(kept) {
        let digits: Vec<u8> = text.bytes().filter(u8::is_ascii_hexdigit).collect();
        let digit = |d: u8| u8::try_from(char::from(d).to_digit(16).unwrap()).unwrap();
        let bytes: Vec<u8> = digits.chunks(2).map(|d| digit(d[0]) << 4 | digit(d[1])).collect();
        let refusal = RecordingReader::new(bytes.as_slice()).unwrap_err().to_string();
        assert_eq!(refusal, format!("at byte 0: a recording of version {version}, this program reads 12"));
    }
}

#[test]
fn reading_undoes_writing() {
    let bytes = written(&records());
    let mut expected = records();
    expected.push(Record::End);
    let (got, ending) = read(&bytes);
    assert_eq!(got, expected);
    assert_eq!(ending.unwrap(), Ending::Ended);
    let mut reader = RecordingReader::new(bytes.as_slice()).unwrap();
    assert_eq!(*reader.header(), header());
    assert_eq!(reader.by_ref().map(Result::unwrap).count(), expected.len());
    assert_eq!(reader.offset(), bytes.len() as u64);
}

#[test]
fn a_file_cut_off_anywhere_reads_up_to_its_last_whole_record() {
    let bytes = written(&records());
    let at = boundaries(&records());
    for length in 0..bytes.len() {
        let cut = &bytes[..length];
        if (length as u64) < at[1] {
            let error = RecordingReader::new(cut).unwrap_err();
            let expected = if length < 12 {
                "at byte 0: not a recording"
            } else {
                "at byte 12: the recording has no header"
            };
            assert_eq!(error.to_string(), expected, "cut off at {length}");
            continue;
        }
        let whole = at.iter().filter(|&&end| end <= length as u64).count() - 2;
        let (got, ending) = read(cut);
        assert_eq!(got, records()[..whole], "cut off at {length}");
        let last = at[whole + 1];
        let expected = if last == length as u64 { Ending::Open } else { Ending::Torn { offset: last } };
        assert_eq!(ending.unwrap(), expected, "cut off at {length}");
    }
}

#[test]
fn zeros_that_a_file_system_left_behind_are_no_damage() {
    let bytes = written(&records());
    let at = boundaries(&records());
    let whole = usize::try_from(at[4]).unwrap();
    for zeros in [1, 8, 4_096, 200_000] {
        let (got, ending) = read(&[&bytes[..whole], vec![0; zeros].as_slice()].concat());
        assert_eq!((got.len(), ending.unwrap()), (3, Ending::Torn { offset: at[4] }));
    }
    let (_, ending) = read(&[&bytes[..whole], &[0; 100], &[1]].concat());
    assert!(matches!(ending, Err((offset, Cause::Checksum)) if offset == at[4]));
}

#[test]
fn damage_is_named_with_its_place() {
    let bytes = written(&records());
    let at = boundaries(&records());
    for bit in 12 * 8..bytes.len() * 8 {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        let record = at.iter().filter(|&&begin| begin <= (bit / 8) as u64).count() - 1;
        if record == 0 {
            assert!(RecordingReader::new(damaged.as_slice()).is_err(), "bit {bit}");
            continue;
        }
        let (got, ending) = read(&damaged);
        assert_eq!(got.len(), record - 1, "bit {bit}: all records before the damage");
        match ending {
            Err((offset, Cause::Checksum)) => assert_eq!(offset, at[record], "bit {bit}"),
            other => panic!("bit {bit}: {other:?}"),
        }
    }
}

#[test]
fn other_files_and_versions_are_refused() {
    let refusal = |bytes: &[u8]| RecordingReader::new(bytes).unwrap_err().to_string();
    assert_eq!(refusal(b"\x7fELF and a lot more"), "at byte 0: not a recording");
    let mut newer = written(&[]);
    newer[8] = 13;
    assert_eq!(refusal(&newer), "at byte 0: a recording of version 13, this program reads 12");
}

#[test]
fn records_out_of_place_are_refused() {
    let again = written(&[Record::Header(header())]);
    assert!(matches!(read(&again), (records, Err((_, Cause::OutOfPlace))) if records.is_empty()));
    let mut after_end = written(&records());
    let end = after_end.len() as u64;
    after_end.push(0);
    assert!(matches!(read(&after_end).1, Err((offset, Cause::OutOfPlace)) if offset == end));
    let too_long = Record::Frame { source: 0, at: 0, bytes: vec![0; 2 << 20] };
    let mut writer = RecordingWriter::new(Vec::new(), &header()).unwrap();
    assert!(matches!(writer.append(&too_long), Err(WriteError::TooLong(_))));
}

/// A file that another thread extends while it is read.
struct Growing(Arc<Mutex<Vec<u8>>>, usize);

impl Read for Growing {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let bytes = self.0.lock().unwrap();
        let read = Cursor::new(&bytes[self.1..]).read(out)?;
        self.1 += read;
        Ok(read)
    }
}

#[test]
fn a_recording_can_be_followed_while_it_grows() {
    let bytes = written(&records());
    let file = Arc::new(Mutex::new(bytes[..160].to_vec()));
    let mut reader = RecordingReader::new(Growing(Arc::clone(&file), 0)).unwrap();
    let mut got: Vec<_> = reader.by_ref().map(Result::unwrap).collect();
    for &byte in &bytes[160..] {
        file.lock().unwrap().push(byte);
        got.extend(reader.by_ref().map(Result::unwrap));
    }
    assert_eq!(got.pop(), Some(Record::End));
    assert_eq!(got, records());
    assert_eq!(reader.ending(), Ending::Ended);
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..400), keep in 0..200_usize) {
        let mut file = written(&records());
        file.truncate(keep);
        file.extend(bytes);
        if let Ok(reader) = RecordingReader::new(file.as_slice()) {
            prop_assert!(reader.take(10_000).count() < 10_000);
        }
    }

    #[test]
    fn contents_behind_a_right_checksum_are_read_or_refused(contents in proptest::collection::vec(any::<u8>(), 0..100)) {
        let mut file = written(&[Record::Frame { source: 0, at: 0, bytes: contents.clone() }]);
        // This file has the same header, and one record of arbitrary contents.
        file.truncate(usize::try_from(boundaries(&[])[1]).unwrap());
        let length = u32::try_from(contents.len()).unwrap().to_le_bytes();
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_MEF);
        file.extend(length);
        file.extend(crc.checksum(&length).to_le_bytes());
        file.extend(crc.checksum(&contents).to_le_bytes());
        file.extend(contents);
        let mut reader = RecordingReader::new(file.as_slice()).unwrap();
        let _ = reader.next_record();
    }
}
