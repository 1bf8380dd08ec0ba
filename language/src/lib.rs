//! The compiler of the cell language: it turns the text of a cell file into checked declarations and task scripts of
//! [`imrs_protocol`]. A cell file declares nodes, links, tasks and ports, and what each task does.
//!
//! ```text
//!   text --lexer--> tokens --parser--> ast --resolve--> cell with names --checks--> diagnostics
//!                     |                                       |
//!                  formatter                                lower --> Cell, Programs, checks (in any unit of time)
//! ```
//!
//! The crate reads no files: the caller passes the text (D56). No input makes it panic.
//!
//! ```
//! use imrs_language::{Source, format, parse, render};
//!
//! let source = Source::new(b"cell two;\nnode a\nnode b;\n")?;
//! let parsed = parse(&source);
//! assert_eq!(parsed.file.items.len(), 2);
//! let shown = render::text(&parsed.diagnostics, "two.cell", Some(&source), render::Style::Plain);
//! assert!(shown.starts_with("error[E006]: expected `;`, found `node`\n --> two.cell:2:6"), "{shown}");
//!
//! let mended = Source::new(b"cell two; NODE a;   node b;")?;
//! assert_eq!(format(&mended).as_deref(), Ok("cell two; node a; node b;\n"));
//! # Ok::<(), Box<imrs_language::Diagnostic>>(())
//! ```

#![forbid(unsafe_code)]

pub mod ast;
mod checks;
pub mod codes;
mod compile;
mod diagnostic;
mod foreign;
mod format;
pub mod hir;
mod lexer;
pub mod load;
mod lost;
pub mod lower;
mod names;
mod parser;
pub mod render;
mod report;
mod resolve;
mod source;
mod span;
mod walk;
mod words;

pub use compile::{Compiled, Options, compile, compile_with};
pub use diagnostic::{Diagnostic, Label, Severity};
pub use format::format;
pub use lower::{Lowered, Unit, lower, table_errors};
pub use parser::{Parsed, parse};
pub use resolve::{Resolved, resolve};
pub use source::{LONGEST_FILE, Source};
pub use span::Span;
pub use words::Word;
