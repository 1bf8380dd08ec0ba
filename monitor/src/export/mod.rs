//! Exports recordings for other tools: lines of JSON for scripts, MCAP for Foxglove and PlotJuggler, a sequence chart
//! as SVG, and the screen as an asciicast.

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

/// The format of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Lines of JSON, one per state or event.
    Jsonl,
    /// MCAP, for Foxglove and PlotJuggler.
    Mcap,
    /// A sequence chart as SVG.
    Svg,
    /// The monitor's screen, for asciicast players.
    Asciicast,
}

/// The options of an export.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// The format of the export.
    pub form: Form,
    /// For an asciicast: columns and rows.
    pub size: (u16, u16),
    /// For an asciicast: the keys that are pressed at the start; `\n` is Enter.
    pub keys: String,
    /// For an asciicast: the greatest number of frames per second.
    pub frames: u16,
    /// For a chart: the greatest number of marks that it shows; the newest marks are kept.
    pub most: usize,
}

impl Wanted {
    /// The default options for a format.
    #[must_use]
    pub const fn new(form: Form) -> Self {
        Self { form, size: (120, 40), keys: String::new(), frames: 10, most: 400 }
    }
}

/// Why an export failed.
#[derive(Debug, Error)]
pub enum ExportError {
    /// The export cannot be written.
    #[error("cannot be written: {0}")]
    Io(#[from] io::Error),
    /// The encoding as MCAP failed.
    #[error("cannot be made: {0}")]
    Mcap(#[from] ::mcap::McapError),
    /// The recording lacks the data that the format requires.
    #[error("the recording has no {0}")]
    Nothing(&'static str),
}

/// What an export contains, for a message to the user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exported {
    /// How many units the export contains.
    pub count: usize,
    /// The word for the counted units: lines, messages, marks or frames.
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

/// Calls `each` for every frame of a recording, with the store after it.
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
