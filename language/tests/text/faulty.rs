//! The findings about faulty texts. Each file in `tests/faulty` is such a text; its findings are recorded in a file beside
//! it.

use super::{codes, rendered, source};
use imrs_language::{parse, render};
use std::path::Path;

#[test]
fn faulty_texts_are_reported_as_recorded() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faulty");
    let mut texts: Vec<_> = std::fs::read_dir(folder)
        .expect("the folder of faulty texts")
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "cell"))
        .collect();
    texts.sort();
    assert!(texts.len() >= 25, "only {} faulty texts", texts.len());
    let mut settings = insta::Settings::clone_current();
    settings.set_snapshot_path("../faulty");
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    let _bound = settings.bind_to_scope();
    let mut surprising = Vec::new();
    for path in texts {
        let text = std::fs::read_to_string(&path).expect("a text");
        let name = path.file_stem().and_then(|name| name.to_str()).expect("a name").to_owned();
        // The first line of the text lists its errors.
        let first = text.lines().next().unwrap_or_default();
        let expected: Vec<&str> = first.trim_start_matches("// ").split(' ').collect();
        if codes(&text) != expected {
            surprising.push(format!("{name}:\n{}", rendered(&text)));
            continue;
        }
        insta::assert_snapshot!(name, rendered(&text));
    }
    assert!(surprising.is_empty(), "{}", surprising.join("\n"));
}

/// Ten different errors (syntax, names, types, behaviour, times): each is reported on its line, and causes no other
/// finding.
#[test]
fn ten_different_errors_are_ten_diagnostics() {
    let text = include_str!("ten.cell");
    let said = |line: &str| line.split_once("// wrong: ").map(|(_, code)| code.to_owned());
    let wrong = text.lines().enumerate().filter_map(|(at, line)| Some((at + 1, said(line)?)));
    let wrong: Vec<(usize, String)> = wrong.collect();
    let source = source(text);
    let compiled = imrs_language::compile(&source);
    let place = |found: &imrs_language::Diagnostic| {
        (source.position(found.primary.span.start).0, found.code.to_owned())
    };
    let found: Vec<(usize, String)> = compiled.diagnostics.iter().map(place).collect();
    assert_eq!(found, wrong);
    let mut codes: Vec<&str> = wrong.iter().map(|(_, code)| &code[..]).collect();
    codes.sort_unstable();
    codes.dedup();
    assert_eq!(codes.len(), 10, "{codes:?}");
    let of = |kind: &str| codes.iter().filter(|code| code.starts_with(kind)).count();
    assert_eq!((of("E0"), of("E1"), of("E2")), (3, 4, 3));
    let unchecked = compiled.unchecked.expect("what was not checked");
    assert!(unchecked.contains("names") && unchecked.contains("times"), "{unchecked}");
}

#[test]
fn programs_get_lines_and_columns() {
    let text = "cell c;\nnode \"ä\" x;\n";
    let source = source(text);
    let found = parse(&source).diagnostics;
    let located = render::located(&found, "a.cell", Some(&source));
    let [label] = &located[0].labels[..] else { panic!("{located:?}") };
    assert_eq!((label.start.line, label.start.column, label.start.byte), (2, 6, 13));
    assert_eq!((label.end.line, label.end.column, label.end.byte), (2, 9, 17));
}

#[test]
fn colours_are_the_callers_choice() {
    let source = source("cell 1;");
    let found = parse(&source).diagnostics;
    let plain = render::text(&found, "a.cell", Some(&source), render::Style::Plain);
    let coloured = render::text(&found, "a.cell", Some(&source), render::Style::Coloured);
    assert!(!plain.contains('\x1b') && coloured.contains('\x1b'), "{plain}{coloured}");
}

#[test]
fn bytes_that_are_no_text_are_one_error() {
    let found = imrs_language::Source::new(b"cell c;\n\xff\xfe").expect_err("no text");
    assert_eq!(found.code, "E013");
    assert!(found.message.contains("byte 8 (line 2)"), "{}", found.message);
    let shown = render::text(&[*found], "a.cell", None, render::Style::Plain);
    assert!(shown.contains("a.cell"), "{shown}");
}

/// A type of another language gets a diagnostic that names the type to write.
#[test]
fn types_of_other_languages_are_explained() {
    let types = [
        ("int", "int16"),
        ("DINT", "int32"),
        ("uint8", "word"),
        ("float", "real"),
        ("double", "real"),
        ("boolean", "bool"),
        ("string", "number"),
        ("array", "record"),
        ("robtarget", "record"),
        ("duration", "delay"),
        ("TON", "start"),
        ("mutex", "owns"),
        ("uint8_t", "word"),
        ("enum", "numbers"),
        ("signaldi", "driver"),
        ("event", "handler"),
    ];
    for (other, ours) in types {
        let text = format!(
            "cell c;\ntick 1 msec;\nnode n;\ntask t on n\n  var x: {other};\nbegin\n  run look takes 1 msec;\nend t;\n"
        );
        let compiled = imrs_language::compile(&source(&text));
        let [found] = &compiled.diagnostics[..] else { panic!("{other}: {:?}", compiled.diagnostics) };
        assert_eq!(found.code, "E102", "{other}");
        assert!(found.help[0].contains(ours) && found.help.len() == 1, "{other}: {:?}", found.help);
    }
}
