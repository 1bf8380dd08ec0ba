//! Tests that the screens stay legible: at narrow widths, with wide names, in the selected row, and after a restart.

use crate::common::crowd::CROWD_NOW;
use crate::common::{BEAT, Stage, identity, ms, snapshot, table, text, traffic};
use imrs_monitor::app::Screen;
use imrs_monitor::keymap::Keymap;
use imrs_monitor::keys::BINDINGS;
use imrs_monitor::rows::Sort;
use imrs_monitor::source::Feed;
use imrs_monitor::theme::Theme;
use imrs_protocol::{QueueView, TaskId};
use imrs_wire::obs::{Bye, Detail, Events, Goodbye, Liveness, NodeIdentity, PortDetail, ServerFrame};
use ratatui::style::Color;
use std::time::Duration;

const NOW: Duration = ms(1_150);

/// A screen whose header has every possible warning: a recording, a pause, insecure nodes and lost events.
fn warned() -> Stage {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.lose(ms(1_120), 2);
    stage.frame(ms(1_120), 0, ServerFrame::Events(Events { lost: 4_000, events: Vec::new() }));
    stage.app.recording = Some("cell.imrs".into());
    stage.keys(ms(1_130), " ");
    stage
}

#[test]
fn from_sixty_columns_on_every_tab_and_the_health_are_visible() {
    for width in 60..=130 {
        let mut stage = warned();
        for key in ["2", "3", "4", "5", "6", "7", "8", "1"] {
            let shown = stage.typed(NOW, (width, 24), key);
            let head = shown.lines().next().unwrap();
            for tab in ["1", "2", "3", "4", "5", "6", "7", "8", "?"] {
                assert!(head.contains(tab), "{tab} at {width}: {head}");
            }
            assert!(head.contains(&format!("[{key} ")) && head.contains("2/3 nodes"), "{width}: {head}");
        }
        let shown = stage.typed(NOW, (width, 24), "");
        let health = shown.lines().nth(2).unwrap().find("HEALTH").expect("a title");
        let dead = shown.lines().find(|line| line.contains("x nh")).unwrap();
        assert!(dead[health..].starts_with("!! dead"), "{width}: {dead}");
    }
}

#[test]
fn the_verdict_is_visible_however_many_links_there_are() {
    for width in [40, 60, 80] {
        let shown = Stage::busy(Theme::ASCII).text(NOW, width, 24);
        assert!(shown.contains("model: UNKNOWN, not recorded"), "{width}: {shown}");
    }
}

#[test]
fn the_selected_row_has_one_style() {
    for theme in Theme::ALL {
        for keys in ["jj", "2lj", "6k", "4k", "2l\nj", "3j", "5jj", "7jj", "8jj", "oj"] {
            let mut stage = Stage::busy(theme);
            stage.lose(ms(1_120), 2);
            stage.typed(NOW, (120, 40), keys);
            let buffer = stage.draw(NOW, 120, 40);
            // The row of the settings is as wide as their window, and a scrollbar is no part of a row.
            let is_reversed =
                |x: u16, y: u16| buffer[(x, y)].modifier.contains(ratatui::style::Modifier::REVERSED);
            let columns = |y: u16| (0..120).filter(|&x| is_reversed(x, y)).collect::<Vec<_>>();
            let row = (0..40).find(|&y| columns(y).len() >= 60);
            let row = row.unwrap_or_else(|| panic!("no selection: {keys} {}", theme.name));
            let columns = columns(row);
            let (first, last) = (columns[0], columns[columns.len() - 1]);
            assert!(keys == "oj" || (first, last >= 118) == (0, true), "{keys} {}: {columns:?}", theme.name);
            let style = |x| (buffer[(x, row)].fg, buffer[(x, row)].bg, buffer[(x, row)].modifier);
            assert!((first..=last).all(|x| style(x) == style(first)), "{keys} {}: {row}", theme.name);
        }
    }
}

