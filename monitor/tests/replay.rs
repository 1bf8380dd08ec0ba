//! Tests of recordings: writing and opening them, moving in them, and drawing them.

use crate::common::{BEAT, LIFT, Stage, events, identity, ms, observed, snapshot, table, whole_film};
use crossterm::event::KeyCode;
use imrs_monitor::app::{App, Effect, Msg};
use imrs_monitor::record::{Tape, free_name};
use imrs_monitor::replay::{Film, Player, Trouble};
use imrs_monitor::source::{Arrival, Feed, SourceId};
use imrs_monitor::store::Store;
use imrs_monitor::theme::Theme;
use imrs_monitor::{At, Options, report};
use imrs_protocol::{Event, TaskId, Ticks};
use imrs_wire::obs::{Events, HeldBack, HeldTask, Hello, Role, SCHEMA, ServerFrame, VERSION, Version};
use imrs_wire::recording::{
    Doing, Header, Place, Record, RecordingReader, RecordingWriter, Shown, Step, Story,
};
use proptest::prelude::*;
use std::fs::File;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

fn attached(node: usize, version: Version) -> Shown {
    let role = Role::Node(identity(node, 1));
    Shown::Attached {
        version,
        hello: Hello { schema: SCHEMA, pid: 0, build: "imrs 1".into(), mono_us: 0, role },
    }
}

fn written(records: &[(u16, u64, Shown)]) -> Vec<u8> {
    let header = Header { cell: "beam-lift".into(), ..Header::default() };
    let mut writer = RecordingWriter::new(Vec::new(), &header).unwrap();
    for (source, at, shown) in records {
        writer.append(&Record::Frame { source: *source, at: *at, bytes: shown.encode() }).unwrap();
    }
    writer.finish().unwrap()
}

fn story() -> Story {
    Story {
        file: "beam.cell".into(),
        kind: "waits in vain without a fault".into(),
        cause: "armL: waitfor `lift` waits in vain for hoist".into(),
        place: Some(Place { line: 31, column: 5, text: "waitfor lift();".into() }),
        bounds: "With at most 1 packet lost".into(),
        tick_us: 1_000,
        steps: 40,
    }
}

/// A counterexample of forty steps of two milliseconds: step 3 loses a packet, the hoist dies in step 20, step 40 is the finding.
fn film() -> Vec<(u16, u64, Shown)> {
    let mut records = vec![(0, 0, Shown::Story(story()))];
    for number in 0..=40 {
        let at = u64::from(number) * 2_000;
        let mut happened =
            vec![format!("{} ticks later", 2 * number), "SEND #4 of armL leaves for nr".into()];
        if number == 3 {
            happened.push("SEND #3 from armL to armR is LOST".into());
        }
        let doing = Doing { task: TaskId(0), text: "waits: waitfor lift".into(), line: Some(31) };
        let odd = matches!(number, 3 | 20 | 40);
        let step = Step { number, tick: u64::from(number) * 2, odd, happened, tasks: vec![doing] };
        records.push((0, at, Shown::Step(step)));
        for node in 0..3 {
            if number == 0 {
                records.push((node, at, attached(node.into(), VERSION)));
                records.push((node, at, Shown::Said(ServerFrame::Table(table()))));
            }
            if number == 20 && node == 2 {
                records.push((node, at, Shown::Lost { why: "it crashed".into() }));
            }
            if number < 20 || node < 2 {
                let mut seen = snapshot(node.into());
                seen.insecure = false;
                seen.tasks[0].view.ports[0].counters.sent = number.into();
                records.push((node, at, Shown::Said(ServerFrame::Snapshot(seen))));
            }
        }
        if number == 3 {
            let happened = [observed(Event::GaveUp, LIFT, 2, 11), observed(Event::Sent, BEAT, 1, 3)];
            records.push((0, at, Shown::Said(ServerFrame::Events(events(0, &happened)))));
        }
    }
    records
}

fn player() -> Player {
    static FILM: LazyLock<Arc<Film>> =
        LazyLock::new(|| Arc::new(Film::read(written(&film()).as_slice()).unwrap()));
    Player::new(Arc::clone(&FILM), 1.0)
}

pub fn stage(theme: Theme) -> Stage {
    Stage { app: App::new(theme, None).replaying(player()) }
}

fn shown(stage: &Stage) -> String {
    report::json_of_replay(stage.app.replay().unwrap(), None)
}

