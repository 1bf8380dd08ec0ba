//! No file makes the compiler panic: what parses is resolved, and what resolves is lowered.

use super::{BEAM_LIFT, WELD, source};
use imrs_language::{Options, Unit, compile, compile_with, lower, parse, resolve};
use proptest::prelude::*;

/// Runs all phases on a text.
fn all(text: &str) {
    let source = source(text);
    let _ = compile(&source);
    let _ = compile_with(&source, Options { paper: true });
    // Texts with syntax errors are tried, too: the parts that could be parsed must not make the compiler panic.
    let resolved = resolve(&parse(&source).file, source.text());
    for unit in [Unit::Microseconds, Unit::Ticks] {
        if let Ok(lowered) = lower(&resolved.hir, unit) {
            let _ = imrs_protocol::CellTable::new(lowered.cell);
        }
    }
}

/// The examples and the whole cells of the reference. Together these texts contain every statement.
fn texts() -> Vec<&'static str> {
    let pages = [
        include_str!("../../../specs/language/statements.md"),
        include_str!("../../../specs/language/ports.md"),
        include_str!("../../../specs/language/faults-and-checks.md"),
    ];
    let cells = pages.into_iter().flat_map(|page| page.split("```cell\n").skip(1));
    let cells = cells.filter_map(|rest| rest.split("```").next());
    [BEAM_LIFT, WELD].into_iter().chain(cells).collect()
}

/// The words, numbers and signs of a text.
fn tokens(text: &str) -> Vec<String> {
    let mut tokens: Vec<String> = Vec::new();
    for line in text.lines() {
        let line = line.split("//").next().unwrap_or_default();
        let mut word = String::new();
        for c in line.chars() {
            if c.is_alphanumeric() || c == '_' || c == '"' {
                word.push(c);
                continue;
            }
            if !word.is_empty() {
                tokens.push(std::mem::take(&mut word));
            }
            if !c.is_whitespace() {
                tokens.push(c.into());
            }
        }
        if !word.is_empty() {
            tokens.push(word);
        }
    }
    tokens
}

fn is_word(token: &str) -> bool {
    token.chars().all(|c| c.is_alphanumeric() || c == '_')
}

#[test]
fn the_longest_sum_is_no_deep_thing() {
    let text = |n| {
        let sum = " + x".repeat(n);
        let cell = "cell c; tick 1 msec; node n; task a on n var x: int32; begin";
        format!("{cell} x := x{sum}; end a; check c: never a.x > 0{};", " and true".repeat(n / 2))
    };
    assert_eq!(super::found(&text(250)), [""; 0]);
    let found = super::found(&text(100_000));
    assert!(found.iter().all(|found| found.starts_with("E012")) && !found.is_empty(), "{found:.100?}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, ..ProptestConfig::default() })]

    #[test]
    fn examples_with_words_exchanged(
        text in prop::sample::select(texts()),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>()), 1..12),
    ) {
        let mut tokens = tokens(text);
        let words: Vec<usize> = (0..tokens.len()).filter(|&at| is_word(&tokens[at])).collect();
        for (a, b) in changes {
            let (a, b) = (words[a.index(words.len())], words[b.index(words.len())]);
            tokens[a] = tokens[b].clone();
        }
        all(&tokens.join(" ").replace(". .", "..").replace(": =", ":=").replace("- -", "--").replace("- >", "->").replace("< >", "<>"));
    }

    #[test]
    fn examples_with_pieces_left_out(text in prop::sample::select(texts()), from: prop::sample::Index, length in 0_usize..40) {
        let at = from.index(text.len());
        let end = (at + length).min(text.len());
        if text.is_char_boundary(at) && text.is_char_boundary(end) {
            all(&format!("{}{}", &text[..at], &text[end..]));
        }
    }
}
