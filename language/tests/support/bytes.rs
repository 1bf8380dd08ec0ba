//! Checks properties that hold for any bytes; also the body of the fuzz target `cell`.

use imrs_language::lower::Behaviour;
use imrs_language::{Options, Source, Unit, compile_with, format, parse, render};

/// Parses, reports, compiles and formats these bytes, and checks the properties.
pub fn check(bytes: &[u8]) {
    let source = match Source::new(bytes) {
        Ok(source) => source,
        Err(found) => {
            let _ = render::text(&[*found], "a.cell", None, render::Style::Plain);
            return;
        }
    };
    let parsed = parse(&source);
    assert!(parsed.diagnostics.len() <= 101);
    for found in &parsed.diagnostics {
        for label in std::iter::once(&found.primary).chain(&found.secondary) {
            let inside = source.text().get(label.span.range()).is_some();
            assert!(inside, "{label:?} is not of a text of {} bytes", source.text().len());
        }
    }
    let shown = render::text(&parsed.diagnostics, "a.cell", Some(&source), render::Style::Plain);
    assert_eq!(shown.is_empty(), parsed.diagnostics.is_empty());
    if parsed.diagnostics.is_empty() {
        formats(&source);
    }
    // Names, types and times are checked even if only a part of the text could be parsed.
    [false, true].into_iter().for_each(|paper| compiles(&source, paper));
}

/// Compiles a text, and lowers it in both units. The lowered programs must pass the check of the script interpreter.
pub fn compiles(source: &Source, paper: bool) {
    let compiled = compile_with(source, Options { paper });
    for found in &compiled.diagnostics {
        for label in std::iter::once(&found.primary).chain(&found.secondary) {
            assert!(source.text().get(label.span.range()).is_some(), "{label:?}");
        }
    }
    for unit in [Unit::Microseconds, Unit::Ticks] {
        for task in compiled.lower(unit).iter().flat_map(|lowered| &lowered.tasks) {
            if let Behaviour::Script(script) = task {
                script.program.check().expect("a program");
                assert_eq!(script.spans.len(), script.program.code.len(), "a span for each operation");
            }
        }
    }
}

/// Checks that formatting changes no meaning and is idempotent.
pub fn formats(source: &Source) {
    let once = format(source).expect("no errors");
    let formatted = Source::new(once.as_bytes()).expect("a text");
    let parsed = parse(&formatted);
    assert_eq!(parsed.diagnostics, [], "of the formatted text:\n{once}");
    assert_eq!(plain(&parse(source).file), plain(&parsed.file), "{once}");
    assert_eq!(format(&formatted).expect("no errors"), once, "formatting again");
}

/// A syntax tree as text, without its spans.
pub fn plain(file: &imrs_language::ast::File) -> String {
    let shown = format!("{file:?}");
    let mut parts = shown.split("Span { start: ");
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        out.push_str(part.split_once('}').map_or(part, |(_, rest)| rest));
    }
    out
}
