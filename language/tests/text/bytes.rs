//! Tests on any bytes: the compiler does not panic, its findings are few and within the text, and formatting is idempotent
//! and changes no meaning.

use super::{BEAM_LIFT, PAPER, WELD};
use proptest::prelude::*;

use crate::support::bytes::check;

/// A text of keywords and signs in any order.
fn soup() -> impl Strategy<Value = String> {
    let words: Vec<&'static str> = imrs_language::Word::RESERVED
        .iter()
        .chain(imrs_language::Word::FREE)
        .map(|word| word.text())
        .chain([
            ";", ";", ";", ":", ":=", "(", ")", "{", "}", "[", "]", "->", "<->", "--", "=", "<", "+", "-",
            "*", "/", ".", "..", ",", "a", "b", "12", "1.5", "3x", "\"t\"", "\"", "'q'", "// c\n", "(* c *)",
            "(*", "\n", "§",
        ])
        .collect();
    let words = proptest::collection::vec(proptest::sample::select(words), 0..60);
    words.prop_map(|words| words.join(" "))
}

/// An example with a few pieces replaced by copies of others.
fn mutated() -> impl Strategy<Value = Vec<u8>> {
    let text = proptest::sample::select(vec![BEAM_LIFT, WELD, PAPER]);
    let change = (any::<prop::sample::Index>(), 0..12_usize, any::<prop::sample::Index>(), 0..12_usize);
    (text, proptest::collection::vec(change, 1..6)).prop_map(|(text, changes)| {
        let mut bytes = text.as_bytes().to_vec();
        for (at, length, from, copied) in changes {
            let at = at.index(bytes.len());
            let end = (at + length).min(bytes.len());
            let from = from.index(text.len());
            let piece = text.as_bytes()[from..(from + copied).min(text.len())].to_vec();
            bytes.splice(at..end, piece);
        }
        bytes
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn random_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        check(&bytes);
    }

    #[test]
    fn random_words(text in soup()) {
        check(text.as_bytes());
        check(format!("cell c; task t on n begin {text} end t;").as_bytes());
        check(format!("cell c; task t on n {text} begin end t;").as_bytes());
    }

    #[test]
    fn mutated_examples(bytes in mutated()) {
        check(&bytes);
    }
}
