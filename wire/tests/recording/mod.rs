//! Tests of recordings: the file format, and the thread that writes it.

mod form;
mod rig;
mod shown;
mod thread;
