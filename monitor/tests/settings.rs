//! Tests of the effects of the settings file: keys, columns and colours.

use crate::common::{Stage, ms, text};
use crossterm::event::KeyCode;
use imrs_monitor::app::{Effect, Screen, Setting};
use imrs_monitor::config::Config;
use imrs_monitor::theme::Theme;
use ratatui::style::Color;
use std::time::Duration;

const NOW: Duration = ms(1_150);

/// The busy cell with a settings file.
fn with(settings: &str, theme: Theme) -> Stage {
    let config = Config::parse(settings).unwrap();
    let mut stage = Stage::busy(theme.with(config.palette));
    stage.app.keymap = config.keys;
    stage.app.columns = config.columns.iter().map(|column| column.0.cell()).collect();
    stage
}

#[test]
fn own_keys_act_and_stand_in_help_and_hints() {
    let mut stage = with("keys.pause = [\"p\", \"f2\"]\nkeys.sort = \"o\"", Theme::ASCII);
    assert_eq!(stage.key(NOW, KeyCode::Char(' ')), Effect::Nothing);
    assert!(stage.app.paused().is_none());
    stage.keys(NOW, "p");
    assert!(stage.app.paused().is_some());
    stage.key(NOW, KeyCode::F(2));
    assert!(stage.app.paused().is_none());
    let foot = stage.text(NOW, 160, 40).lines().last().unwrap().to_owned();
    assert!(foot.contains("o sort") && !foot.contains("s sort"), "{foot}");
    stage.keys(NOW, "?");
    let help = stage.text(NOW, 120, 150);
    assert!(help.lines().any(|line| line.contains("p F2") && line.contains("pause this screen")), "{help}");
}

#[test]
fn the_columns_are_those_of_the_settings_where_they_have_room() {
    let titles = |settings: &str, width| {
        let shown = text(&with(settings, Theme::ASCII).draw(NOW, width, 30));
        let line = shown.lines().find(|line| line.contains("NODE/TASK/PORT")).unwrap().to_owned();
        line.split_whitespace().map(str::to_owned).collect::<Vec<_>>()
    };
    let few = "columns = [\"health\", \"timed_out\", \"queue\"]";
    assert_eq!(titles(few, 120), ["NODE/TASK/PORT", "HEALTH", "T/O", "QUEUE"]);
    let many = "columns = [\"state\", \"rate\", \"expired\", \"overflow\", \"rejected\", \"resent\", \"timed_out\", \"health\"]";
    assert_eq!(titles(many, 200).len(), 9);
    let shown = titles(many, 64);
    assert!(shown.len() > 2 && shown.len() < 9 && shown[1] == "STATE", "{shown:?}");
    // The values are below their titles.
    let shown = text(&with(few, Theme::ASCII).draw(NOW, 120, 30));
    let row = shown.lines().find(|line| line.contains("beat") && line.contains("3/8")).unwrap();
    let head = shown.lines().find(|line| line.contains("NODE/TASK/PORT")).unwrap();
    assert_eq!(row.find("3/8"), head.find("QUEUE"), "{shown}");
}

#[test]
fn own_colours_are_drawn_and_survive_a_change_of_theme() {
    let own = Color::Rgb(1, 2, 3);
    let mut stage = with("palette.dim = \"#010203\"", Theme::COLOUR);
    let has = |stage: &Stage| stage.buffer(NOW, 120, 40).content.iter().any(|cell| cell.fg == own);
    assert!(has(&stage));
    assert_eq!(stage.key(NOW, KeyCode::Char('t')), Effect::Theme, "the main loop remembers it");
    assert!(stage.app.theme.name == "light" && has(&stage));
    stage.keys(NOW, ":theme mono\n");
    assert!(!has(&stage));
    stage.keys(NOW, ":theme contrast\n");
    assert!(has(&stage));
}

/// Every line of the settings window changes a setting, by the keyboard and by the mouse, and the screen behind the
/// window stays.
#[test]
fn the_window_of_settings_changes_each_of_them() {
    for theme in [Theme::COLOUR, Theme::ASCII] {
        let mut stage = Stage::busy(theme);
        stage.typed(NOW, (120, 40), "6o");
        let shown = text(&stage.draw(NOW, 120, 40));
        assert!(shown.contains("settings: Enter changes") && shown.contains("expired_on_the_way"), "{shown}");
        assert!(theme != Theme::ASCII || shown.is_ascii());
        for (at, setting) in Setting::ALL.into_iter().enumerate() {
            let before = stage.app.setting(setting);
            let effect = stage.key(NOW, KeyCode::Enter);
            match setting {
                Setting::Theme => assert_eq!(effect, Effect::Theme),
                Setting::Mouse => assert_eq!(effect, Effect::Mouse(false)),
                // Without a mark there is no start to count from, so a mark is set first.
                Setting::SinceMark => drop(stage.key(NOW, KeyCode::Enter)),
                _ => assert_eq!(effect, Effect::Draw),
            }
            assert_ne!(stage.app.setting(setting), before, "{setting:?}");
            let shown = text(&stage.draw(NOW, 120, 40));
            let cursor = shown.lines().filter(|line| line.contains('>') && line.contains(setting.about().0));
            assert_eq!(cursor.count(), 1, "{at}: {shown}");
            stage.keys(NOW, "j");
        }
        stage.key(NOW, KeyCode::Esc);
        assert_eq!(stage.app.screen, Screen::Events);
    }
    for size in [(40, 12), (20, 5), (3, 3), (1, 1)] {
        Stage::busy(Theme::COLOUR).typed(NOW, size, "ojj\n");
    }
}
