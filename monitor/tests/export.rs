//! Tests of exports: other tools find in them what the recording contains.

use crate::common::{BEAT, LIFT, events, identity, observed, snapshot, table, text};
use imrs_monitor::app::{App, Msg};
use imrs_monitor::export::{ExportError, Form, Wanted, export};
use imrs_monitor::replay::{Film, Player};
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, Observation, Reason};
use imrs_wire::obs::{Events, Hello, Role, SCHEMA, ServerFrame, TimedEvent, VERSION};
use imrs_wire::recording::{Header, Record, RecordingWriter, Shown};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use serde_json::Value;
use std::io::Cursor;
use std::sync::Arc;
use std::time::Duration;

fn at_node(node: u16, mono_us: u64, what: Observation) -> Shown {
    let event = TimedEvent { mono_us, task: Some(imrs_protocol::TaskId(node)), what };
    Shown::Said(ServerFrame::Events(Events { lost: 0, events: vec![event] }))
}

/// The left arm sends a message of the port `beat`, and the right arm takes it. Another such message expires, and the
/// hoist dies.
fn film() -> Arc<Film> {
    let header = Header { cell: "beam-lift".into(), ..Header::default() };
    let mut writer = RecordingWriter::new(Vec::new(), &header).unwrap();
    let mut put = |source: u16, at: u64, shown: &Shown| {
        writer.append(&Record::Frame { source, at, bytes: shown.encode() }).unwrap();
    };
    for node in 0..3_u16 {
        let role = Role::Node(identity(node.into(), 1));
        let hello = Hello { schema: SCHEMA, pid: 7, build: "imrs 1".into(), mono_us: 0, role };
        put(node, 0, &Shown::Attached { version: VERSION, hello });
        put(node, 0, &Shown::Said(ServerFrame::Table(table())));
        put(node, 0, &Shown::Said(ServerFrame::Snapshot(snapshot(node.into()))));
    }
    put(0, 100_000, &at_node(0, 5_100_000, observed(Event::Sent, BEAT, 1, 77)));
    put(1, 110_000, &at_node(1, 5_110_000, observed(Event::Delivered, BEAT, 0, 77)));
    put(1, 300_000, &at_node(1, 5_300_000, observed(Event::Discarded(Reason::Expired), BEAT, 0, 78)));
    put(0, 400_000, &Shown::Said(ServerFrame::Events(events(0, &[observed(Event::GaveUp, LIFT, 0, 12)]))));
    put(2, 900_000, &Shown::Lost { why: "the connection was closed".into() });
    let bytes = writer.finish().unwrap();
    Arc::new(Film::read(bytes.as_slice()).unwrap())
}

fn exported(wanted: &Wanted) -> (Vec<u8>, usize) {
    let mut out = Cursor::new(Vec::new());
    let done = export(&film(), wanted, &mut out).unwrap();
    (out.into_inner(), done.count)
}

#[test]
fn lines_of_json_have_states_events_and_ends() {
    let (bytes, count) = exported(&Wanted::new(Form::Jsonl));
    let lines: Vec<Value> = std::str::from_utf8(&bytes)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(lines.len(), count);
    let of = |what: &str| lines.iter().filter(|line| line["what"] == what).collect::<Vec<_>>();
    assert_eq!((of("attached").len(), of("state").len(), of("event").len(), of("lost").len()), (3, 3, 4, 1));
    assert_eq!(of("state")[1]["state"]["name"], "nr");
    let expired = of("event").into_iter().find(|line| line["reason"] == "expired").unwrap();
    assert_eq!(
        (&expired["task"], &expired["port"], &expired["peer"]),
        (&"armR".into(), &"beat".into(), &"armL".into())
    );
    assert_eq!((expired["at_us"].as_u64(), expired["number"].as_u64()), (Some(300_000), Some(78)));
    assert!(lines.windows(2).all(|pair| pair[0]["at_us"].as_u64() <= pair[1]["at_us"].as_u64()));
}

