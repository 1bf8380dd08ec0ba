//! The tests of the language as one program: each folder beside this file is a module of it.

mod meaning;
mod reference;
mod support;
mod text;
