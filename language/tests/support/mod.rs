//! What the tests of the language share; the fuzz target `cell` shares `bytes.rs`.

pub mod bytes;

use imrs_language::Source;

pub fn source(text: &str) -> Source {
    Source::new(text.as_bytes()).expect("a text")
}
