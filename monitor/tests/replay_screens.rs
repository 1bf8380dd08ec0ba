//! Tests of the screens of a recording: how they look, and what a click hits.

use crate::common::{Stage, ms, styles, text};
use crate::replay::stage;
use crossterm::event::{KeyModifiers, MouseButton, MouseEvent, MouseEventKind};
use imrs_monitor::app::Msg;
use imrs_monitor::replay::Trouble;
use imrs_monitor::theme::Theme;

#[test]
fn recordings_look_as_recorded() {
    let scenes =
        [("replay_lost", "}"), ("replay_end", "}}}"), ("replay_events", "6}}a"), ("replay_start", "")];
    for (name, keys) in scenes {
        for (width, height) in [(40, 12), (64, 20), (80, 24), (120, 40), (200, 60)] {
            let mut all = String::new();
            for theme in [Theme::COLOUR, Theme::MONO, Theme::ASCII] {
                let mut stage = stage(theme);
                stage.typed(ms(0), (width, height), keys);
                let buffer = stage.buffer(ms(0), width, height);
                all += &format!("=== {}\n{}--- styles\n{}", theme.name, text(&buffer), styles(&buffer));
            }
            insta::with_settings!({ prepend_module_to_snapshot => false, omit_expression => true }, {
                insta::assert_snapshot!(format!("{name}_{width}x{height}"), all);
            });
        }
    }
}

/// The panel of a finding takes rows from the overview, and a click below it selects nothing.
#[test]
fn clicks_hit_what_is_drawn_beside_a_finding() {
    let click = |stage: &mut Stage, row: usize| {
        let kind = MouseEventKind::Down(MouseButton::Left);
        let row = u16::try_from(row).unwrap();
        stage
            .app
            .update(Msg::Mouse(MouseEvent { kind, column: 10, row, modifiers: KeyModifiers::NONE }), ms(0));
    };
    let mut stage = stage(Theme::ASCII);
    let shown = stage.typed(ms(0), (80, 15), "G");
    let rows: Vec<_> = shown.lines().collect();
    let selected = |shown: &str| shown.lines().position(|line| line.starts_with('>'));
    let last = selected(&shown).unwrap();
    assert!(last > 3, "the list is on its last page: {shown}");
    click(&mut stage, last - 1);
    let shown = text(&stage.draw(ms(0), 80, 15));
    let name = rows[last - 1].split_whitespace().next().unwrap();
    assert!(shown.lines().nth(selected(&shown).unwrap()).unwrap().contains(name), "{name}: {shown}");
    // A click or a key shows the next lines of the panel. After the last lines the first ones come again.
    let panel = rows.iter().position(|row| row.contains("lines more: p")).unwrap();
    let told = |shown: &str| shown.lines().skip(panel - 1).take(1).map(str::to_owned).collect::<Vec<_>>();
    let mut seen = told(&shown);
    let mut pages = 1;
    loop {
        if pages % 2 == 0 {
            stage.keys(ms(0), "p");
        } else {
            click(&mut stage, panel);
        }
        let next = told(&text(&stage.draw(ms(0), 80, 15)));
        if next == seen[..1] {
            break;
        }
        seen.extend(next);
        pages += 1;
    }
    let all = seen.join("\n");
    for part in
        ["step 0 of 40", "SEND #4 of armL leaves for nr", "in the end: waits in vain", "armL, line 31: waits"]
    {
        assert!(all.contains(part), "{pages} pages: {all}");
    }
}

/// A click on the bar of a recording moves to that place, as during a pause.
#[test]
fn a_click_on_the_bar_moves_in_a_recording() {
    let mut stage = stage(Theme::ASCII);
    let bar = |stage: &mut Stage| {
        let shown = text(&stage.draw(ms(0), 100, 24));
        let row = shown.lines().position(|line| line.contains("{ } trouble")).expect("a bar");
        (row, shown.lines().nth(row).unwrap().chars().collect::<Vec<_>>())
    };
    let place = |line: &[char], sign: char| line.iter().position(|c| *c == sign).unwrap();
    let click = |stage: &mut Stage, row: usize, column: usize| {
        let kind = MouseEventKind::Down(MouseButton::Left);
        let at = MouseEvent { kind, column: column as u16, row: row as u16, modifiers: KeyModifiers::NONE };
        stage.app.update(Msg::Mouse(at), ms(0));
    };
    let stop = |stage: &Stage| stage.app.replay().unwrap().stop();
    let (row, line) = bar(&mut stage);
    let (start, end, trouble) = (place(&line, '[') + 1, place(&line, ']') - 1, place(&line, '!'));
    assert_eq!((stop(&stage), place(&line, '#')), (0, start), "{line:?}");
    click(&mut stage, row, trouble);
    let odd = stop(&stage);
    assert!(
        odd > 0 && stage.app.replay().unwrap().film().stops()[odd].trouble == Trouble::Grave,
        "{odd}: {line:?}"
    );
    assert_eq!(place(&bar(&mut stage).1, '#'), trouble);
    click(&mut stage, row, end);
    assert!(stage.app.replay().unwrap().is_at_end());
    assert_eq!(place(&bar(&mut stage).1, '#'), end);
    click(&mut stage, row, start);
    assert_eq!(stop(&stage), 0);
}

#[test]
fn no_size_of_a_recording_panics() {
    for keys in ["", "}}}", "3", "2", "6", "?"] {
        let mut stage = stage(Theme::COLOUR);
        stage.keys(ms(0), keys);
        for width in [0, 1, 5, 39, 60, 100] {
            for height in 0..16 {
                let _ = stage.buffer(ms(0), width, height);
            }
        }
    }
}
