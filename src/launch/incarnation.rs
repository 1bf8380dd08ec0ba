//! Which incarnation of a node this is, where it runs by itself (D49, D145).
//!
//! A node binds its socket, locks its state, asks its neighbours, counts, syncs, and only then sends packets. So a start
//! that fails consumes no incarnation, and a node whose state was lost takes one that its neighbours do not hold for old.

use super::place::PlaceError;
use imrs_protocol::Incarnation;
use imrs_runtime::link::udp::UdpLink;
use imrs_wire::envelope::supersedes;
use imrs_wire::obs::place::file_name;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, Write};
use std::path::PathBuf;
use std::time::Duration;

/// How long a node waits for what its neighbours remember of it.
const ASK_WITHIN: Duration = Duration::from_secs(1);

/// What is remembered of a node from one start to the next: `$XDG_STATE_HOME/imrs/<cell>/<node>.life`. Locked while it is
/// here, by `<node>.lock` beside it, which names the process.
#[derive(Debug)]
pub struct State {
    folder: PathBuf,
    path: PathBuf,
    _lock: File,
}

/// The incarnation that a node begins.
#[derive(Debug)]
pub struct Counted {
    /// The node is locked while this is here.
    pub state: State,
    /// Which one it is.
    pub incarnation: Incarnation,
    /// Whether an earlier one may have taken requests.
    pub restarted: bool,
    /// What a person should know of how it was counted.
    pub note: Option<String>,
}

/// Counts the next incarnation of the node that `link` was bound for and whose neighbours it knows.
///
/// # Errors
/// [`PlaceError`]: the node runs already, or cannot remember its incarnations.
pub fn count(link: &UdpLink, cell: &str, node: &str) -> Result<Counted, PlaceError> {
    let state = State::lock(cell, node)?;
    let before = state.read()?;
    let said = link.ask_incarnations(ASK_WITHIN);
    let remembered: Vec<Incarnation> = said.iter().filter_map(|&(_, remembered)| remembered).collect();
    let (incarnation, is_ahead) = next(before, &remembered);
    state.write(incarnation)?;
    let restarted = before.is_some() || !remembered.is_empty();
    link.set_incarnation(incarnation, restarted);
    let Incarnation(number) = incarnation;
    let note = if is_ahead {
        Some(format!(
            "node {node}: a neighbour remembers a later incarnation than {}; this is {number}",
            state.path.display()
        ))
    } else if said.is_empty() && link.has_addresses() {
        Some(format!(
            "node {node}: no neighbour said within {} s which incarnation it remembers; this is {number}",
            ASK_WITHIN.as_secs()
        ))
    } else {
        None
    };
    Ok(Counted { state, incarnation, restarted, note })
}

/// The incarnation after the one before and after all that neighbours remember, and whether theirs were ahead.
fn next(before: Option<Incarnation>, remembered: &[Incarnation]) -> (Incarnation, bool) {
    let after = |Incarnation(number): Incarnation| Incarnation(number.wrapping_add(1));
    let counted = before.map_or(Incarnation(0), after);
    let next = remembered
        .iter()
        .fold(counted, |next, &other| if supersedes(next, other) { next } else { after(other) });
    (next, next != counted)
}

impl State {
    /// Locks what is remembered of a node.
    ///
    /// # Errors
    /// [`PlaceError`]: another process has it, or there is no place to remember in.
    pub fn lock(cell: &str, node: &str) -> Result<Self, PlaceError> {
        let named = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
        let base = named("XDG_STATE_HOME").or_else(|| Some(named("HOME")?.join(".local/state")));
        let folder = base.ok_or(PlaceError::NoFolder)?.join("imrs").join(file_name(cell));
        Self::lock_in(folder, node)
    }

    fn lock_in(folder: PathBuf, node: &str) -> Result<Self, PlaceError> {
        let file = file_name(node);
        let path = folder.join(format!("{file}.life"));
        let failed = |source| PlaceError::Life { path: path.clone(), source };
        fs::create_dir_all(&folder).map_err(failed)?;
        let mut lock = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(folder.join(format!("{file}.lock")))
            .map_err(failed)?;
        match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => {}
            Err(Errno::WOULDBLOCK) => {
                let mut process = String::new();
                lock.read_to_string(&mut process).map_err(failed)?;
                return Err(PlaceError::Runs { node: node.to_owned(), process: process.trim().to_owned() });
            }
            Err(errno) => return Err(failed(errno.into())),
        }
        let written = lock
            .set_len(0)
            .and_then(|()| lock.rewind())
            .and_then(|()| writeln!(lock, "{}", std::process::id()));
        written.map_err(failed)?;
        Ok(Self { folder, path, _lock: lock })
    }

    fn read(&self) -> Result<Option<Incarnation>, PlaceError> {
        match fs::read_to_string(&self.path) {
            Ok(text) => {
                let number = text.trim().parse::<u8>();
                number
                    .map(|number| Some(Incarnation(number)))
                    .map_err(|error| self.failed(io::Error::other(error)))
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(self.failed(error)),
        }
    }

    /// Whole or not at all, and on the disk when this returns.
    fn write(&self, Incarnation(number): Incarnation) -> Result<(), PlaceError> {
        let new = self.path.with_extension("life.new");
        let written = File::create(&new).and_then(|mut file| {
            writeln!(file, "{number}")?;
            file.sync_all()?;
            fs::rename(&new, &self.path)?;
            File::open(&self.folder)?.sync_all()
        });
        written.map_err(|source| self.failed(source))
    }

    fn failed(&self, source: io::Error) -> PlaceError {
        PlaceError::Life { path: self.path.clone(), source }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn incarnations_are_counted_around_the_wrap_and_after_what_is_remembered() {
        let i = Incarnation;
        assert_eq!(next(None, &[]), (i(0), false));
        assert_eq!(next(Some(i(255)), &[]), (i(0), false));
        assert_eq!(next(None, &[i(200)]), (i(201), true), "the state is lost");
        assert_eq!(next(Some(i(3)), &[i(3), i(1)]), (i(4), false));
        assert_eq!(next(Some(i(3)), &[i(9), i(255)]), (i(10), true));
        assert_eq!(next(Some(i(129)), &[i(2)]), (i(130), false));
        assert_eq!(next(Some(i(130)), &[i(2)]), (i(3), true), "it would pass for an earlier one");
    }

    #[test]
    fn a_node_is_counted_by_one_process_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let lock = |node| State::lock_in(folder.path().join("cell"), node);
        let state = lock("n/1").unwrap();
        assert_eq!(state.read().unwrap(), None);
        state.write(Incarnation(7)).unwrap();
        let refused = lock("n/1").unwrap_err().to_string();
        assert!(refused.contains(&format!("process {}", std::process::id())), "{refused}");
        drop((state, lock("other").unwrap()));
        let state = lock("n/1").unwrap();
        assert_eq!(state.read().unwrap(), Some(Incarnation(7)));
        fs::write(&state.path, "x").unwrap();
        assert!(state.read().unwrap_err().to_string().contains("remember"));
    }
}
