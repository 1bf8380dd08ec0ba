//! The monitor: a terminal dashboard for running nodes. It must be correct, be readable at a glance, and never disturb
//! the nodes.
//!
//! A [`source`] speaks `imrs-obs` with nodes in its own threads and feeds a [`store`]. The store keeps the state of
//! every node, the last state of dead nodes, and the events. An [`app`] is the screen as a value: [`app::App::update`]
//! applies messages to it, and [`view::view`] draws it. Store, app and view read no clock and no file; time is always
//! an argument. The thread that draws does no other work. Only the outermost layer ([`run`]) uses a terminal.
//!
//! Pausing, filtering and sorting happen only in the monitor: no user action changes what a node does.
#![forbid(unsafe_code)]

pub mod app;
mod background;
mod checked;
pub mod clock;
pub mod column;
pub mod config;
mod conformance;
mod drawn;
mod error;
pub mod export;
pub mod history;
pub mod judge;
mod keeper;
pub mod keymap;
pub mod keys;
pub mod name;
mod options;
mod plain;
pub mod problems;
pub mod query;
pub mod record;
pub mod replay;
pub mod report;
pub mod rows;
mod screen;
mod signals;
pub mod source;
pub mod specimen;
pub mod store;
mod terminal;
pub mod theme;
pub mod typed;
mod ui;
mod verdicts;
pub mod view;

pub use checked::Checked;
pub use error::MonitorError;
pub use options::{ColorChoice, Endpoint, EndpointError, Format, Options, Verdict};
pub use plain::Watch;
pub use replay::At;

use clock::Clock;
use imrs_wire::obs::place;
use imrs_wire::recording::Status;
use record::{Recorded, Tape};
use replay::{Film, Player};
use source::Memory;
use source::live::{Live, Which};
use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
use theme::Theme;

/// The file that the record key writes if the user gave no name.
const RECORDING: &str = "monitor.imrs";

/// Runs the monitor with these options: on the screen of a terminal or, without a terminal, as printed output.
///
/// # Errors
/// [`MonitorError`], which has the exit code of the command.
pub fn run(options: &Options) -> Result<Verdict, MonitorError> {
    let screen = io::stdout().is_terminal() && io::stdin().is_terminal();
    let printed = options.once
        || options.watch.is_some()
        || options.text
        || !options.assertions.is_empty()
        || options.format == Format::Json;
    let headless = (options.length.is_some() && options.record.is_some()) || !screen;
    if let Some(path) = options.record.as_ref().filter(|_| headless) {
        return plain::record(options, path, which(options), &mut io::stdout().lock());
    }
    if let Some(path) = &options.replay {
        let player = Player::new(Arc::new(Film::open(path)?), options.speed.unwrap_or(1.0));
        if !screen || printed {
            return plain::replay(options, player, &mut io::stdout().lock());
        }
        return replay_on_screen(options, player);
    }
    if !screen || printed {
        // Without a terminal no key could end a screen. So one sample is printed, unless the options ask for more.
        let once = options.once || !printed;
        return print(&Options { once, ..options.clone() }, &mut io::stdout().lock());
    }
    let which = which(options);
    if let Which::Under(base) = &which
        && place::sockets_in(base)?.is_empty()
    {
        return Err(MonitorError::NothingFound { looked: Some(base.clone()), failed: Vec::new() });
    }
    let theme = first_theme(options);
    let (clock, tape) = (Clock::start(), Arc::new(Tape::default()));
    let mut app = app(options, theme);
    if let Some(path) = &options.record {
        record::free(path, options.force)?;
        tape.start(path, clock.now())?;
        app.recording = Some(name::shown_line(&path.display().to_string()));
    }
    let file = options.record.clone().unwrap_or_else(|| RECORDING.into());
    let files = ui::Files { record: file, lines: options.lines.clone() };
    let shown = ui::show(live(options, which, &tape), clock, app, &tape, files, options.judge.clone());
    let recorded = tape.stop();
    shown?;
    match recorded {
        Some(Recorded { path, status: Status { failure: Some(why), .. } }) => {
            Err(MonitorError::Recording { path, why })
        }
        Some(_) | None => Ok(Verdict::Healthy),
    }
}

