//! The help: made from the table of keys, so that it cannot be wrong.

use super::pen::Pen;
use crate::app::App;
use crate::keys::BINDINGS;
use crate::theme::Ink;

pub(super) fn draw(app: &App, pen: &mut Pen<'_>) {
    let lines = lines(app, pen.area.width);
    let room = usize::from(pen.height());
    let first = app.scroll.min(lines.len().saturating_sub(1));
    for (y, (left, right, ink)) in (0..).zip(lines.iter().skip(first).take(room)) {
        pen.at(1, y, 14, left, if *ink == Ink::Head { Ink::Head } else { Ink::Plain });
        pen.at(16, y, u16::MAX, right, *ink);
    }
}

/// Left, right, and how the right looks.
pub(super) fn lines(app: &App, _width: u16) -> Vec<(String, String, Ink)> {
    let mut lines = vec![heading("KEYS")];
    for binding in BINDINGS {
        let on: Vec<_> = binding.on.iter().map(|screen| format!("{screen:?}").to_lowercase()).collect();
        let on = if on.is_empty() { String::new() } else { format!("  ({})", on.join(", ")) };
        lines.push((binding.label(), format!("{}{on}", binding.help), Ink::Plain));
    }
    let glyphs = app.theme.glyphs;
    lines.push(heading("SIGNS"));
    let mut sign = |sign: &str, text: &str, ink| lines.push((sign.to_owned(), text.to_owned(), ink));
    sign(glyphs.selected, "the row that keys act on", Ink::Plain);
    sign(&format!("{} {}", glyphs.open, glyphs.closed), "rows within are shown, hidden", Ink::Plain);
    sign(glyphs.dead, "dead: the last state is kept", Ink::Dim);
    sign("?", "never seen by this monitor, or not known", Ink::Dim);
    sign("!", "look at this soon", Ink::Warn);
    sign("!!", "look at this now", Ink::Bad);
    sign("~", "an estimate: the sample is older than two periods", Ink::Plain);
    sign(&format!("{} {}", glyphs.full, glyphs.empty), "left, gone", Ink::Bar);
    sign(
        &format!("{} {}", glyphs.yes, glyphs.no),
        "knows of the arrival, does not (row of column)",
        Ink::Plain,
    );
    lines.push(heading("COLUMNS"));
    let mut column = |name: &str, text: &str| lines.push((name.to_owned(), text.to_owned(), Ink::Plain));
    column("QUEUE", "messages waiting / space; of a waitfor: arrived / members");
    column("SLACK", "what is left of the most urgent message, or of the wait");
    column("MSG/s", "sent and served by this end, over the last seconds");
    column("EXP", "messages whose life ended here");
    column("OVF", "messages refused or evicted for space");
    column("REJ", "messages the task rejected by rank");
    column("CONFIRMS", "confirmations this member holds from others");
    lines
}

fn heading(text: &str) -> (String, String, Ink) {
    (text.to_owned(), String::new(), Ink::Head)
}