#[test]
fn a_counterexample_is_wound_step_by_step() {
    let mut stage = stage(Theme::ASCII);
    let step = |stage: &Stage| stage.app.replay().unwrap().stop();
    assert_eq!((step(&stage), stage.app.redraw_after()), (0, None), "it stands still");
    for (key, stop) in
        [(']', 1), (']', 2), ('[', 1), ('}', 3), ('}', 20), ('{', 3), ('}', 20), ('}', 40), ('}', 40)]
    {
        assert_eq!(stage.key(ms(5), KeyCode::Char(key)), Effect::Draw);
        assert_eq!(step(&stage), stop, "after {key}");
    }
    stage.key(ms(5), KeyCode::Home);
    assert_eq!(step(&stage), 0);
    stage.key(ms(5), KeyCode::Char('['));
    assert_eq!(step(&stage), 0);
    stage.key(ms(5), KeyCode::End);
    assert_eq!(step(&stage), 40);
    let text = stage.text(ms(5), 120, 40);
    for part in [
        "REPLAY 40/40",
        "step 40 of 40, tick 80",
        "waits in vain for hoist",
        "beam.cell:31:5  waitfor lift();",
        "x nh",
    ] {
        assert!(text.contains(part), "{part}:\n{text}");
    }
    assert_eq!(stage.key(ms(5), KeyCode::Char('r')), Effect::Nothing, "a recording is not recorded");
}

#[test]
fn it_plays_a_step_a_second_and_begins_anew_at_its_end() {
    let mut stage = stage(Theme::ASCII);
    stage.key(ms(1_000), KeyCode::Char(' '));
    assert!(stage.app.redraw_after().is_some());
    assert_eq!(stage.app.update(Msg::Time, ms(4_500)), Effect::Draw);
    assert_eq!(stage.app.replay().unwrap().stop(), 3);
    stage.key(ms(4_600), KeyCode::Char(' '));
    assert_eq!(stage.app.update(Msg::Time, ms(9_000)), Effect::Nothing, "it stands still again");
    stage.key(ms(9_000), KeyCode::Char(' '));
    stage.app.update(Msg::Time, ms(900_000));
    assert_eq!((stage.app.replay().unwrap().stop(), stage.app.redraw_after()), (40, None));
    stage.key(ms(900_000), KeyCode::Char(' '));
    assert_eq!(stage.app.replay().unwrap().stop(), 0);
}

#[test]
fn what_was_recorded_of_nodes_plays_in_its_own_time() {
    let mut records: Vec<_> =
        film().into_iter().filter(|(.., shown)| !matches!(shown, Shown::Story(_) | Shown::Step(_))).collect();
    records.iter_mut().for_each(|(_, at, _)| *at *= 100);
    let film = Film::read(written(&records).as_slice()).unwrap();
    assert_eq!((film.stops().len(), film.length()), (41, ms(8_000)));
    let troubles: Vec<_> = (0..41).map(|stop| (stop, film.stops()[stop].trouble)).collect();
    let troubles: Vec<_> = troubles.into_iter().filter(|(_, trouble)| *trouble > Trouble::None).collect();
    assert_eq!(troubles, [(3, Trouble::Slight), (20, Trouble::Grave)], "a time_out and a death");
    let mut player = Player::new(Arc::new(film), 2.0);
    player.toggle(ms(10));
    player.advance(ms(1_010));
    assert_eq!((player.stop(), player.moment()), (10, ms(2_000)));
    player.advance(ms(1_060));
    assert_eq!((player.stop(), player.moment()), (10, ms(2_100)), "between two stops countdowns go on");
    for (at, stop) in [("-4s", 20), ("200ms", 1), ("1", 5), ("99s", 40), ("-99s", 0)] {
        player.seek(at.parse().unwrap());
        assert_eq!(player.stop(), stop, "{at}");
    }
    for text in ["", "-", "3x", "s", "-5", "1e999s"] {
        assert!(text.parse::<At>().is_err(), "{text}");
    }
}

/// The keys that move in a recording.
const KEYS: [KeyCode; 7] = [
    KeyCode::Char('['),
    KeyCode::Char(']'),
    KeyCode::Char('{'),
    KeyCode::Char('}'),
    KeyCode::Char(' '),
    KeyCode::Home,
    KeyCode::End,
];

proptest! {
    // Each case draws dozens of screens, so a quarter of the usual cases already takes seconds in a debug build.
    #![proptest_config(ProptestConfig { cases: ProptestConfig::default().cases / 4, ..ProptestConfig::default() })]

    /// The screen at a stop does not depend on the keys that led to it, and the same keys give the same screens.
    #[test]
    fn the_way_to_a_stop_does_not_matter(keys in prop::collection::vec((0..KEYS.len(), 0_u64..3_000), 0..40)) {
        let (mut one, mut other) = (stage(Theme::COLOUR), stage(Theme::COLOUR));
        let mut now = 0;
        for (key, passed) in keys {
            now += passed;
            for stage in [&mut one, &mut other] {
                stage.app.update(Msg::Time, ms(now));
                stage.key(ms(now), KEYS[key]);
            }
            prop_assert_eq!(one.buffer(ms(now), 80, 24), other.buffer(ms(now), 80, 24));
        }
        let mut fresh = player();
        fresh.go(one.app.replay().unwrap().stop());
        prop_assert_eq!(shown(&one), report::json_of_replay(&fresh, None));
    }
}

