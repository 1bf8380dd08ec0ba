//! Counts the incarnations of a node that runs on its own (D49, D145).
//!
//! The node binds its socket, locks its state, asks its neighbours which incarnation of it they remember, counts, and
//! syncs the count to disk. Only then does it send packets. So a failed start consumes no incarnation. A node that lost
//! its state takes an incarnation that its neighbours do not consider old.

use crate::cells::Loaded;
use crate::error::PlaceError;
use crate::place;
use imrs_protocol::{Incarnation, NodeId, NodeTable};
use imrs_runtime::link::udp::keys::NodeKeys;
use imrs_runtime::link::udp::{UdpError, UdpLink, UdpOptions};
use imrs_wire::envelope::supersedes;
use imrs_wire::obs::place::file_name;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

/// How long a node waits for its neighbours to say which incarnation of it they remember.
const ASK_WITHIN: Duration = Duration::from_secs(1);
/// How long a node waits for its lock. Another process that only asks whether the node runs holds the lock for a
/// moment.
const LOCK_WITHIN: Duration = Duration::from_millis(50);
/// The time between two attempts to take the lock.
const LOCK_EVERY: Duration = Duration::from_millis(5);

/// The stored incarnation of a node: `$XDG_STATE_HOME/imrs/<cell>/<node>.life`. As long as this value exists, it holds
/// the lock on the file `<node>.lock` in the same folder. That file contains the id of this process.
#[derive(Debug)]
pub struct State {
    folder: PathBuf,
    path: PathBuf,
    _lock: File,
}

/// The incarnation with which a node starts.
#[derive(Debug)]
pub struct Counted {
    /// The lock and the stored state. The node stays locked until this is dropped.
    pub state: State,
    /// The incarnation with which the node starts.
    pub incarnation: Incarnation,
    /// Whether an earlier incarnation may have taken requests.
    pub restarted: bool,
    /// A notice for the operator: neighbours remember a later incarnation than this machine, or no neighbour answers.
    pub notice: Option<String>,
}

/// Binds the socket of a node that runs on its own, sets the addresses of its neighbours, and counts its next
/// incarnation. The count comes after the socket, so that a start without a socket consumes no incarnation (D145).
/// `keys` encrypt and authenticate the node's datagrams.
///
/// # Errors
/// [`UdpError`]: the address cannot be bound. [`PlaceError`]: the node runs already, its incarnation cannot be stored, or a
/// neighbour has no address.
pub fn bind<E>(
    loaded: &Loaded,
    node: NodeId,
    address: SocketAddr,
    keys: Option<&NodeKeys>,
) -> Result<(UdpLink, Counted), E>
where
    E: From<UdpError> + From<PlaceError>,
{
    let cell = loaded.table.cell();
    let name = &cell.nodes[node.index()].name;
    let neighbours = place::neighbours(loaded, node)?;
    let statements = loaded.all_statements();
    let options = UdpOptions { statements, ..UdpOptions::new(Incarnation(0), false) };
    let link = UdpLink::bind(NodeTable::new(Arc::clone(&loaded.table), node), address, options);
    if let Err(UdpError::Bind { .. }) = link {
        // The address may be in use because another process runs this very node.
        State::refuse_running(&cell.name, name)?;
    }
    let mut link = link?;
    if let Some(keys) = keys {
        link = link.with_keys(keys)?;
    }
    for (i, peer) in cell.nodes.iter().enumerate() {
        if let Some(&address) = neighbours.get(&peer.name) {
            // All these nodes are neighbours, so setting their addresses cannot fail.
            let _ = link.set_address(NodeId::from_index(i), Some(address));
        }
    }
    let counted = count(&link, &cell.name, name)?;
    Ok((link, counted))
}

