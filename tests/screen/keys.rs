//! Tests of the monitor's keys, each in a run of the monitor of its own.

use super::terminal::{Terminal, tmux_is_here, watched};
use crate::support::live::Live;
use crate::support::tape::frames;
use crate::support::{run, run_in, wait_until};
use imrs_wire::obs::ServerFrame;

#[test]
fn each_screen_opens_by_its_key() {
    let Some((_demo, terminal)) = watched("") else { return };
    let screens: [(&str, &str, &[&str]); 9] = [
        ("2", "[2 Port]", &["buffer", "since start"]),
        ("3", "[3 Rdv]", &["lift", "WAITS FOR", "hoist"]),
        ("4", "[4 Time]", &["armL", "armR", "each event"]),
        ("5", "[5 Timers]", &["OWNER", "Timer:"]),
        ("6", "[6 Events]", &["AGO", "DETAIL"]),
        ("8", "[8 Prob]", &["PLACE", "CODE"]),
        ("7", "[7 Model]", &["transition kinds seen", "never:"]),
        ("?", "KEYS: model", &["KEYS EVERYWHERE", "quit"]),
        ("1", "[1 Over]", &["NODE/TASK/PORT", "hoist"]),
    ];
    for (key, title, words) in screens {
        let is_there =
            |screen: &str| screen.contains(title) && words.iter().all(|word| screen.contains(word));
        terminal.keys(&[key]);
        terminal.wait_for(title, is_there);
    }
    terminal.leave();
}

#[test]
fn a_filter_a_mark_a_pause_and_a_theme_are_seen() {
    let Some((_demo, terminal)) = watched("") else { return };
    let rows = |screen: &str, word: &str| screen.lines().any(|line| line.contains(word));

    terminal.keys(&["/"]);
    terminal.keys(&["-l", "halt"]);
    terminal.keys(&["Enter"]);
    terminal.wait_for("only ports of that name", |s| rows(s, "halt ") && !rows(s, "beat "));
    terminal.keys(&["Escape"]);
    terminal.wait_for("all ports again", |s| rows(s, "halt ") && rows(s, "beat "));

    terminal.press(&["m"], "marked at");
    terminal.press(&["d"], "counters since the mark");
    terminal.keys(&["d"]);
    terminal.wait_for("the counters since the start", |s| !s.contains("counters since the mark"));

    terminal.press(&["Space"], "PAUSED");
    let before = terminal.press(&["["], "PAUSED");
    assert!(rows(&before, "hoist"), "a step back shows nothing:\n{before}");
    terminal.press(&["End"], "hoist");
    terminal.keys(&["Space"]);
    terminal.wait_for("the present", |s| s.contains("LIVE") && !s.contains("PAUSED"));

    // The fourth theme has no colours, and the first theme follows the last.
    assert!(terminal.has_colour());
    terminal.keys(&["t", "t", "t"]);
    terminal.wait_for("no colours", |_| !terminal.has_colour());
    terminal.keys(&["t", "t", "t"]);
    terminal.wait_for("the first theme again", |_| terminal.has_colour());
    terminal.leave();
}

/// The first clicks, before any resize, hit a tab and a row.
#[test]
fn clicks_hit_what_the_terminal_shows() {
    let Some((_demo, terminal)) = watched("") else { return };
    terminal
        .click("6 Events", "the events", |screen| screen.contains("[6 Events]") && screen.contains("DETAIL"));
    let is_row_of_hoist = |line: &str| line.contains("hoist  ");
    terminal.click("1 Over", "the overview", |screen| {
        screen.contains("[1 Over]") && screen.lines().any(is_row_of_hoist)
    });
    // The banner may name the hoist, too, but with its node.
    terminal.click("hoist  ", "the selected row", |screen| {
        screen.lines().any(|line| line.starts_with('>') && is_row_of_hoist(line))
    });
    terminal.leave();
}

#[test]
fn commands_are_typed_and_unknown_ones_told() {
    let Some((_demo, terminal)) = watched("") else { return };
    let command = |text: &str, shows: &str| {
        terminal.keys(&[":"]);
        terminal.keys(&["-l", text]);
        terminal.press(&["Enter"], shows)
    };
    command("fly", "no such command");
    command("theme nonsense", "no such theme");
    command("connect nowhere", "names no endpoint");
    command("port nothing", "no port nothing");
    command("port halt", "[2 Port]");
    command("node nh", "[1 Over]");
    command("quit", "ended: 0");
    terminal.assert_restored();
}

/// A terminal that answers OSC 11 says whether its background is light, and the theme fits that.
#[test]
fn the_theme_fits_the_background_that_the_terminal_names() {
    if !tmux_is_here() {
        return;
    }
    let demo = Live::steady();
    let terminal = Terminal::open(demo.dir());
    for (background, theme) in [("#f8f8f0", "light"), ("#101418", "colour")] {
        terminal.tmux(&["set-option", "-g", "window-style", &format!("bg={background}")]);
        // By the name that tmux gives itself, the monitor does not ask: GNU screen has the same, and does not answer.
        terminal.start_monitor("COLORFGBG= TERM=tmux-256color");
        let settings = terminal.press(&["o"], "how the screen looks");
        let line = settings.lines().find(|line| line.contains("how the screen looks")).expect("a line");
        assert!(line.contains(&format!(" {theme} ")), "{background}: {line}");
        terminal.press(&["Escape"], "[1 Over]");
        terminal.leave();
    }
}

