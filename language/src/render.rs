//! Renders diagnostics, as text for people and as data for programs.

use crate::diagnostic::{Diagnostic, Label, Severity};
use crate::source::Source;
use crate::span::Span;
use annotate_snippets::{Annotation, AnnotationKind, Group, Level, Origin, Renderer, Snippet};
use serde::Serialize;

/// Whether the rendered text has colours. The caller decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// ANSI colours.
    Coloured,
    /// Text without colours.
    Plain,
}

/// Lines with more bytes than this are not shown.
const LONGEST_LINE: usize = 2000;

/// The diagnostics as text, with the lines of the file at which they point. `file` is the name shown for the file. If
/// the file is not text, `source` is `None`, and no lines are shown.
#[must_use]
pub fn text(diagnostics: &[Diagnostic], file: &str, source: Option<&Source>, style: Style) -> String {
    let renderer = match style {
        Style::Coloured => Renderer::styled(),
        Style::Plain => Renderer::plain(),
    };
    let mut out = String::new();
    for found in diagnostics {
        if !out.is_empty() {
            out.push('\n');
        }
        out.push_str(&renderer.render(&[group(found, file, source)]));
        out.push('\n');
    }
    out
}

fn group<'a>(found: &'a Diagnostic, file: &'a str, source: Option<&'a Source>) -> Group<'a> {
    let level = match found.severity {
        Severity::Error => Level::ERROR,
        Severity::Warning => Level::WARNING.with_name("warn"),
        Severity::Note => Level::NOTE,
    };
    let title = level.primary_title(&found.message).id(found.code);
    let group = match source.and_then(|source| Some((source, window(found, source)?))) {
        Some((source, window)) => title.element(snippet(found, file, source, window)),
        None => title.element(origin(found, file, source)),
    };
    group.elements(found.help.iter().map(|help| Level::HELP.message(help)))
}

/// The whole lines of all labels; `None` if one of the lines is too long.
fn window(found: &Diagnostic, source: &Source) -> Option<Span> {
    let all = labels(found).map(|(label, _)| label.span).reduce(Span::to)?;
    let text = source.text();
    let start = text.get(..all.start as usize)?.rfind('\n').map_or(0, |at| at + 1);
    let rest = text.get(all.end as usize..)?;
    let end = all.end as usize + rest.find('\n').unwrap_or(rest.len());
    let long = labels(found).any(|(label, _)| {
        let at = label.span.start as usize;
        let begin = text[..at].rfind('\n').map_or(0, |at| at + 1);
        let end = text[at..].find('\n').map_or(text.len(), |length| at + length);
        end - begin > LONGEST_LINE
    });
    (!long).then(|| Span::new(start, end))
}

fn snippet<'a>(
    found: &'a Diagnostic,
    file: &'a str,
    source: &'a Source,
    window: Span,
) -> Snippet<'a, Annotation<'a>> {
    let annotations = labels(found).map(|(label, is_primary)| {
        let kind = if is_primary { AnnotationKind::Primary } else { AnnotationKind::Context };
        let (start, end) = (label.span.start - window.start, label.span.end - window.start);
        let annotation = kind.span(start as usize..end as usize);
        if label.text.is_empty() { annotation } else { annotation.label(&label.text) }
    });
    Snippet::source(source.slice(window))
        .path(file)
        .line_start(source.line(window.start))
        .annotations(annotations.collect::<Vec<_>>())
}

fn origin<'a>(found: &Diagnostic, file: &'a str, source: Option<&Source>) -> Origin<'a> {
    let origin = Origin::path(file);
    match source {
        Some(source) => {
            let (line, column) = source.position(found.primary.span.start);
            origin.line(line).char_column(column)
        }
        None => origin,
    }
}

/// The labels, and whether each is the primary one.
fn labels(found: &Diagnostic) -> impl Iterator<Item = (&Label, bool)> {
    std::iter::once((&found.primary, true)).chain(found.secondary.iter().map(|label| (label, false)))
}

/// A diagnostic with its file, lines and columns: what `--format json` prints.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Located<'a> {
    /// The code, such as `E005`.
    pub code: &'a str,
    /// The diagnostic's severity.
    pub severity: Severity,
    /// What is wrong, in one line.
    pub message: &'a str,
    /// The name of the file.
    pub file: &'a str,
    /// The diagnostic's labels; the primary one is the first.
    pub labels: Vec<LocatedLabel<'a>>,
    /// What to write instead.
    pub help: &'a [String],
}

/// A label with lines and columns.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LocatedLabel<'a> {
    /// The label's text; may be empty.
    pub text: &'a str,
    /// The label's first character.
    pub start: Position,
    /// The position behind the label's last character.
    pub end: Position,
}

/// A place in a text.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Position {
    /// The byte, from 0.
    pub byte: u32,
    /// The line, from 1.
    pub line: usize,
    /// The position in the line, in characters, from 1.
    pub column: usize,
}

/// The diagnostics in a form that programs can read, ready to be serialised.
#[must_use]
pub fn located<'a>(
    diagnostics: &'a [Diagnostic],
    file: &'a str,
    source: Option<&Source>,
) -> Vec<Located<'a>> {
    let position = |byte| {
        let (line, column) = source.map_or((1, 1), |source| source.position(byte));
        Position { byte, line, column }
    };
    let label = |(label, _): (&'a Label, bool)| LocatedLabel {
        text: &label.text,
        start: position(label.span.start),
        end: position(label.span.end),
    };
    let one = |found: &'a Diagnostic| Located {
        code: found.code,
        severity: found.severity,
        message: &found.message,
        file,
        labels: labels(found).map(label).collect(),
        help: &found.help,
    };
    diagnostics.iter().map(one).collect()
}