#[test]
fn a_recording_shows_what_was_seen_live() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.imrs");
    let (tape, mut store) = (Tape::default(), Store::default());
    let mut take = |at: Duration, source: u32, feed: Feed| {
        let arrival = Arrival { at, source: SourceId(source), feed };
        tape.take(&arrival);
        store.apply(arrival);
    };
    for node in 0..3_u32 {
        let build = "imrs 0.1.0".to_owned();
        take(ms(5), node, Feed::Attached { identity: identity(node as usize, 1), pid: 800 + node, build });
        take(ms(5), node, Feed::Frame(Box::new(ServerFrame::Table(table()))));
    }
    // The recording begins with the last state of each node, although the nodes sent these states before its start.
    tape.start(&path, ms(10)).unwrap();
    for node in 0..3_u32 {
        take(ms(1_010), node, Feed::Frame(Box::new(ServerFrame::Snapshot(snapshot(node as usize)))));
    }
    let tasks = vec![HeldTask { task: TaskId(1), remaining: Ticks(62_000_000) }];
    let held = ServerFrame::HeldBack(HeldBack { mono_us: 5_010_000, tasks });
    take(ms(1_020), 1, Feed::Frame(Box::new(held)));
    take(ms(1_500), 2, Feed::Lost { why: "the connection was closed".into() });
    let recorded = tape.stop().unwrap();
    assert_eq!(recorded.status.lost, 0);
    assert!(tape.stop().is_none());
    let mut player = Player::new(Arc::new(whole_film(&path)), 1.0);
    player.go_to_end();
    let live: serde_json::Value = serde_json::from_str(&report::json(&store, None, ms(1_500))).unwrap();
    let mut replayed: serde_json::Value =
        serde_json::from_str(&report::json_of_replay(&player, None)).unwrap();
    let place = replayed.as_object_mut().unwrap().remove("replay").unwrap();
    assert_eq!(live, replayed);
    assert_eq!(replayed["nodes"][1]["held_back_us"], 62_000_000 - 480_000);
    assert_eq!((&place["at_us"], &place["story"]), (&1_490_000.into(), &serde_json::Value::Null));
    assert!(report::is_critical(player.store(), None, player.moment()), "a death is one in a recording too");
    assert_eq!(free_name(&path), folder.path().join("run-2.imrs"));
}

#[test]
fn the_header_says_whether_nodes_have_keys_though_the_recording_was_started_before_them() {
    let folder = tempfile::tempdir().unwrap();
    for insecure in [true, false] {
        let path = folder.path().join(format!("{insecure}.imrs"));
        let tape = Tape::default();
        let take = |at, feed| tape.take(&Arrival { at: ms(at), source: SourceId(0), feed });
        tape.start(&path, ms(0)).unwrap();
        take(5, Feed::Attached { identity: identity(0, 1), pid: 800, build: "imrs 0.1.0".into() });
        take(6, Feed::Frame(Box::new(ServerFrame::Table(table()))));
        assert_eq!(path.metadata().unwrap().len(), 0, "nothing is known yet");
        let state = imrs_wire::obs::Snapshot { insecure, ..snapshot(0) };
        take(7, Feed::Frame(Box::new(ServerFrame::Snapshot(state))));
        assert!(tape.stop().unwrap().status.ended);
        let header = RecordingReader::new(File::open(&path).unwrap()).unwrap().header().clone();
        assert_eq!((header.insecure, header.cell), (insecure, identity(0, 1).cell));
        let mut player = Player::new(Arc::new(whole_film(&path)), 1.0);
        player.go_to_end();
        assert!(report::text_of_replay(&player, None).contains("node nl: up"));
    }
    // Without any node, a recording is empty, and has a header and an end.
    let (tape, path) = (Tape::default(), folder.path().join("empty.imrs"));
    tape.start(&path, ms(0)).unwrap();
    let recorded = tape.stop().unwrap();
    assert!(recorded.status.ended && tape.stop().is_none(), "{recorded:?}");
}

