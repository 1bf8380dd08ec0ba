//! Recordings as files, and the thread that writes them.

mod form;
mod rig;
mod shown;
mod thread;