/// A counterexample starts paused; a recording of running nodes starts playing.
fn replay_on_screen(options: &Options, mut player: Player) -> Result<Verdict, MonitorError> {
    let clock = Clock::start();
    match options.at {
        Some(at) => player.seek(at),
        None if player.film().story.is_none() => player.toggle(clock.now()),
        None => {}
    }
    let theme = first_theme(options);
    let app = app(options, theme).replaying(player);
    let files = ui::Files { record: RECORDING.into(), lines: options.lines.clone() };
    ui::show(Memory::default(), clock, app, &Arc::default(), files, None)?;
    Ok(Verdict::Healthy)
}

/// The screen's state at the start, for these options.
fn app(options: &Options, theme: Theme) -> app::App {
    let theme = options.theme.unwrap_or(theme).with(options.palette);
    let mut app = app::App::new(theme, options.cell.clone());
    app.keymap = options.keys.clone();
    app.columns = options.columns.iter().map(|column| column.cell()).collect();
    app.token = options.token.clone();
    // If the user gives a theme in each run, the monitor need not store it.
    app.remember = options.remember.clone().filter(|_| options.theme.is_none());
    if let Some(path) = &options.lines {
        match typed::load(path) {
            Ok(typed) => app.remember_typed(typed),
            Err(error) => {
                let path = name::shown_line(&path.display().to_string());
                app.told = Some(format!("earlier typed lines are not known: {error}: {path}"));
            }
        }
    }
    app.mouse = options.mouse;
    app.reduced_motion = options.reduced_motion;
    app.shape.filter = options.filter.clone().unwrap_or_default();
    app
}

/// Prints to `out` the output for which `options` ask, without a screen.
///
/// # Errors
/// [`MonitorError`]. A reader that closes the pipe is no error.
pub fn print(options: &Options, out: &mut impl Write) -> Result<Verdict, MonitorError> {
    plain::print(options, which(options), Clock::start(), out)
}

/// A source for the nodes that `options` name, with the subscription of the recorder `tape`.
fn live(options: &Options, which: Which, tape: &Tape) -> Live {
    Live::new(which).with_token(options.token.clone()).with_wishes(tape.wishes())
}

fn which(options: &Options) -> Which {
    if options.connect.is_empty() {
        Which::Under(options.base.clone().unwrap_or_else(place::base_dir))
    } else {
        Which::Named(options.connect.clone())
    }
}

/// The theme at the start: the one that the user chose last, if the terminal can show it, otherwise the one that suits
/// the terminal.
fn first_theme(options: &Options) -> Theme {
    let var = |name: &str| std::env::var(name).ok();
    if let Some(theme) = options.theme {
        return theme;
    }
    let chosen = options.remember.as_deref().and_then(config::remembered);
    // If there is a stored theme, the answer of the terminal would change nothing.
    let ask = || if chosen.is_some() { None } else { background::is_light() };
    let fitting = theme_for(options, var, ask);
    chosen.filter(|chosen| chosen.needs_no_more_than(&fitting)).unwrap_or(fitting)
}

