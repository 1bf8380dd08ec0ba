//! Exports the monitor's screen during a recording as an asciicast (version 2): timed terminal output.

use super::{ExportError, Exported, Wanted};
use crate::app::{App, Msg};
use crate::name::shown;
use crate::replay::Player;
use crate::theme::Theme;
use crate::view;
use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use imrs_wire::text;
use ratatui::backend::CrosstermBackend;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::prelude::Backend as _;
use serde_json::json;
use std::io::Write;
use std::time::Duration;

/// How long a step of a counterexample is shown.
const STEP: Duration = Duration::from_secs(1);
/// How long the last frame is shown.
const END: Duration = Duration::from_secs(2);

pub(super) fn write(player: Player, wanted: &Wanted, mut out: impl Write) -> Result<Exported, ExportError> {
    // Colours are forced, because the file is for another terminal than that of this program.
    crossterm::style::force_color_output(true);
    let (width, height) = wanted.size;
    let title = format!("imrs monitor: {}", shown(&player.film().cell));
    let header = json!({"version": 2, "width": width, "height": height, "title": title});
    writeln!(out, "{header}")?;
    let steps = player.film().story.is_some();
    let mut app = App::new(Theme::COLOUR, None).replaying(player);
    for key in wanted.keys.chars() {
        view::show(&mut app, Duration::ZERO, &mut Buffer::empty(Rect::new(0, 0, width, height)));
        let code = if key == '\n' { KeyCode::Enter } else { KeyCode::Char(key) };
        app.update(Msg::Key(KeyEvent::new(code, KeyModifiers::NONE)), Duration::ZERO);
    }
    let apart = Duration::from_secs(1) / u32::from(wanted.frames.max(1));
    let mut screen = Screen { before: Buffer::empty(Rect::new(0, 0, width, height)), first: true };
    let (mut count, mut next) = (0, Duration::ZERO);
    let stops = app.replay().map_or(0, |player| player.film().stops().len());
    let mut end = Duration::ZERO;
    for stop in 0..stops {
        let at = if steps {
            STEP * u32::try_from(stop).unwrap_or(u32::MAX)
        } else {
            app.replay().map_or(Duration::ZERO, |player| player.film().stops()[stop].at)
        };
        end = at;
        // Several changes between two frames appear together in the later frame.
        if at < next && stop + 1 < stops {
            continue;
        }
        next = at + apart;
        app.show_stop(stop);
        if let Some(bytes) = screen.draw(&app)? {
            let drawn = String::from_utf8_lossy(&bytes);
            writeln!(out, "{}", text::json(&json!([at.as_secs_f64(), "o", drawn]).to_string()))?;
            count += 1;
        }
    }
    writeln!(out, "{}", json!([(end + END).as_secs_f64(), "o", "\u{1b}[0m"]))?;
    out.flush()?;
    Ok(Exported { count, what: "frames" })
}

struct Screen {
    before: Buffer,
    first: bool,
}

impl Screen {
    /// The terminal output that updates the screen; `None` if nothing changed.
    fn draw(&mut self, app: &App) -> Result<Option<Vec<u8>>, ExportError> {
        let mut now = Buffer::empty(self.before.area);
        view::view(app, Duration::ZERO, now.area, &mut now);
        let changed = self.before.diff(&now);
        if changed.is_empty() && !self.first {
            return Ok(None);
        }
        let mut bytes =
            if std::mem::take(&mut self.first) { b"\x1b[2J\x1b[H\x1b[?25l".to_vec() } else { Vec::new() };
        CrosstermBackend::new(&mut bytes).draw(changed.into_iter())?;
        self.before = now;
        Ok(Some(bytes))
    }
}
