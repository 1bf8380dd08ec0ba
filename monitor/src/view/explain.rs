//! The page about a finding's code: what it means, when it is raised, what to do. `imrs explain` prints the same page.

use super::canvas::{Canvas, columns};
use crate::app::App;
use crate::store::health::codes;
use crate::theme::Ink;

pub(super) fn draw(app: &App, canvas: &mut Canvas<'_>) {
    let Some(lint) = app.explained().and_then(codes::find) else {
        canvas.line(0, &[(" No code was chosen.", Ink::Dim)]);
        return;
    };
    let width = canvas.area.width.saturating_sub(2).min(100);
    // A terminal without UTF-8 cannot show this character. The pages have no other such character.
    let text = lint.explanation.replace('§', "section ");
    let lines = wrapped(&text, width);
    let room = usize::from(canvas.height());
    let (window, selected) = canvas.chosen(app.scroll, room, vec![None; lines.len()]);
    let canvas = &mut canvas.beside_scrollbar(0, window);
    for (y, (at, line)) in (0..).zip(lines.iter().enumerate().skip(window.first).take(room)) {
        let (text, ink) =
            line.strip_prefix("# ").map_or((line.as_str(), Ink::Plain), |title| (title, Ink::Head));
        canvas.at(1, y, u16::MAX, text, ink);
        canvas.line_of(y, at, selected);
    }
}

/// A Markdown text in lines of at most `width` columns. Lines of one paragraph are joined, except for code blocks.
fn wrapped(text: &str, width: u16) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    let (mut is_code, mut joins) = (false, false);
    for line in text.lines() {
        if line.starts_with("```") {
            is_code = !is_code;
            joins = false;
            continue;
        }
        if is_code || line.trim().is_empty() {
            lines.push(line.to_owned());
            joins = false;
            continue;
        }
        if !joins || line.starts_with(['#', '-']) {
            lines.push(String::new());
        }
        joins = !line.starts_with('#');
        for word in line.split_whitespace() {
            let last = lines.last_mut().expect("a line was begun");
            if last.is_empty() {
                last.push_str(word);
            } else if columns(last).saturating_add(columns(word)) < width {
                last.push(' ');
                last.push_str(word);
            } else {
                lines.push(word.to_owned());
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paragraphs_are_joined_and_cut_at_words() {
        let text = "# code: title\n\nA first line\nand a second one.\n\n```sh\nimrs  run\n```\n";
        let expected = ["# code: title", "", "A first line", "and a second", "one.", "", "imrs  run"];
        assert_eq!(wrapped(text, 14), expected);
        assert_eq!(wrapped("averyveryverylongword x", 5), ["averyveryverylongword", "x"]);
    }
}