/// On a light terminal, a cell without a colour of its own would have dark text on a light background, and white text
/// would be invisible.
#[test]
fn the_contrast_theme_colours_every_cell_itself() {
    let screens =
        ["1", "2", "3", "4", "5", "6", "7", "8", "?", "2l\n", "8x", "o", " ", ":port be", "/slack<"];
    for key in screens {
        let mut stage = Stage::busy(Theme::CONTRAST);
        stage.typed(NOW, (120, 40), key);
        let buffer = stage.draw(NOW, 120, 40);
        assert!(
            buffer.content.iter().all(|cell| cell.bg != Color::Reset && cell.fg != Color::Reset),
            "{key}"
        );
    }
}

#[test]
fn a_member_that_cannot_arrive_says_why() {
    let end = |liveness| {
        let mut stage = Stage::cell(Theme::ASCII);
        let mut after = snapshot(2);
        after.tasks[0].liveness = liveness;
        stage.frame(ms(1_100), 2, ServerFrame::Snapshot(after));
        stage
    };
    let mut dead = Stage::cell(Theme::ASCII);
    dead.lose(ms(1_100), 2);
    let mut stopped = Stage::cell(Theme::ASCII);
    stopped.frame(ms(1_100), 2, ServerFrame::Bye(Bye { reason: Goodbye::Stopping }));
    let ends = [
        (end(Liveness::Ended), "MISSING, ENDED"),
        (end(Liveness::Crashed), "MISSING, CRASHED"),
        (dead, "MISSING, DEAD"),
        (stopped, "MISSING, STOPPED"),
    ];
    for (mut stage, said) in ends {
        stage.keys(NOW, "3");
        let shown = stage.text(NOW, 120, 40);
        assert!(shown.contains(said) && shown.matches("MISSING").count() == 1, "{said}: {shown}");
    }
}

/// The health of a row that has no room for all of it is on the bottom line as soon as the user selects that row.
#[test]
fn the_bottom_line_has_the_whole_finding_of_the_selected_row() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.lose(ms(1_500), 2);
    let now = ms(3_000);
    let foot = |shown: &str| shown.lines().last().unwrap().to_owned();
    // Before the user has selected a row, it has the worst finding.
    assert!(foot(&stage.typed(now, (80, 24), "1")).starts_with(" !! nh: dead"));
    let mut seen = 0;
    for _ in 0..12 {
        let shown = stage.typed(now, (80, 24), "j");
        let row = shown.lines().find(|line| line.starts_with('>')).unwrap();
        let Some((_, health)) = row.rsplit_once("! ").filter(|(_, text)| !text.contains("holds")) else {
            continue;
        };
        let (health, foot) = (health.trim_end_matches(['#', '|']).trim(), foot(&shown));
        if health.starts_with("held by") {
            continue;
        }
        assert!(foot.contains(health), "{health}: {foot}");
        seen += 1;
    }
    assert!(seen > 2, "{}", stage.text(now, 80, 24));
    let problems = stage.typed(now, (80, 24), "8gj");
    let row = problems.lines().find(|line| line.starts_with('>')).unwrap();
    let text: String = row.chars().skip(25).take(30).collect();
    assert!(foot(&problems).contains(text.trim()), "{text}: {problems}");
}

#[test]
fn dead_incarnations_have_no_rows_until_asked_for_and_never_look_healthy() {
    let mut stage = Stage::cell(Theme::ASCII);
    let rows = stage.app.rows(&[], NOW).len();
    for incarnation in 2..5 {
        stage.lose(ms(1_100), 0);
        stage.attach(ms(1_110), 0, incarnation);
    }
    assert_eq!(stage.app.rows(&[], NOW).len(), rows);
    assert!(stage.text(NOW, 120, 40).contains("inc 4, 3 deaths up 4m12s"));
    let shown = stage.typed(NOW, (120, 40), "a");
    let dead: Vec<_> = shown.lines().filter(|line| line.contains("DEAD")).collect();
    assert_eq!(dead.len(), 3, "{shown}");
    assert!(dead.iter().all(|line| line.ends_with(" -")), "{dead:?}");
    stage.keys(NOW, "a");
    assert_eq!(stage.app.rows(&[], NOW).len(), rows);
}