#[test]
fn a_file_cut_off_anywhere_shows_what_is_whole_and_says_so() {
    let whole = written(&film());
    let mut stops = 0;
    for length in (0..whole.len()).step_by(97).chain([whole.len() - 1]) {
        match Film::read(&whole[..length]) {
            Ok(film) => {
                assert!(film.stops().len() >= stops, "cut off at {length}");
                stops = film.stops().len();
                assert_eq!(film.notice.as_deref(), Some("the recording was cut off: it has no end"));
                let mut player = Player::new(Arc::new(film), 1.0);
                player.go_to_end();
                assert!(report::text_of_replay(&player, None).contains("note: the recording was cut off"));
            }
            Err(why) => assert!(stops == 0 && !why.is_empty(), "cut off at {length}: {why}"),
        }
    }
    assert_eq!(stops, 41);
}

#[test]
fn damage_and_other_versions_are_named() {
    let whole = written(&film());
    let mut damaged = whole.clone();
    let at = whole.len() / 2;
    damaged[at] ^= 0x10;
    let film = Film::read(damaged.as_slice()).unwrap();
    let notice = film.notice.clone().unwrap();
    assert!(notice.starts_with("DAMAGED: at byte ") && notice.contains("checksum"), "{notice}");
    assert!((1..41).contains(&film.stops().len()));
    let stage = Stage { app: App::new(Theme::ASCII, None).replaying(Player::new(Arc::new(film), 1.0)) };
    assert!(stage.text(ms(0), 80, 24).contains("DAMAGED"));

    let mut newer = whole;
    let reads = imrs_wire::recording::VERSION;
    newer[8..10].copy_from_slice(&(reads + 1).to_le_bytes());
    let refusal = |bytes: &[u8]| Film::read(bytes).unwrap_err();
    let why = format!("at byte 0: a recording of version {}, this program reads {reads}", reads + 1);
    assert_eq!(refusal(&newer), why);
    let other = attached(0, Version { major: 2, minor: 0 });
    let why = refusal(&written(&[(0, 0, other)]));
    assert!(why.contains("the node speaks imrs-obs 2.0, this program 1.4"), "{why}");
    assert_eq!(refusal(&written(&[])), "nothing was recorded in it");
    let missing = imrs_monitor::run(&Options { replay: Some("no/such.imrs".into()), ..Options::default() });
    let missing = missing.unwrap_err();
    assert!(missing.exit_code() == 2 && missing.to_string().starts_with("no/such.imrs: "), "{missing}");
}

/// A recording of version 1.0, which has only whole snapshots, still plays.
#[test]
fn recordings_of_version_1_0_are_playable() {
    let Shown::Attached { hello, .. } = attached(0, VERSION) else { panic!("attached") };
    let hello = imrs_wire::obs::Hello { schema: 0x3723_afbb, ..hello };
    let old = Shown::Attached { version: Version { major: 1, minor: 0 }, hello };
    let said = |frame: ServerFrame| Shown::Said(frame);
    let records = [
        (0, 0, old),
        (0, 0, said(ServerFrame::Table(table()))),
        (0, 100_000, said(ServerFrame::Snapshot(snapshot(0)))),
    ];
    let mut player = Player::new(Arc::new(Film::read(written(&records).as_slice()).unwrap()), 1.0);
    player.go_to_end();
    assert_eq!(*player.store().incarnations()[0].last.as_ref().unwrap().snapshot, snapshot(0));
}

#[test]
fn lost_frames_are_counted() {
    let mut writer = RecordingWriter::new(Vec::new(), &Header::default()).unwrap();
    let put = |shown: Shown| Record::Frame { source: 0, at: 1, bytes: shown.encode() };
    writer.append(&put(attached(0, VERSION))).unwrap();
    writer.append(&put(Shown::Said(ServerFrame::Events(Events::default())))).unwrap();
    writer.append(&Record::Gap { stream: imrs_wire::recording::Stream::Frames(0), lost: 7 }).unwrap();
    let film = Film::read(writer.finish().unwrap().as_slice()).unwrap();
    let player = Player::new(Arc::new(film), 1.0);
    assert_eq!(player.store().incarnations()[0].lost, 7);
}

#[test]
fn words_of_a_recording_move_no_cursor() {
    let mut records = film();
    for (.., shown) in &mut records {
        match shown {
            Shown::Step(step) => step.happened.push("a\u{1b}[2Jb".into()),
            Shown::Story(story) => story.cause = "c\u{9b}2J".into(),
            Shown::Attached { .. } | Shown::Said(_) | Shown::Lost { .. } => {}
        }
    }
    let mut player = Player::new(Arc::new(Film::read(written(&records).as_slice()).unwrap()), 1.0);
    player.go(3);
    let (text, json) = (report::text_of_replay(&player, None), report::json_of_replay(&player, None));
    assert!(text.contains("a\\x1b[2Jb") && text.contains("c\\x9b2J"), "{text}");
    assert!(!text.contains('\u{1b}') && !json.contains('\u{1b}') && json.is_ascii());
}
