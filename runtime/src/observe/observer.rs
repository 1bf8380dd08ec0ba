//! Shows a running node to monitors ([`imrs_wire::obs`]): over a Unix socket that only its user can open and, on request,
//! over TCP. Over TCP a token keeps others out, if one is set.
//!
//! One thread serves all monitors. This thread only looks: nothing that a monitor sends reaches a state machine.
//! Without a monitor the thread sleeps in the kernel. A monitor that does not read costs one frame of memory and no
//! time: no further frame is made for it until that frame has left. So such a monitor gets fewer snapshots, and the
//! events that it misses are counted as lost.

mod client;
mod due;
mod pass;
mod showing;
mod stream;

pub use showing::{AddressBook, RecordingWatch, Showing};

use crate::node::Node;
use client::Client;
use imrs_wire::obs::place::PlaceError;
use pass::Pass;
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::process::setpriority_process;
use std::fs::{self, Permissions};
use std::io::{self, ErrorKind};
use std::net::SocketAddr;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use stream::Listener;

/// How many monitors a node serves at once.
pub const MAX_MONITORS: usize = 8;
/// The most connections of clients that have not proven yet that they are allowed to look. They count separately.
const MAX_STRANGERS: usize = 16;
/// The niceness of the observer's thread: the lowest priority, because the tasks go first.
const LEAST_PRIORITY: i32 = 19;
/// How long the listener rests when the process has no file descriptor left for a new monitor.
const REST: Duration = Duration::from_millis(500);