/// Two processes run the same node of a cell at the same time. Both have a row, also after the later one has ended.
#[test]
fn two_processes_of_a_node_both_have_rows() {
    let mut stage = Stage::cell(Theme::ASCII);
    let pid = 900;
    stage.feed(ms(1_050), 7, Feed::Attached { identity: identity(0, 1), pid, build: "imrs 0.1.0".into() });
    stage.frame(ms(1_050), 7, ServerFrame::Snapshot(snapshot(0)));
    let states = |stage: &Stage| {
        let shown = stage.text(NOW, 120, 40);
        let nodes = shown.lines().filter(|line| line.contains("nl (pid"));
        nodes.map(|line| if line.contains("DEAD") { "dead" } else { "up" }).collect::<Vec<_>>()
    };
    assert_eq!(states(&stage), ["up", "up"]);
    stage.lose(ms(1_060), 7);
    assert_eq!(states(&stage), ["up", "dead"]);
}

#[test]
fn sorting_shows_what_comes_first_in_the_new_order() {
    let mut stage = Stage::cell(Theme::ASCII);
    stage.lose(ms(1_100), 2);
    let shown = stage.typed(NOW, (80, 10), "Gsss");
    assert_eq!(stage.app.shape.sort, Sort::Health);
    let first = shown.lines().nth(3).unwrap();
    assert!(first.starts_with('>') && first.contains("!!"), "{shown}");
    stage.keys(NOW, "G");
    assert_eq!(stage.typed(NOW, (80, 10), "i").lines().position(|line| line.starts_with('>')), Some(3));
}

#[test]
fn each_screen_has_a_filter_of_its_own() {
    let mut stage = Stage::busy(Theme::ASCII);
    let all = (stage.app.events().len(), stage.app.chart().lanes.len());
    stage.keys(NOW, "/slack<20ms\n");
    let few = stage.app.rows(&[], NOW).len();
    stage.keys(NOW, "6");
    assert_eq!((stage.app.filter(), stage.app.events().len()), ("", all.0));
    assert!(!stage.text(NOW, 120, 24).contains("filter /"));
    stage.keys(NOW, "4/hoist\n");
    assert_eq!((all.1, stage.app.chart().lanes.len()), (3, 1));
    stage.keys(NOW, "1");
    assert_eq!((stage.app.filter(), stage.app.rows(&[], NOW).len()), ("slack<20ms", few));
    assert!(stage.text(NOW, 120, 24).contains("filter /slack<20ms"));
}

/// The sample cell with traffic and a dead node, in which every name begins with `start`.
fn with_names(start: &str) -> Stage {
    let mut stage = Stage::new(Theme::ASCII);
    let name = |kind: &str, i: usize| format!("{start}{kind}{i}");
    let mut names = table();
    names.nodes.iter_mut().enumerate().for_each(|(i, node)| node.name = name("n", i));
    names.tasks.iter_mut().enumerate().for_each(|(i, task)| task.name = name("t", i));
    names.ports.iter_mut().enumerate().for_each(|(i, port)| port.name = name("p", i));
    for (node, events) in traffic().into_iter().enumerate() {
        let identity = NodeIdentity { node: name("n", node), ..identity(node, 1) };
        stage.feed(ms(1_000), node, Feed::Attached { identity, pid: 1, build: "imrs 0.1.0".into() });
        stage.frame(ms(1_000), node, ServerFrame::Table(names.clone()));
        stage.frame(ms(1_000), node, ServerFrame::Snapshot(snapshot(node)));
        stage.frame(ms(1_000), node, ServerFrame::Events(events));
    }
    stage.lose(ms(1_100), 2);
    stage
}

