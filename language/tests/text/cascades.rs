//! Tests that each fault is reported once, and that the report says what to write instead.

use imrs_language::codes::ALL;
use imrs_language::{Diagnostic, Options, Severity, Source, compile_with, parse};
use std::path::Path;

const NEXT: u64 = 6_364_136_223_846_793_005;

/// The errors that are reported for a text.
fn errors(text: &str, paper: bool) -> Vec<Diagnostic> {
    match Source::new(text.as_bytes()) {
        Ok(source) => {
            let found = compile_with(&source, Options { paper }).diagnostics;
            found.into_iter().filter(|found| found.severity == Severity::Error).collect()
        }
        Err(found) => vec![*found],
    }
}

/// The cells in `examples`, with their paths.
fn examples() -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples");
    let entries = std::fs::read_dir(folder).expect("the examples").flatten();
    let cells =
        entries.map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|end| end == "cell"));
    let mut cells: Vec<_> = cells
        .map(|path| (path.display().to_string(), std::fs::read_to_string(path).expect("a cell")))
        .collect();
    cells.sort();
    assert!(cells.len() >= 6);
    cells
}

/// The offsets of words, numbers and signs, without comments.
fn tokens(text: &str) -> Vec<(usize, usize)> {
    let (bytes, mut tokens, mut at) = (text.as_bytes(), Vec::new(), 0);
    let word = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_';
    while at < bytes.len() {
        let begin = at;
        if text[at..].starts_with("//") {
            at = text[at..].find('\n').map_or(bytes.len(), |length| at + length);
        } else if text[at..].starts_with("(*") {
            at = text[at..].find("*)").map_or(bytes.len(), |length| at + length + 2);
        } else if bytes[at].is_ascii_whitespace() {
            at += 1;
        } else {
            let two =
                ["--", "->", ":=", "..", "<>", "<=", ">="].iter().any(|sign| text[at..].starts_with(sign));
            at += match bytes[at] {
                b'"' => text[at + 1..].find('"').map_or(1, |length| length + 2),
                byte if word(byte) => bytes[at..].iter().take_while(|byte| word(**byte)).count(),
                _ if two => 2,
                _ => 1,
            };
            tokens.push((begin, at));
        }
    }
    tokens
}

/// The text with one token dropped, doubled, misspelt, or replaced by another one.
fn mutated(text: &str, tokens: &[(usize, usize)], seed: &mut u64) -> String {
    let mut draw = |below: usize| {
        *seed = seed.wrapping_mul(NEXT).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 33) as usize % below
    };
    let (begin, end) = tokens[draw(tokens.len())];
    let token = &text[begin..end];
    let other = match draw(4) {
        0 => String::new(),
        1 => format!("{token} {token}"),
        2 => {
            let (begin, end) = tokens[draw(tokens.len())];
            text[begin..end].to_owned()
        }
        _ => format!("{}q{}", &token[..token.len().div_ceil(2)], &token[token.len().div_ceil(2)..]),
    };
    format!("{}{other}{}", &text[..begin], &text[end..])
}

/// If one word of a file is wrong, the compiler reports few errors: nearly always at most three. It reports more only if
/// the word is in a declaration that other parts of the file need.
#[test]
fn one_wrong_word_is_few_errors() {
    let (mut seed, mut number, mut many, mut one, mut mute) = (7, 0, Vec::new(), 0, Vec::new());
    for (name, text) in examples() {
        let tokens = tokens(&text);
        for _ in 0..200 {
            let mutant = mutated(&text, &tokens, &mut seed);
            let found = errors(&mutant, false);
            let source = Source::new(mutant.as_bytes()).expect("a text");
            let shown = |found: &Diagnostic| {
                format!(
                    "{} line {}: {}",
                    found.code,
                    source.position(found.primary.span.start).0,
                    found.message
                )
            };
            mute.extend(found.iter().filter(|found| found.help.is_empty()).map(shown));
            number += usize::from(!found.is_empty());
            one += usize::from(found.len() == 1);
            if found.len() > 3 {
                let changed = mutant.lines().zip(text.lines()).position(|(a, b)| a != b).unwrap_or_default();
                let line = mutant.lines().nth(changed).unwrap_or_default();
                let all: Vec<String> = found.iter().map(shown).collect();
                many.push(format!("{name}:{}: {line}\n  {}", changed + 1, all.join("\n  ")));
            }
        }
    }
    assert!(mute.is_empty(), "without help: {mute:#?}");
    assert!(number >= 600, "only {number} mutants have an error");
    println!("{number} with errors, {one} with one, {} with more than three", many.len());
    assert!(one * 100 >= number * MOSTLY_ONE, "one error: {one} of {number}");
    assert!(many.len() * 100 <= number * SELDOM_MORE, "{} of {number}:\n{}", many.len(), many.join("\n"));
}

