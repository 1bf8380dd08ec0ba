//! Tests of clicks: what single targets do.

use crate::common::crowd::CROWD_NOW;
use crate::common::{Stage, identity, ms, text};
use crate::targets::{paused, troubled};
use crossterm::event::{KeyCode, KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::app::{Effect, Msg, Screen};
use imrs_monitor::rows::Sort;
use imrs_monitor::source::Feed;
use imrs_monitor::theme::Theme;
use imrs_protocol::{TaskId, Ticks};
use imrs_wire::obs::{HeldBack, HeldTask, NodeIdentity, ServerFrame};
use std::time::Duration;

const NOW: Duration = ms(1_150);

/// A stage at a moment, on a terminal of this size.
struct Desk {
    stage: Stage,
    now: Duration,
    size: (u16, u16),
}

impl Desk {
    fn new(stage: Stage, now: Duration, keys: &str) -> Self {
        Self::sized(stage, now, (120, 40), keys)
    }

    fn sized(stage: Stage, now: Duration, size: (u16, u16), keys: &str) -> Self {
        let mut desk = Self { stage, now, size };
        desk.stage.typed(now, size, keys);
        desk
    }

    fn shown(&mut self) -> String {
        text(&self.stage.draw(self.now, self.size.0, self.size.1))
    }

    /// Clicks on a place in the first row that contains all parts of `words` in this order. The parts are separated
    /// by `|`, and the middle of the last part is clicked.
    fn click(&mut self, words: &str) -> Effect {
        let shown = self.shown();
        let find = |line: &str| {
            let mut end = 0;
            let mut middle = 0;
            for word in words.split('|') {
                let at = end + line.get(end..)?.find(word)?;
                (middle, end) = (at + word.len() / 2, at + word.len());
            }
            Some(line[..middle].chars().count())
        };
        let found = shown.lines().enumerate().find_map(|(row, line)| Some((find(line)?, row)));
        let (column, row) = found.unwrap_or_else(|| panic!("no {words}: {shown}"));
        self.press(column, row)
    }

    fn press(&mut self, column: usize, row: usize) -> Effect {
        self.shown();
        let (column, row) = (u16::try_from(column).unwrap(), u16::try_from(row).unwrap());
        let kind = MouseEventKind::Down(MouseButton::Left);
        let event = MouseEvent { kind, column, row, modifiers: KeyModifiers::NONE };
        let effect = self.stage.app.update(Msg::Mouse(event), self.now);
        self.shown();
        effect
    }

    /// The row with the cursor.
    fn cursor(&mut self) -> String {
        let shown = self.shown();
        let row = shown.lines().find(|line| line.starts_with('>'));
        row.unwrap_or_else(|| panic!("no cursor: {shown}")).to_owned()
    }

    fn typed(&self) -> String {
        self.stage.app.entry_line.as_ref().map(|entry| entry.input.value().to_owned()).unwrap_or_default()
    }
}

fn busy(keys: &str) -> Desk {
    Desk::new(Stage::busy(Theme::ASCII), NOW, keys)
}

#[test]
fn each_fact_of_the_header_leads_somewhere() {
    for (fact, screen) in [("3/3 nodes", Screen::Overview), ("lost 17", Screen::Events)] {
        let mut desk = busy("5");
        desk.click(fact);
        assert_eq!(desk.stage.app.screen, screen, "{fact}");
    }
    let mut desk = busy("5");
    desk.click("LIVE");
    assert!(desk.stage.app.paused().is_some());
    desk.click("PAUSED");
    assert!(desk.stage.app.paused().is_none());
    desk.click("INSECURE");
    assert!(desk.shown().contains("neither encrypt nor authenticate"));
    let mut desk = Desk::new(troubled(), NOW, "5");
    assert_eq!(desk.click("REC"), Effect::Record);
    assert_eq!(desk.click("recording to"), Effect::Record);
    // With two cells, the name leads to the other one; below 60 columns the tab leads to the next one.
    let mut two = Stage::busy(Theme::ASCII);
    let identity = NodeIdentity { cell: "other".into(), ..identity(0, 1) };
    two.feed(NOW, 7, Feed::Attached { identity, pid: 1, build: "imrs".into() });
    let mut desk = Desk::new(two, NOW, "");
    desk.click("C: next");
    assert_eq!(desk.stage.app.cell().unwrap().raw(), "other");
    let mut desk = Desk::sized(Stage::busy(Theme::ASCII), NOW, (40, 12), "6");
    desk.click("6 Events");
    assert_eq!(desk.stage.app.screen, Screen::Model);
    let mut desk = Desk::sized(Stage::busy(Theme::ASCII), NOW, (40, 12), "8");
    desk.click("8 Prob");
    assert_eq!(desk.stage.app.screen, Screen::Overview);
}

/// A click before the next frame would act with the targets of the screen that was left.
#[test]
fn a_click_acts_only_on_the_screen_that_was_drawn() {
    let mut desk = busy("6");
    desk.stage.keys(NOW, "1");
    let before = desk.cursor();
    desk.stage.keys(NOW, "6");
    let row = MouseEvent {
        kind: MouseEventKind::Down(MouseButton::Left),
        column: 10,
        row: 8,
        modifiers: KeyModifiers::NONE,
    };
    assert_eq!(desk.stage.app.update(Msg::Mouse(row), NOW), Effect::Nothing);
    desk.stage.keys(NOW, "1");
    assert_eq!(desk.cursor(), before);
}

#[test]
fn the_window_of_settings_leaves_the_rest_of_the_screen_alive() {
    let mut desk = busy("2o");
    desk.click("6 ");
    assert_eq!(desk.stage.app.screen, Screen::Events);
    for (words, screen) in [("Esc close", Screen::Port), ("waiting for hoist", Screen::Overview)] {
        let mut desk = busy("2o");
        desk.click(words);
        assert_eq!(desk.stage.app.screen, screen, "{words}");
    }
    for words in ["settings: |Enter changes", "? help|Enter change"] {
        let mut desk = busy("2oj");
        desk.click(words);
        assert!(!desk.stage.app.mouse, "{words}");
    }
    // A click beside the window closes it, and does nothing else.
    let mut desk = busy("2o");
    desk.press(3, 36);
    assert_eq!((desk.stage.app.screen, desk.stage.app.message()), (Screen::Port, None));
}

#[test]
fn the_line_that_is_typed_can_be_clicked() {
    let mut desk = busy(":port b");
    desk.click("Tab: |armR.beat");
    assert_eq!(desk.typed(), "port armR.beat");
    desk.click(":port|armR");
    desk.stage.keys(NOW, "X");
    assert_eq!(desk.typed(), "port arXmR.beat");
    desk.press(100, 39);
    desk.stage.keys(NOW, "Y");
    assert_eq!(desk.typed(), "port arXmR.beatY");
    // A completion that is clicked while a filter is typed takes effect at once.
    let mut desk = busy("/hal");
    desk.click("Tab: |halt");
    assert_eq!((desk.typed().as_str(), desk.stage.app.filter()), ("halt", "halt"));
    // A click also removes an answer on the bottom line, and ends the selection of a title.
    let mut desk = busy("m");
    desk.click("marked at");
    assert!(desk.stage.app.told.is_none());
    desk.click("SLACK");
    desk.click("? in the help");
    assert_eq!((desk.stage.app.screen, desk.stage.app.title()), (Screen::Help, Some("SLACK")));
    desk.click("Esc back");
    desk.click("in the help, |Esc");
    assert_eq!((desk.stage.app.screen, desk.stage.app.title()), (Screen::Overview, None));
}

#[test]
fn the_mode_of_the_screen_on_the_bottom_line_can_be_changed_there() {
    let mut desk = Desk::new(paused(), ms(2_000), "");
    desk.click("[ steps back");
    assert!(desk.stage.app.gone_back().is_some());
    desk.click("before the pause; |[ ]| step, |End returns");
    assert!(desk.stage.app.gone_back().is_none());
    desk.click("paused at");
    assert!(desk.stage.app.paused().is_none());
    let mut desk = busy("/halt\n");
    desk.click("filter /halt");
    assert_eq!(desk.typed(), "halt");
    let mut desk = busy("md");
    desk.click("since the mark");
    assert!(!desk.stage.app.since_mark);
    let mut desk = Desk::sized(troubled(), NOW, (40, 12), "5");
    desk.click("recording to");
    let mut desk = Desk::new(troubled(), NOW, "5");
    desk.click("unix:/x.sock");
    assert!(desk.stage.app.told.as_ref().is_some_and(|told| told.ends_with("this monitor 1.0")));
}

#[test]
fn the_keys_of_the_scrub_bar_and_of_a_finding_can_be_clicked() {
    let mut desk = Desk::new(paused(), ms(2_000), "");
    for (words, back) in
        [("Home", true), ("{ } trouble  Home |End", false), ("#] 100ms  |[", true), ("[ |] step", false)]
    {
        desk.click(words);
        assert_eq!(desk.stage.app.gone_back().is_some(), back, "{words}");
    }
    desk.click("Home End  |space");
    assert!(desk.stage.app.paused().is_none());
    let stop = |desk: &Desk| desk.stage.app.replay().unwrap().stop();
    let mut desk = Desk::new(crate::replay::stage(Theme::ASCII), NOW, "");
    for (words, at) in [
        ("tick|[ ] step", 1),
        ("tick|[ |] step", 2),
        ("{ |} anomaly", 3),
        ("in the end", 40),
        ("step  |{", 20),
    ] {
        desk.click(words);
        assert_eq!(stop(&desk), at, "{words}");
    }
    desk.click("space plays");
    assert!(desk.stage.app.replay().unwrap().is_playing());
    desk.click("REPLAY");
    assert!(!desk.stage.app.replay().unwrap().is_playing());
    desk.click("armL, line 31");
    assert!(desk.cursor().contains("armL"));
}

#[test]
fn links_heads_and_held_back_nodes_lead_to_their_places() {
    for (keys, words, place) in [
        ("", "links| nl-nr", "nl"),
        ("2l", "beat", "beat"),
        ("2l", "at armR@nr", "armR"),
        ("2l", "with |armL", "armL"),
        ("2l\n", "beat#8812", "beat"),
        ("2l\n", "of armL@nl", "armL"),
        ("2l\n", "now it waits at", "beat"),
    ] {
        let mut desk = busy(keys);
        desk.click(words);
        assert_eq!(desk.stage.app.screen, Screen::Overview, "{words}");
        assert!(desk.cursor().contains(place), "{words}: {}", desk.cursor());
    }
    let mut desk = busy("2");
    desk.click("port |1/3");
    assert!(desk.shown().contains("port 2/3"));
    let mut desk = busy("2");
    desk.click("served |28");
    assert_eq!(desk.stage.app.title(), Some("served"));
    // No task waits for the node whose scripts are held back.
    let mut alone = Stage::new(Theme::ASCII);
    alone.attach(ms(1_000), 2, 2);
    let tasks = vec![HeldTask { task: TaskId(2), remaining: Ticks(61_400_000) }];
    alone.frame(ms(1_000), 2, ServerFrame::HeldBack(HeldBack { mono_us: 5_000_000, tasks }));
    let mut desk = Desk::new(alone, NOW, "6");
    let row = desk.shown().lines().nth(1).unwrap().to_owned();
    assert!(row.starts_with(" nh "), "{row}");
    desk.press(10, 1);
    assert!(desk.cursor().contains("nh "), "{}", desk.cursor());
}

#[test]
fn what_stands_in_the_corners_of_lists_can_be_clicked() {
    let crowd = |keys: &str| Desk::new(Stage::crowd(Theme::ASCII), CROWD_NOW, keys);
    let mut desk = crowd("4");
    desk.click("each event");
    assert!(desk.shown().contains("1ms a row"));
    let lanes = |desk: &mut Desk| desk.shown().lines().find(|line| line.contains("TIME")).unwrap().to_owned();
    let before = lanes(&mut desk);
    let more = before.rsplit(' ').next().unwrap().to_owned();
    assert!(more.starts_with('>'), "{before}");
    desk.click(&more);
    assert_ne!(lanes(&mut desk), before);
    desk.click("1<");
    assert!(!lanes(&mut desk).contains("1<"));
    let mut desk = busy("6ak");
    desk.click("G follows");
    assert!(desk.stage.app.held.is_none());
    desk.click("every event");
    assert!(!desk.stage.app.everything);
    let mut desk = busy("s");
    desk.click("by slack");
    assert!(desk.shown().contains("by queue"));
    let mut desk = Desk::sized(Stage::busy(Theme::ASCII), NOW, (80, 9), "");
    desk.click("1/");
    assert!(!desk.shown().contains(" 1/1"), "the next page: {}", desk.shown());
}

/// In the help, a line is used as in a list: a click selects it, and a click on the selected line, or Enter, does what it
/// says on the screen that the help explains.
#[test]
fn what_the_help_names_can_be_used_there() {
    let mut desk = Desk::sized(Stage::busy(Theme::ASCII), NOW, (120, 200), "?");
    desk.click("sort by name");
    assert!(desk.cursor().contains("sort by name"));
    assert_eq!(desk.stage.app.screen, Screen::Help);
    desk.click("sort by name");
    assert_eq!((desk.stage.app.screen, desk.stage.app.shape.sort), (Screen::Overview, Sort::Slack));
    let used = |words: &str| {
        let mut desk = Desk::sized(Stage::busy(Theme::ASCII), NOW, (120, 200), "?");
        desk.click(words);
        desk.stage.key(NOW, KeyCode::Enter);
        desk
    };
    assert_eq!(used(":port").typed(), "port ");
    assert_eq!(used("remaining time of the most urgent message, or").stage.app.title(), Some("SLACK"));
    assert_eq!(used("next bad event").stage.app.screen, Screen::Events);
    assert_eq!(used("change this setting").stage.app.screen, Screen::Settings);
    assert!(used("KEYS EVERYWHERE").shown().contains("this row is of no key, command or column"));
    let mut desk = busy("?");
    desk.click("more lines");
    assert_eq!(desk.stage.app.scroll, 37);
}