/// Counts the next incarnation of the node for which `link` was bound. `link` must know the node's neighbours.
fn count(link: &UdpLink, cell: &str, node: &str) -> Result<Counted, PlaceError> {
    let state = State::lock(cell, node)?;
    let before = state.read()?;
    let said = link.ask_incarnations(ASK_WITHIN);
    let remembered: Vec<Incarnation> = said.iter().filter_map(|&(_, remembered)| remembered).collect();
    let (incarnation, is_ahead) = next(before, &remembered);
    state.write(incarnation)?;
    let restarted = before.is_some() || !remembered.is_empty();
    link.set_incarnation(incarnation, restarted);
    let Incarnation(number) = incarnation;
    let notice = if is_ahead {
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
    Ok(Counted { state, incarnation, restarted, notice })
}

/// The incarnation after the stored incarnation and after all incarnations that neighbours remember. Also returns
/// whether a neighbour remembers a later incarnation than the stored one.
fn next(before: Option<Incarnation>, remembered: &[Incarnation]) -> (Incarnation, bool) {
    let after = |Incarnation(number): Incarnation| Incarnation(number.wrapping_add(1));
    // A node without stored state has no count of its own. If a neighbour that does not answer now remembers a later
    // incarnation of this node, it will drop packets of incarnation 0 as old.
    let counted = before.map(after);
    let next = remembered.iter().fold(counted, |next, &other| {
        next.filter(|&next| supersedes(next, other)).or_else(|| Some(after(other)))
    });
    (next.unwrap_or(Incarnation(0)), next != counted)
}

impl State {
    /// Locks the stored incarnation of a node.
    ///
    /// # Errors
    /// [`PlaceError`]: another process holds the lock, or there is no folder for the state.
    fn lock(cell: &str, node: &str) -> Result<Self, PlaceError> {
        Self::lock_in(Self::folder(cell)?, node)
    }

    /// Fails if another process has locked the node. Changes nothing on the disk.
    ///
    /// # Errors
    /// [`PlaceError`]: another process holds the lock, or there is no folder for the state.
    fn refuse_running(cell: &str, node: &str) -> Result<(), PlaceError> {
        Self::refuse_running_in(&Self::folder(cell)?, node)
    }

    fn folder(cell: &str) -> Result<PathBuf, PlaceError> {
        let named = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
        let base = named("XDG_STATE_HOME").or_else(|| Some(named("HOME")?.join(".local/state")));
        Ok(base.ok_or(PlaceError::NoFolder)?.join("imrs").join(file_name(cell)))
    }

    fn refuse_running_in(folder: &Path, node: &str) -> Result<(), PlaceError> {
        let path = folder.join(format!("{}.lock", file_name(node)));
        let failed = |source| PlaceError::Unstored { path: path.clone(), source };
        let mut lock = match File::open(&path) {
            Ok(lock) => lock,
            // Without a lock file the node has never run.
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(error) => return Err(failed(error)),
        };
        // The lock is shared, so that two processes that only ask whether the node runs do not block each other.
        match flock(&lock, FlockOperation::NonBlockingLockShared) {
            Ok(()) => Ok(()),
            Err(Errno::WOULDBLOCK) => Err(runs(&mut lock, node).map_err(failed)?),
            Err(errno) => Err(failed(errno.into())),
        }
    }

    fn lock_in(folder: PathBuf, node: &str) -> Result<Self, PlaceError> {
        let file = file_name(node);
        let path = folder.join(format!("{file}.life"));
        let failed = |source| PlaceError::Unstored { path: path.clone(), source };
        fs::create_dir_all(&folder).map_err(failed)?;
        let mut lock = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(folder.join(format!("{file}.lock")))
            .map_err(failed)?;
        let end = Instant::now() + LOCK_WITHIN;
        loop {
            match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => break,
                Err(Errno::WOULDBLOCK) if Instant::now() < end => thread::sleep(LOCK_EVERY),
                Err(Errno::WOULDBLOCK) => return Err(runs(&mut lock, node).map_err(failed)?),
                Err(errno) => return Err(failed(errno.into())),
            }
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

    /// Stores an incarnation atomically. It is on the disk when this returns.
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
        PlaceError::Unstored { path: self.path.clone(), source }
    }
}

/// The error that the node runs already, in the process that its lock file names.
fn runs(lock: &mut File, node: &str) -> io::Result<PlaceError> {
    let mut process = String::new();
    lock.read_to_string(&mut process)?;
    Ok(PlaceError::Runs { node: node.to_owned(), process: process.trim().to_owned() })
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
        assert_eq!(next(None, &[i(255)]), (i(0), true), "the state is lost");
        assert_eq!(next(Some(i(128)), &[i(2)]), (i(129), false));
        assert_eq!(next(Some(i(129)), &[i(2)]), (i(3), true), "it would pass for an earlier one");
    }

    #[test]
    fn a_node_is_counted_by_one_process_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let lock = |node| State::lock_in(folder.path().join("cell"), node);
        let asked = |node| State::refuse_running_in(&folder.path().join("cell"), node);
        asked("n/1").unwrap();
        let state = lock("n/1").unwrap();
        assert_eq!(state.read().unwrap(), None);
        assert!(matches!(asked("n/1"), Err(PlaceError::Runs { .. })));
        state.write(Incarnation(7)).unwrap();
        let refused = lock("n/1").unwrap_err().to_string();
        assert!(refused.contains(&format!("process {}", std::process::id())), "{refused}");
        drop((state, lock("other").unwrap()));
        // This waits, because a child process of another test may hold this process's open files, and with them the
        // lock, until it executes its program.
        let end = Instant::now() + Duration::from_secs(100);
        while let Err(error) = asked("n/1") {
            assert!(Instant::now() < end, "{error}");
            thread::sleep(LOCK_EVERY);
        }
        let state = lock("n/1").unwrap();
        assert_eq!(state.read().unwrap(), Some(Incarnation(7)));
        fs::write(&state.path, "x").unwrap();
        assert!(state.read().unwrap_err().to_string().contains("remember"));
    }
}