/// The theme for the options and the environment variables that `var` returns. `is_light` asks the terminal for its
/// background, and is called only if the answer matters.
fn theme_for(
    options: &Options,
    var: impl Fn(&str) -> Option<String>,
    is_light: impl FnOnce() -> Option<bool>,
) -> Theme {
    let set = |name: &str| var(name).filter(|value| !value.is_empty());
    let dumb = set("TERM").is_none_or(|term| term == "dumb");
    let colour = match options.color {
        ColorChoice::Always => true,
        ColorChoice::Never => false,
        ColorChoice::Auto => set("NO_COLOR").is_none() && !dumb,
    };
    // The first of these variables that is set decides, as in the C library.
    let locale = set("LC_ALL").or_else(|| set("LC_CTYPE")).or_else(|| set("LANG")).unwrap_or_default();
    let locale = locale.to_lowercase();
    let utf8 = locale.contains("utf-8") || locale.contains("utf8");
    // Some terminals give the colours of their text and background in this variable, as numbers among the first sixteen
    // colours: `15;0`.
    let background = set("COLORFGBG").and_then(|colours| colours.rsplit(';').next()?.parse::<u8>().ok());
    let utf8 = utf8 && !options.ascii && !dumb;
    let light = match background {
        Some(background) => matches!(background, 7 | 9..=15),
        None => colour && utf8 && is_light().unwrap_or(false),
    };
    Theme::fitting(colour, utf8, light)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_theme_follows_the_environment_and_the_options() {
        let theme = |options: &Options, vars: &[(&str, &str)]| {
            let var = |name: &str| vars.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned());
            theme_for(options, var, || None)
        };
        let utf8 = [("TERM", "xterm"), ("LANG", "en_US.UTF-8")];
        let auto = Options::default();
        assert_eq!(theme(&auto, &utf8), Theme::COLOUR);
        assert_eq!(theme(&auto, &[utf8[0], utf8[1], ("NO_COLOR", "1")]), Theme::MONO);
        assert_eq!(theme(&auto, &[utf8[0], utf8[1], ("NO_COLOR", "")]), Theme::COLOUR);
        assert_eq!(theme(&auto, &[utf8[0], utf8[1], ("LC_ALL", "C")]), Theme::COLOUR_ASCII);
        assert_eq!(theme(&auto, &[("TERM", "dumb")]), Theme::ASCII);
        for (colours, fits) in [
            ("0;15", Theme::LIGHT),
            ("0;default;15", Theme::LIGHT),
            ("0;7", Theme::LIGHT),
            ("15;0", Theme::COLOUR),
            ("12;8", Theme::COLOUR),
            ("15;default", Theme::COLOUR),
        ] {
            assert_eq!(theme(&auto, &[utf8[0], utf8[1], ("COLORFGBG", colours)]), fits, "{colours}");
        }
        assert_eq!(theme(&auto, &[utf8[0], ("COLORFGBG", "0;15")]), Theme::ASCII);
        // The terminal is asked only if no variable gives its background, and if the answer matters.
        let asked = |options: &Options, vars: &[(&str, &str)], says| {
            let var = |name: &str| vars.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned());
            let mut is_asked = false;
            let theme = theme_for(options, var, || {
                is_asked = true;
                says
            });
            (theme, is_asked)
        };
        assert_eq!(asked(&auto, &utf8, Some(true)), (Theme::LIGHT, true));
        assert_eq!(asked(&auto, &utf8, Some(false)), (Theme::COLOUR, true));
        assert_eq!(asked(&auto, &utf8, None), (Theme::COLOUR, true));
        let known = [utf8[0], utf8[1], ("COLORFGBG", "15;0")];
        assert_eq!(asked(&auto, &known, Some(true)), (Theme::COLOUR, false));
        let none = [utf8[0], utf8[1], ("NO_COLOR", "1")];
        assert_eq!(asked(&auto, &none, Some(true)), (Theme::MONO, false));
        assert_eq!(asked(&auto, &[("TERM", "dumb")], Some(true)), (Theme::ASCII, false));
        let never = Options { color: ColorChoice::Never, ascii: true, ..Options::default() };
        assert_eq!(theme(&never, &utf8), Theme::ASCII);
        let always = Options { color: ColorChoice::Always, ..Options::default() };
        assert_eq!(theme(&always, &[utf8[0], utf8[1], ("NO_COLOR", "1")]), Theme::COLOUR);
    }
}
