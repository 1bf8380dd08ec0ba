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
        /// The recording that could not be opened.
        path: PathBuf,
        /// Why the file cannot be opened.
        source: FileError,
    },
    /// The file is not a recording, or it is damaged.
    #[error("{path}: {source}")]
    Read {
        /// The recording that could not be read.
        path: PathBuf,
        /// Where the file is damaged, and how.
        source: record::ReplayError,
    },
    /// The user named no cell, and no built-in demo has the recording's cell.
    #[error(
        "{path} is of cell `{cell}` (digest {digest:08x}), which is not that of a demo as it is built in: name its file with --cell"
    )]
    OtherCell {
        /// The recording of another cell.
        path: PathBuf,
        /// The name of the recording's cell.
        cell: String,
        /// The digest of the table of the recording's cell.
        digest: u32,
    },
    /// The recording was made with another text of the same cell.
    #[error(
        "{path} was made from another text of cell `{cell}` than {given}: its {what} have digest {recorded:08x}, those of the \
         file have {now:08x}. Replay it with the text that was run"
    )]
    OtherText {
        /// The recording that was made with another text of the cell.
        path: PathBuf,
        /// The name of the cell.
        cell: String,
        /// The cell file that the user named, or the name of the built-in demos.
        given: String,
        /// What differs between the two texts: the declarations, or only the statements of the node.
        what: &'static str,
        /// The digest of the differing part in the recording.
        recorded: u32,
        /// The digest of the differing part in the file.
        now: u32,
    },
    /// The recording is of another cell than the one that the user named.
    #[error(
        "{path} is a recording of cell `{cell}` (digest {recorded:08x}), and {given} is cell `{other}` (digest {now:08x})"
    )]
    NotThisCell {
        /// The recording that is not of the given cell.
        path: PathBuf,
        /// The name of the recording's cell.
        cell: String,
        /// The cell file that the user named.
        given: String,
        /// The name of the cell in the given file.
        other: String,
        /// The digest of the cell in the recording.
        recorded: u32,
        /// The digest of the cell in the file.
        now: u32,
    },
    /// The recording contains the frames that a monitor received, and no inputs.
    #[error(
        "{0} shows nodes as a monitor saw them, and has no inputs to run again: look at it with `imrs monitor --replay {0}`"
    )]
    Observations(PathBuf),
    /// The recording names a node that its cell does not have.
    #[error("{0} holds no inputs of a node of its cell")]
    NoInputs(PathBuf),
}
