//! Code that the tests of the language share. The fuzz target `cell` uses `bytes.rs`, too.

pub mod bytes;

use imrs_language::Source;

pub fn source(text: &str) -> Source {
    Source::new(text.as_bytes()).expect("a text")
}