/// Why a node cannot show itself to monitors. The node runs nevertheless.
#[derive(Debug, thiserror::Error)]
pub enum ObserverError {
    /// There is no usable place for the socket.
    #[error(transparent)]
    Place(#[from] PlaceError),
    /// Another process serves this socket.
    #[error("{0} is served by another process")]
    Taken(PathBuf),
    /// The operating system refused the TCP address.
    #[error("cannot serve monitors at tcp:{address}: {source}")]
    Tcp {
        /// The address that the observer could not listen on.
        address: SocketAddr,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The operating system refused the Unix socket.
    #[error("cannot serve monitors at {path}: {source}")]
    Io {
        /// The path of the socket.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

/// Serves monitors until it is dropped.
///
/// ```
/// use imrs_protocol::{Cell, CellTable, Ticks};
/// use imrs_runtime::{Runtime, observer::Observer};
/// use std::sync::Arc;
///
/// let mut cell = Cell::new("one", Ticks(1_000));
/// let here = cell.node("here");
/// let _task = cell.task("idle", here);
/// let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
/// let node = Runtime::builder(table, here).task("idle", |_ctx| Ok(())).start().expect("a node that starts");
/// // `Observer::start` takes the place where `imrs monitor` looks by itself.
/// let path = std::env::temp_dir().join(format!("imrs-example-{}.sock", std::process::id()));
/// let observer = Observer::start_at(Arc::clone(node.node()), &path).expect("a socket");
/// println!("imrs monitor --connect {}", path.display());
/// drop(observer);
/// ```
#[derive(Debug)]
pub struct Observer {
    place: Place,
    stop: Arc<OwnedFd>,
    thread: Option<JoinHandle<()>>,
}

/// The place at which monitors find a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// A Unix socket at this path.
    Unix(PathBuf),
    /// A TCP address.
    Tcp(SocketAddr),
}

impl Observer {
    /// Shows `node` at the place where monitors look for it. Removes the sockets that dead nodes of the same cell left
    /// in that folder.
    pub fn start(node: Arc<Node>) -> Result<Self, ObserverError> {
        Showing::new(node).start()
    }

    /// Shows `node` at a socket of the caller's choice.
    ///
    /// # Errors
    /// [`ObserverError`].
    pub fn start_at(node: Arc<Node>, path: &Path) -> Result<Self, ObserverError> {
        Showing::new(node).start_at(path)
    }

    /// Shows `node` at a TCP address (port 0 means any free port) to everybody who can reach it.
    ///
    /// # Errors
    /// [`ObserverError::Tcp`].
    pub fn start_tcp(node: Arc<Node>, address: SocketAddr) -> Result<Self, ObserverError> {
        Showing::new(node).start_tcp(address)
    }

    fn serve_at(showing: Showing, path: &Path) -> Result<Self, ObserverError> {
        let io = |source: io::Error| ObserverError::Io { path: path.into(), source };
        let listener = bind(path)?;
        // Until this call, the folder keeps other users from the socket, because only this user can enter the folder.
        fs::set_permissions(path, Permissions::from_mode(0o600)).map_err(io)?;
        Self::serve(showing, Listener::Unix(listener), Place::Unix(path.into())).map_err(io)
    }

    fn serve_tcp(showing: Showing, address: SocketAddr) -> Result<Self, ObserverError> {
        let failed = |source| ObserverError::Tcp { address, source };
        let listener = Listener::tcp(address).map_err(failed)?;
        let bound = match &listener {
            Listener::Tcp(listener) => listener.local_addr().map_err(failed)?,
            Listener::Unix(_) => address,
        };
        Self::serve(showing, listener, Place::Tcp(bound)).map_err(failed)
    }

    fn serve(showing: Showing, listener: Listener, place: Place) -> io::Result<Self> {
        listener.set_nonblocking()?;
        let stop = Arc::new(eventfd(0, EventfdFlags::CLOEXEC)?);
        let server =
            Server { showing, listener, stop: Arc::clone(&stop), clients: Vec::new(), rest_until: None };
        let thread = thread::Builder::new().name("imrs observer".into()).spawn(move || server.run())?;
        Ok(Self { place, stop, thread: Some(thread) })
    }

    /// The place at which monitors find the node.
    #[must_use]
    pub const fn place(&self) -> &Place {
        &self.place
    }
}

/// Says goodbye to the monitors and removes the socket.
impl Drop for Observer {
    fn drop(&mut self) {
        let _ = rustix::io::write(&*self.stop, &1_u64.to_ne_bytes());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        if let Place::Unix(path) = &self.place {
            let _ = fs::remove_file(path);
        }
    }
}

/// Listens at `path`. If no process serves an existing socket there, removes it, because otherwise a later process with the
/// same id could not listen.
fn bind(path: &Path) -> Result<UnixListener, ObserverError> {
    let io = |source| ObserverError::Io { path: path.into(), source };
    match UnixListener::bind(path) {
        Err(error) if error.kind() == ErrorKind::AddrInUse => {}
        other => return other.map_err(io),
    }
    match UnixStream::connect(path) {
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
        Ok(_) | Err(_) => return Err(ObserverError::Taken(path.into())),
    }
    fs::remove_file(path).map_err(io)?;
    UnixListener::bind(path).map_err(io)
}

struct Server {
    showing: Showing,
    listener: Listener,
    stop: Arc<OwnedFd>,
    clients: Vec<Client>,
    rest_until: Option<Instant>,
}

impl Server {
    fn run(mut self) {
        // This sets the priority of this thread alone. No system refuses it; if one did, the thread would run with ordinary
        // priority.
        let _ = setpriority_process(None, LEAST_PRIORITY);
        let mut pass = Pass::new(Instant::now());
        loop {
            let Some(ready) = self.sleep() else { return self.say_goodbye() };
            let now = Instant::now();
            pass.begin(now);
            self.rest_until = self.rest_until.filter(|&until| until > now);
            let mut at = 0;
            let mut room = self.room(now);
            self.clients.retain_mut(|client| {
                let served = client.is_served();
                let ready = ready.clients.get(at).copied().unwrap_or_default();
                let stays = client.serve(ready, room > 0, &mut pass);
                room = room.saturating_sub(usize::from(stays && !served && client.is_served()));
                at += 1;
                stays
            });
            self.make_room(now);
            if ready.listener {
                self.accept(now);
            }
        }
    }

    /// How many new monitors can be served: the number of free places, and of idle monitors that would make room.
    fn room(&self, now: Instant) -> usize {
        let served = self.clients.iter().filter(|client| client.is_served()).count();
        let idle = self.clients.iter().filter(|client| client.idle_since(now).is_some()).count();
        (MAX_MONITORS + idle).saturating_sub(served)
    }

    /// Disconnects the monitor that has been idle longest, as long as more monitors are served than there are places.
    fn make_room(&mut self, now: Instant) {
        while self.clients.iter().filter(|client| client.is_served()).count() > MAX_MONITORS {
            let idle =
                self.clients.iter().enumerate().filter_map(|(at, one)| Some((one.idle_since(now)?, at)));
            let Some((_, longest)) = idle.min() else { return };
            self.clients.remove(longest);
        }
    }

    /// Sleeps until there is something to do. Returns `None` if the observer thread must end.
    fn sleep(&self) -> Option<Ready> {
        let due = self.clients.iter().filter_map(Client::due).chain(self.rest_until).min();
        let left = due.map(|due| due.saturating_duration_since(Instant::now()));
        let left = left.and_then(|left| Timespec::try_from(left).ok());
        let listen = if self.rest_until.is_some() { PollFlags::empty() } else { PollFlags::IN };
        let mut fds = vec![
            PollFd::from_borrowed_fd(self.stop.as_fd(), PollFlags::IN),
            PollFd::from_borrowed_fd(self.listener.as_fd(), listen),
        ];
        for client in &self.clients {
            let mut wanted = PollFlags::IN;
            wanted.set(PollFlags::OUT, client.has_pending());
            fds.push(PollFd::from_borrowed_fd(client.as_fd(), wanted));
        }
        if poll(&mut fds, left.as_ref()).is_err() {
            // A signal interrupted the wait, so nothing is ready.
            return Some(Ready::default());
        }
        let happened = |fd: &PollFd<'_>| !fd.revents().is_empty();
        if fds.first().is_some_and(happened) {
            return None;
        }
        Some(Ready {
            listener: fds.get(1).is_some_and(happened),
            clients: fds.iter().skip(2).map(happened).collect(),
        })
    }

    fn accept(&mut self, now: Instant) {
        match self.listener.accept() {
            // If too many clients are connected that have not proven their right to look, the oldest of them is
            // disconnected: a client with that right proves it at once.
            Ok(Some(stream)) => {
                let strangers = || self.clients.iter().enumerate().filter(|(_, client)| !client.is_served());
                if strangers().count() >= MAX_STRANGERS
                    && let Some((oldest, _)) = strangers().next()
                {
                    self.clients.remove(oldest);
                }
                self.clients.extend(Client::new(stream, self.showing.clone(), now));
            }
            Ok(None) => {}
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            Err(_) => self.rest_until = Some(now + REST),
        }
    }

    fn say_goodbye(&mut self) {
        self.clients.iter_mut().for_each(Client::say_goodbye);
    }
}

#[derive(Default)]
struct Ready {
    listener: bool,
    clients: Vec<bool>,
}
