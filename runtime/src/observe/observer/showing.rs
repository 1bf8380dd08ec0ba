//! What an observer shows of a node besides the node's own state, and to which monitors.

use super::{Observer, ObserverError};
use crate::lock::lock;
use crate::node::Node;
use imrs_protocol::NodeId;
use imrs_wire::obs::{NodePlace, Places, RecordingFacts, Token, place};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Returns the status of a node's recording, if the node has one.
pub type RecordingWatch = Arc<dyn Fn() -> Option<RecordingFacts> + Send + Sync>;

/// The TCP addresses at which the other nodes of a cell serve monitors, as far as this node knows. The code that learns them
/// shares this value.
#[derive(Clone, Debug, Default)]
pub struct AddressBook(Arc<Mutex<Vec<(NodeId, SocketAddr)>>>);

impl AddressBook {
    /// Enters the address at which a node serves monitors.
    pub fn put(&self, node: NodeId, address: SocketAddr) {
        let mut book = lock(&self.0);
        book.retain(|(other, _)| *other != node);
        book.push((node, address));
        book.sort();
    }

    fn places(&self) -> Vec<NodePlace> {
        let book = lock(&self.0);
        let place =
            |&(node, address): &(NodeId, SocketAddr)| NodePlace { node, address: format!("tcp:{address}") };
        book.iter().map(place).collect()
    }
}

/// The options of an [`Observer`]: how a node is shown.
#[derive(Clone)]
pub struct Showing {
    pub(super) node: Arc<Node>,
    pub(super) token: Option<Token>,
    pub(super) recording: Option<RecordingWatch>,
    pub(super) book: AddressBook,
    /// The path of this node's own Unix socket, if it has one. The sockets of the other nodes lie in the same folder.
    pub(super) beside: Option<PathBuf>,
}

impl Showing {
    /// Shows `node`, and over TCP shows it to everybody who can reach the address.
    #[must_use]
    pub fn new(node: Arc<Node>) -> Self {
        Self { node, token: None, recording: None, book: AddressBook::default(), beside: None }
    }

    /// Sets the token: over TCP only a client with this token may look. A Unix socket is protected by its file's mode
    /// instead.
    #[must_use]
    pub fn token(mut self, token: Option<Token>) -> Self {
        self.token = token;
        self
    }

    /// Sets the function that returns the status of the node's recording.
    #[must_use]
    pub fn recording(mut self, watch: RecordingWatch) -> Self {
        self.recording = Some(watch);
        self
    }

    /// Sets the addresses of the other nodes.
    #[must_use]
    pub fn book(mut self, book: AddressBook) -> Self {
        self.book = book;
        self
    }

    /// Serves monitors at the place where they look for the node, as [`Observer::start`] does.
    ///
    /// # Errors
    ///
    /// [`ObserverError`].
    pub fn start(self) -> Result<Observer, ObserverError> {
        let cell = &self.node.table().cell().name;
        let path = place::prepare_socket(cell, self.node.name(), std::process::id())?;
        for socket in place::sockets_in(&place::base_dir())? {
            if socket.parent() == path.parent() {
                // If there is no socket at that path, or it belongs to another user or to a running process, this
                // changes nothing.
                let _ = place::remove_if_stale(&socket);
            }
        }
        self.start_at(&path)
    }

    /// Serves monitors at a socket of the caller's choice.
    ///
    /// # Errors
    /// [`ObserverError`].
    pub fn start_at(mut self, path: &Path) -> Result<Observer, ObserverError> {
        (self.token, self.beside) = (None, Some(path.to_owned()));
        Observer::serve_at(self, path)
    }

    /// Serves monitors at a TCP address (port 0 means any free port).
    ///
    /// # Errors
    /// [`ObserverError::Tcp`].
    pub fn start_tcp(self, address: SocketAddr) -> Result<Observer, ObserverError> {
        Observer::serve_tcp(self, address)
    }

    /// The addresses of the other nodes of the cell: sockets in the folder of this node's socket, or addresses that
    /// this node was given.
    pub(super) fn places(&self) -> Places {
        let Some(own) = &self.beside else { return Places { nodes: self.book.places() } };
        // Only the folder of this cell is read: every second, while a monitor is connected.
        let mut sockets = own.parent().map(place::sockets_of).unwrap_or_default();
        sockets.sort();
        let nodes = &self.node.table().cell().nodes;
        let place = |socket: PathBuf| {
            let name = place::node_of(&socket)?;
            let node = nodes.iter().position(|node| place::file_name(&node.name) == name)?;
            let address = format!("unix:{}", socket.to_str()?);
            Some(NodePlace { node: NodeId::from_index(node), address })
        };
        let beside = sockets.into_iter().filter(|socket| socket != own);
        Places { nodes: beside.filter_map(place).collect() }
    }
}