/// The least percentage of the faulty mutants that have exactly one error.
const MOSTLY_ONE: usize = 85;
/// The greatest percentage of the faulty mutants that may have more than three errors.
const SELDOM_MORE: usize = 1;

/// The wrong example of each page gives one finding in all phases together, and the finding says what to write.
#[test]
fn each_wrong_example_is_one_finding() {
    let mut surprising = Vec::new();
    for entry in ALL {
        for text in entry.explanation.split("```cell,wrong\n").skip(1) {
            let text = text.split("```").next().unwrap_or_default();
            let source = Source::new(text.as_bytes()).expect("a text");
            let all = compile_with(&source, Options { paper: entry.code == "E117" }).diagnostics;
            let codes: Vec<&str> = all.iter().map(|found| found.code).collect();
            if codes != [entry.code] {
                surprising.push(format!("{}: {codes:?}\n{text}", entry.code));
            }
            let silent = all.iter().filter(|found| found.help.is_empty() && found.severity != Severity::Note);
            surprising.extend(silent.map(|found| format!("{}: no help: {}", found.code, found.message)));
        }
    }
    assert!(surprising.is_empty(), "{}", surprising.join("\n"));
}

/// Every error of the recorded faulty texts says what to write.
#[test]
fn every_error_says_what_to_write() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faulty");
    let mut texts = 0;
    for path in std::fs::read_dir(folder).expect("the faulty texts").flatten().map(|entry| entry.path()) {
        if path.extension().is_none_or(|end| end != "cell") {
            continue;
        }
        texts += 1;
        let text = std::fs::read_to_string(&path).expect("a text");
        let source = Source::new(text.as_bytes()).expect("a text");
        let found = parse(&source).diagnostics.into_iter().chain(errors(&text, false));
        let mute: Vec<String> =
            found.filter(|found| found.help.is_empty()).map(|found| found.message).collect();
        assert!(mute.is_empty(), "{}: {mute:?}", path.display());
    }
    assert!(texts >= 25);
}

/// These faults were once reported twice, in different words.
#[test]
fn a_fault_of_a_declaration_is_not_one_of_its_uses() {
    let codes = |text: &str| errors(text, false).iter().map(|found| found.code).collect::<Vec<_>>().join(" ");
    let head = "cell c; tick 1 msec; node na; node nb; link na -- nb delay 1 msec;";
    let pose = |fields: &str| {
        format!(
        "{head} type Pose is record {fields} end;
        task a on na port p(q: Pose) usage = send user_list = {{b}} time_out = 50 msec; var q: Pose;
        begin loop q.x := 1; q.y := 2; send p(q); delay 9 msec; end; end a;
        task b on nb use_port p(q: Pose) usage = receive; var q: Pose; begin loop receive p(q); run go q.x, q.y; end; end b;"
    )
    };
    assert_eq!(codes(&pose("x: int16; y: int16;")), "");
    assert_eq!(codes(&pose("x: int16; y: int17;")), "E102");
    assert_eq!(codes(&pose("x: int16; y: Pose;")), "E112");
    assert_eq!(codes(&pose("x: int16; y: timer;")), "E112");
    assert_eq!(codes(&pose("x: int16; : int16;")), "E005");
    let port = |option: &str, second: &str| {
        format!(
        "{head} task a on na port p(n: int8) usage = send user_list = {{b}} time_out = 50 msec {option};
        begin loop send p(1) on time_out do skip; end on refused do skip; end; end; end a;
        task b on nb use_port p(n: int8) usage = receive; {second} var n: int8; begin loop receive p(n); reply(); end; end b;"
    )
    };
    assert_eq!(codes(&port("class = 2", "")), "");
    assert_eq!(codes(&port("class = 3", "")), "E111");
    let both = port("class = 2", "").replace(
        "use_port p(n: int8) usage = receive;",
        "port p(n: int8) usage = receive user_list = {a} time_out = 50 msec;",
    );
    assert_eq!(codes(&both), "E103");
    // If a name is misspelt in a list, or in a `use_port`, the other end of the port is not reported, too.
    assert_eq!(codes(&port("class = 2", "").replace("{b}", "{bb}")), "E102");
    assert_eq!(codes(&port("class = 2", "").replace("use_port p(", "use_port pp(")), "E102");
    assert_eq!(
        codes(&port("class = 2", "").replace("time_out = 50 msec class = 2;", "time_out = ;;")),
        "E005"
    );
}