/// With characters that are two columns wide or have no width, everything but the names is where it is with other names
/// of the same width.
#[test]
fn names_are_measured_in_columns_of_the_screen() {
    const LATER: Duration = ms(1_700);
    for keys in [
        "", "jj", "2", "2\n", "3", "4", "4l--", "5", "6", "6akk", "7", "8", "8j", "8x", "?", "o", " ",
        ":port ", ":node ",
    ] {
        for width in [40, 47, 64, 80, 99, 120, 161, 200] {
            let draw = |start: &str| {
                let mut stage = with_names(start);
                stage.typed(LATER, (width, 40), keys);
                stage.draw(LATER, width, 40)
            };
            let (plain, wide) = (draw("QXQXQ"), draw("\u{5de6}\u{8155}e\u{301}"));
            let named = text(&wide).contains('\u{5de6}');
            assert!(named || keys == "?" || keys == "8x", "{keys} at {width}: {}", text(&wide));
            for at in (0..40).flat_map(|y| (0..width).map(move |x| (x, y))) {
                let (plain, wide) = (plain[at].symbol(), wide[at].symbol());
                // A wide character that has room for its half only is left out.
                let is_name = plain == "Q" || plain == "X";
                assert!(plain == wide || is_name, "{keys} at {width}: {at:?} {plain} {wide}");
            }
        }
    }
}

/// The text in the corner uses only the room that the titles leave free. If it has no room, only the titles are shown.
#[test]
fn no_title_is_overwritten() {
    for width in 40..=140 {
        for (keys, titles) in [
            ("sssi", &["SLACK"][..]),
            ("6akk", &["AGO", "KIND", "OBJECT"]),
            ("2lj", &["REMAIN", "VERDICT"][..if width < 60 { 1 } else { 2 }]),
            ("4lkkkk", &["TIME"]),
            ("5", &["OWNER", "KIND", "LEFT"]),
            ("8", &["PLACE", "PROBLEM"]),
            ("?jjjj", &[]),
        ] {
            let shown = Stage::busy(Theme::ASCII).typed(NOW, (width, 24), keys);
            let whole =
                |title: &&str| shown.lines().any(|line| line.split_whitespace().any(|word| word == *title));
            assert!(titles.iter().all(whole), "{keys} at {width}: {shown}");
        }
    }
}

/// Findings, a pause, a recording and an error share the bottom line with the keys of the screen.
#[test]
fn key_hints_are_on_every_screen_whatever_is_wrong() {
    let keymap = Keymap::default();
    for screen in Screen::ALL {
        for (width, height) in [(40, 12), (64, 20), (80, 24), (120, 40), (200, 60)] {
            let mut stage = warned();
            stage.app.screen = screen;
            let shown = stage.draw(NOW, width, height);
            let foot = text(&shown).lines().last().unwrap().to_owned();
            assert!(foot.contains("? help"), "{screen:?} {width}: {foot}");
            let named = keymap.hints(screen).filter(|(hint, _)| foot.contains(hint.as_str())).count();
            assert!(width < 80 || named > 1, "{screen:?} {width}: {foot}");
            assert!(width < 64 || foot.starts_with(" paused at"), "{screen:?} {width}: {foot}");
        }
        // Every hint names a key with the action that the help describes.
        let all = keymap.hints(screen).count();
        assert!(all >= 4, "{screen:?}");
        for (hint, action) in keymap.hints(screen) {
            let label = hint.split(' ').next().unwrap();
            let binding =
                BINDINGS.iter().find(|b| b.is_on(screen) && keymap.label(b).split(' ').any(|l| l == label));
            assert_eq!(binding.map(|binding| binding.action), Some(action), "{screen:?}: {hint}");
        }
    }
}

