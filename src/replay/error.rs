//! Errors that keep a recording from being replayed.

use imrs_runtime::record;
use imrs_wire::files::FileError;
use std::path::PathBuf;

/// Why a recording cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The file cannot be opened.
    #[error("{path}: {source}")]
    Open {
        /// The file.
        path: PathBuf,
        /// Why.
        source: FileError,
    },
    /// The file is not a recording, or it is damaged.
    #[error("{path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: record::ReplayError,
    },
    /// No cell was given, and no built-in demo has the recording's cell.
    #[error(
        "{path} is of cell `{cell}` (digest {digest:08x}), which is not that of a demo as it is built in: name its file with --cell"
    )]
    OtherCell {
        /// The file.
        path: PathBuf,
        /// The name of the cell.
        cell: String,
        /// The digest of its table.
        digest: u32,
    },
    /// The recording was made from another text of the cell.
    #[error(
        "{path} was made from another text of cell `{cell}` than {given}: its {what} have digest {recorded:08x}, those of the \
         file have {now:08x}. Replay it with the text that was run"
    )]
    OtherText {
        /// The recording.
        path: PathBuf,
        /// The name of the cell.
        cell: String,
        /// The given cell file, or the name of the built-in demos.
        given: String,
        /// What differs: the declarations, or only the statements of the node.
        what: &'static str,
        /// Its digest in the recording.
        recorded: u32,
        /// Its digest in the file.
        now: u32,
    },
    /// The recording is of a cell other than the given one.
    #[error(
        "{path} is a recording of cell `{cell}` (digest {recorded:08x}), and {given} is cell `{other}` (digest {now:08x})"
    )]
    NotThisCell {
        /// The recording.
        path: PathBuf,
        /// The name of its cell.
        cell: String,
        /// The given file.
        given: String,
        /// The name of the cell in it.
        other: String,
        /// The digest in the recording.
        recorded: u32,
        /// The digest of the given cell.
        now: u32,
    },
    /// The recording holds what a monitor saw, not inputs.
    #[error(
        "{0} shows nodes as a monitor saw them, and has no inputs to run again: look at it with `imrs monitor --replay {0}`"
    )]
    Observations(PathBuf),
    /// The recording names a node that its cell does not have.
    #[error("{0} holds no inputs of a node of its cell")]
    NoInputs(PathBuf),
}