#[test]
fn an_mcap_file_reads_back_with_a_plot_for_each_port_and_a_log() {
    let (bytes, count) = exported(&Wanted::new(Form::Mcap));
    let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    assert_eq!(messages.len(), count);
    let of = |topic: &str| messages.iter().filter(|m| m.channel.topic == topic).collect::<Vec<_>>();
    let beat = of("/nodes/nr/armR/beat");
    assert_eq!(beat.len(), 1);
    let value: Value = serde_json::from_slice(&beat[0].data).unwrap();
    assert_eq!((value["len"].as_u64(), value["min_slack_ms"].as_f64()), (Some(3), Some(7.0)));
    let schema = beat[0].channel.schema.as_ref().unwrap();
    assert_eq!((schema.name.as_str(), schema.encoding.as_str()), ("imrs.Port", "jsonschema"));
    let described: Value = serde_json::from_slice(&schema.data).unwrap();
    let fields = described["properties"].as_object().unwrap();
    assert!(value.as_object().unwrap().keys().all(|key| fields.contains_key(key)), "{value} {described}");
    let log: Vec<Value> = of("/log").iter().map(|m| serde_json::from_slice(&m.data).unwrap()).collect();
    assert!(log.iter().any(|line| line["level"] == 4 && line["name"] == "nh"), "{log:?}");
    assert_eq!(of("/events").len(), 4);
    assert_eq!(of("/events")[1].log_time, 110_000_000);
}

#[test]
fn a_chart_has_a_lane_for_each_task_and_an_arrow_from_cause_to_effect() {
    let (bytes, count) = exported(&Wanted::new(Form::Svg));
    let chart = String::from_utf8(bytes).unwrap();
    assert_eq!(count, 4);
    for lane in ["armL", "armR"] {
        assert!(chart.contains(&format!(">{lane}</text>")), "{chart}");
    }
    assert_eq!(chart.matches("class=\"a\"").count(), 1, "{chart}");
    for mark in ["sent beat #77", "delivered beat #77", "expired beat #78", "gave up lift #12"] {
        assert!(chart.contains(mark), "{mark}: {chart}");
    }
    let one = exported(&Wanted { most: 1, ..Wanted::new(Form::Svg) });
    assert_eq!(one.1, 1);
}

#[test]
fn an_asciicast_shows_a_terminal_what_the_screen_shows() {
    let wanted = Wanted { size: (100, 30), keys: "3".into(), ..Wanted::new(Form::Asciicast) };
    let (bytes, count) = exported(&wanted);
    let all = String::from_utf8(bytes).unwrap();
    let mut lines = all.lines();
    let header: Value = serde_json::from_str(lines.next().unwrap()).unwrap();
    assert_eq!((header["version"].as_u64(), header["width"].as_u64()), (Some(2), Some(100)));
    let mut terminal = vt100::Parser::new(30, 100, 0);
    let (mut frames, mut before) = (0, 0.0);
    for line in lines {
        let frame: Value = serde_json::from_str(line).unwrap();
        let at = frame[0].as_f64().unwrap();
        assert!(at >= before && frame[1] == "o", "{line}");
        before = at;
        terminal.process(frame[2].as_str().unwrap().as_bytes());
        frames += 1;
    }
    assert!(count >= 2 && frames == count + 1, "{count} {frames}");
    let mut app = App::new(Theme::COLOUR, None).replaying(Player::new(film(), 1.0));
    app.update(Msg::Key(crossterm::event::KeyCode::Char('3').into()), Duration::ZERO);
    app.show_stop(usize::MAX);
    let mut buffer = Buffer::empty(Rect::new(0, 0, 100, 30));
    imrs_monitor::view::view(&app, Duration::ZERO, buffer.area, &mut buffer);
    let seen: Vec<String> = terminal.screen().rows(0, 100).map(|row| row.trim_end().to_owned()).collect();
    assert_eq!(
        seen.join("\n"),
        text(&buffer).trim_end_matches('\n').to_owned()
            + &"\n".repeat(30 - text(&buffer).trim_end_matches('\n').lines().count())
    );
}

#[test]
fn a_recording_without_events_makes_no_chart_and_says_so() {
    let header = Header { cell: "beam-lift".into(), ..Header::default() };
    let mut writer = RecordingWriter::new(Vec::new(), &header).unwrap();
    let role = Role::Node(identity(0, 1));
    let hello = Hello { schema: SCHEMA, pid: 7, build: "imrs 1".into(), mono_us: 0, role };
    let records = [
        Shown::Attached { version: VERSION, hello },
        Shown::Said(ServerFrame::Table(table())),
        Shown::Said(ServerFrame::Snapshot(snapshot(0))),
    ];
    for shown in records {
        writer.append(&Record::Frame { source: 0, at: 0, bytes: shown.encode() }).unwrap();
    }
    let film = Arc::new(Film::read(writer.finish().unwrap().as_slice()).unwrap());
    let failed = export(&film, &Wanted::new(Form::Svg), Cursor::new(Vec::new())).unwrap_err();
    assert!(matches!(failed, ExportError::Nothing(_)), "{failed}");
}