/// Words in capitals are titles; each of them is explained in the help of its screen.
#[test]
fn the_help_of_a_screen_explains_each_of_its_columns() {
    for (keys, least) in [("1", 10), ("2l", 8), ("2l\n", 6), ("3", 5), ("5", 6), ("6", 5), ("8", 3)] {
        let mut stage = Stage::busy(Theme::ASCII);
        let shown = stage.typed(NOW, (200, 60), keys);
        let is_title =
            |word: &&str| word.len() > 1 && word.chars().all(|c| c.is_ascii_uppercase() || c == '/');
        let is_titles = |line: &&str| {
            line.split_whitespace().filter(is_title).count() >= 3
                && !line.contains(|c: char| c.is_ascii_digit())
        };
        let titles = shown.lines().skip(2).find(is_titles).unwrap_or_else(|| panic!("{keys}: {shown}"));
        let titles: Vec<&str> = titles.split_whitespace().filter(is_title).collect();
        assert!(titles.len() >= least, "{keys}: {titles:?}");
        let help = stage.typed(NOW, (200, 200), "?");
        let explained: Vec<&str> = help
            .lines()
            .skip_while(|line| !line.contains("COLUMNS AND FIGURES"))
            .take_while(|line| !line.contains("THE BANNER"))
            .collect();
        for title in titles {
            let is_key = |line: &&str| line.get(..16).unwrap_or(line).contains(title);
            assert!(explained.iter().any(is_key), "{keys}: {title} in {explained:#?}");
        }
    }
}

/// Numbers that count since the node's start, and numbers that count since the monitor attached, are in rows that say so.
#[test]
fn figures_of_the_port_say_since_when_they_count() {
    for (keys, most) in [("2l", 200), ("2l", 80)] {
        let shown = Stage::busy(Theme::ASCII).typed(NOW, (most, 30), keys);
        let start =
            shown.lines().find(|line| line.contains(" served 28 ")).unwrap_or_else(|| panic!("{shown}"));
        assert!(start.starts_with(" since start: "), "{start}");
        let attached = shown.lines().find(|line| line.contains("service p50")).unwrap();
        assert!(attached.starts_with(" since attached: ") && !attached.contains("since start"), "{attached}");
    }
    // The fill is from the latest samples, and `bypassed` is the present number.
    let mut stage = Stage::busy(Theme::ASCII);
    let queue = QueueView { handled: true, bypassed: 3, bypass_limit: 9, queue: Vec::new() };
    let ports = vec![PortDetail { task: TaskId(1), port: BEAT, age_us: 0, queue }];
    stage.frame(ms(1_100), 1, ServerFrame::Detail(Detail { mono_us: 5_100_000, ports }));
    for width in [80, 120, 200] {
        let shown = stage.typed(NOW, (width, 30), "2l");
        let row = |part: &str| {
            let row = shown.lines().find(|line| line.contains(part));
            row.unwrap_or_else(|| panic!("{part} at {width}: {shown}")).to_owned()
        };
        let fill = row("slack p5");
        assert!(fill.starts_with(" fill last ") && fill.contains(" samples: "), "{fill}");
        if width >= 120 {
            let now = row("bypassed 3/9");
            assert!(now.contains("buffer 3/8") && !now.contains("since"), "{now}");
        }
        stage.keys(NOW, "1");
    }
}

/// At forty columns the verdict on a large cell has fewer words, and no word is cut.
#[test]
fn a_long_verdict_is_said_in_fewer_words() {
    let stage = Stage::crowd_at_work(Theme::ASCII);
    for (width, said) in
        [(40, "model: 2 UNKNOWN"), (64, "model: conforms, 2 nodes UNKNOWN"), (80, "steps, 2 nodes UNKNOWN")]
    {
        let shown = stage.text(CROWD_NOW, width, 24);
        assert!(shown.lines().any(|line| line.trim_end().ends_with(said)), "{width}: {shown}");
    }
}