/// What was typed in one run comes back in the next one; a file that is not the monitor's is reported and costs nothing.
#[test]
fn typed_lines_outlast_the_monitor() {
    let Some((demo, terminal)) = watched("") else { return };
    let file = demo.dir().join("state/imrs/monitor-lines");
    terminal.keys(&["-l", ":port halt"]);
    terminal.press(&["Enter"], "[2 Port]");
    terminal.leave();
    assert_eq!(std::fs::read_to_string(&file).expect("the lines"), ":port halt\n");
    terminal.start_monitor("");
    terminal.keys(&[":"]);
    terminal.press(&["Up"], ":port halt");
    terminal.press(&["Enter"], "[2 Port]");
    terminal.leave();
    std::fs::write(&file, "no lines").expect("the file");
    terminal.type_monitor("", "");
    let reason = "earlier typed lines are not known: line 1 is neither a filter nor a command";
    terminal.wait_for("the reason", |screen| screen.contains(reason));
    terminal.wait_for("the cell", |screen| screen.contains("beat "));
    terminal.keys(&["-l", ":port beat"]);
    terminal.press(&["Enter"], "[2 Port]");
    terminal.leave();
    assert_eq!(std::fs::read_to_string(&file).expect("the lines"), ":port beat\n");
}

/// The theme that the user chose in one run is that of the next one.
#[test]
fn a_chosen_theme_outlasts_the_monitor() {
    let Some((_demo, terminal)) = watched("") else { return };
    assert!(terminal.has_colour());
    for (name, has_colour) in [("mono", false), ("contrast", true)] {
        terminal.keys(&["-l", &format!(":theme {name}")]);
        terminal.keys(&["Enter"]);
        terminal.wait_for("the theme", |_| terminal.has_colour() == has_colour);
        terminal.leave();
        terminal.start_monitor("");
        let screen = terminal.press(&["o"], "how the screen looks; remembered");
        assert!(screen.lines().any(|line| line.contains(&format!("{name} "))), "{name}:\n{screen}");
        assert_eq!(terminal.has_colour(), has_colour, "{name}");
        terminal.keys(&["Escape"]);
        terminal.wait_for("no window", |screen| !screen.contains("how the screen looks"));
    }
    terminal.leave();
}

#[test]
fn a_screen_is_written_as_text_and_a_recording_exported() {
    if !tmux_is_here() {
        return;
    }
    let demo = Live::steady();
    let terminal = Terminal::open(demo.dir());
    let folder = demo.dir().display().to_string();
    terminal.keys(&[&format!("cd {folder}; clear"), "Enter"]);
    terminal.start_monitor("");
    let files = |ending: &str| -> Vec<String> {
        let all = std::fs::read_dir(&folder).expect("the folder").map(|file| file.expect("a file").path());
        let all = all.map(|path| path.to_str().expect("UTF-8").to_owned());
        all.filter(|path| path.ends_with(ending)).collect()
    };
    terminal.press(&["w"], ".txt");
    let [written] = &files(".txt")[..] else { panic!("{:?}", files(".txt")) };
    let text = std::fs::read_to_string(written).expect("the screen");
    assert!(text.contains("armL") && !text.contains('\u{1b}'), "{text}");

    let before = files(".imrs");
    terminal.press(&["r"], " REC ");
    let recorded: Vec<String> = files(".imrs").into_iter().filter(|file| !before.contains(file)).collect();
    let [recorded] = &recorded[..] else { panic!("{recorded:?}") };
    wait_until("states of all nodes and events are recorded", || {
        let has = |source, is_so: fn(&ServerFrame) -> bool| {
            frames(recorded.as_ref()).iter().any(|(of, _, frame)| *of == source && is_so(frame))
        };
        let is_state =
            |frame: &ServerFrame| matches!(frame, ServerFrame::Snapshot(_) | ServerFrame::Delta(_));
        let is_event = |frame: &ServerFrame| matches!(frame, ServerFrame::Events(_));
        (0..3).all(|source| has(source, is_state) && has(source, is_event))
    });
    terminal.keys(&["r"]);
    terminal.wait_for("the end of the recording", |screen| !screen.contains(" REC "));
    terminal.leave();
    let replayed = run(&["monitor", "--replay", recorded, "--once", "--format", "json"]);
    assert_eq!(replayed.last_json()["nodes"].as_array().map(Vec::len), Some(3), "{replayed:?}");
    for (form, begin) in
        [("jsonl", &b"{"[..]), ("mcap", b"\x89MCAP0\r\n"), ("svg", b"<svg"), ("asciicast", b"{")]
    {
        let out = format!("{folder}/exported.{form}");
        let said = run_in(demo.dir(), &["export", recorded, "--to", form, "--out", &out]);
        assert_eq!(said.code, Some(0), "{said:?}");
        let bytes = std::fs::read(&out).expect("the export");
        // The length of the file varies. Its tasks do not, because the test has waited for events of every node.
        let text = String::from_utf8_lossy(&bytes);
        assert!(bytes.starts_with(begin) && text.contains("armL"), "{form}: {text}");
    }
}
