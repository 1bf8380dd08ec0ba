//! Recordings for other tools: lines of JSON for scripts, MCAP for Foxglove and PlotJuggler, a sequence chart as SVG, the
//! screen as an asciicast.

mod asciicast;
mod chart;
mod jsonl;
mod mcap;

use crate::replay::{Film, Player, Scene};
use crate::source::Arrival;
use crate::store::Store;
use std::io::{self, Seek, Write};
use std::sync::Arc;
use thiserror::Error;

/// The form of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A line of JSON for everything that came.
    Jsonl,
    /// A file that Foxglove and PlotJuggler open.
    Mcap,
    /// A sequence chart.
    Svg,
    /// The monitor's screen, for players of asciicasts.
    Asciicast,
}

/// What is exported, and how.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// The form.
    pub form: Form,
    /// Of an asciicast: columns and rows.
    pub size: (u16, u16),
    /// Of an asciicast: the keys that are pressed before it begins, as on the keyboard.
    pub keys: String,
    /// Of an asciicast: frames a second, at most.
    pub frames: u16,
    /// Of a chart: how many things it shows at most, the last ones.
    pub most: usize,
}

impl Wanted {
    /// What one gets who says nothing more.
    #[must_use]
    pub const fn new(form: Form) -> Self {
        Self { form, size: (120, 40), keys: String::new(), frames: 10, most: 400 }
    }
}

/// Why an export failed.
#[derive(Debug, Error)]
pub enum ExportError {
    /// It cannot be written.
    #[error("cannot be written: {0}")]
    Io(#[from] io::Error),
    /// The form could not be made.
    #[error("cannot be made: {0}")]
    Mcap(#[from] ::mcap::McapError),
    /// The recording has nothing of what is wanted.
    #[error("the recording has no {0}")]
    Nothing(&'static str),
}

/// What an export has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exported {
    /// Lines, messages, marks or frames.
    pub count: usize,
    /// What they are.
    pub what: &'static str,
}

/// Exports a recording.
///
/// # Errors
/// [`ExportError`].
pub fn export(film: &Arc<Film>, wanted: &Wanted, out: impl Write + Seek) -> Result<Exported, ExportError> {
    match wanted.form {
        Form::Jsonl => jsonl::write(film, out),
        Form::Mcap => mcap::write(film, out),
        Form::Svg => chart::write(film, wanted.most, out),
        Form::Asciicast => asciicast::write(Player::new(Arc::clone(film), 1.0), wanted, out),
    }
}

/// Goes through a recording frame by frame: what is known after each, and what came.
fn each_frame<E>(film: &Film, mut each: impl FnMut(&Store, &Arrival) -> Result<(), E>) -> Result<(), E> {
    let mut store = Store::default();
    for number in 0..film.frames() {
        if let Scene::Arrival(arrival) = film.scene(number) {
            store.apply(arrival.clone());
            each(&store, &arrival)?;
        }
    }
    Ok(())
}
