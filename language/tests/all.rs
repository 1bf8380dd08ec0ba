//! The tests of the language, one program: each file and folder of tests beside this one is a module of it.

mod meaning;
mod reference;
mod support;
mod text;
