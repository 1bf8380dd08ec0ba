//! What a node shows besides its own state, and to whom.

use super::{Observer, ObserverError};
use crate::lock::lock;
use crate::node::Node;
use imrs_protocol::NodeId;
use imrs_wire::obs::{NodePlace, Places, RecordingFacts, Token, place};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Tells how the recording of a node goes, if it has one.
pub type RecordingWatch = Arc<dyn Fn() -> Option<RecordingFacts> + Send + Sync>;

/// Where the other nodes of a cell serve monitors over TCP, as far as this node was told. Shared with the code that tells it.
#[derive(Clone, Debug, Default)]
pub struct AddressBook(Arc<Mutex<Vec<(NodeId, SocketAddr)>>>);

impl AddressBook {
    /// Enters where a node serves monitors.
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

/// How a node is shown: the options of an [`Observer`].
#[derive(Clone)]
pub struct Showing {
    pub(super) node: Arc<Node>,
    pub(super) token: Option<Token>,
    pub(super) recording: Option<RecordingWatch>,
    pub(super) book: AddressBook,
    /// The path of this node's own Unix socket, if it has one: the other nodes' sockets lie beside it.
    pub(super) beside: Option<PathBuf>,
}

impl Showing {
    /// Shows `node`, over TCP to everybody who reaches it.
    #[must_use]
    pub fn new(node: Arc<Node>) -> Self {
        Self { node, token: None, recording: None, book: AddressBook::default(), beside: None }
    }

    /// Only a client with this token may look over TCP. A Unix socket is protected by its file's mode instead.
    #[must_use]
    pub fn token(mut self, token: Option<Token>) -> Self {
        self.token = token;
        self
    }

    /// Sets what tells how the recording of the node goes.
    #[must_use]
    pub fn recording(mut self, watch: RecordingWatch) -> Self {
        self.recording = Some(watch);
        self
    }

    /// Sets where the other nodes are.
    #[must_use]
    pub fn book(mut self, book: AddressBook) -> Self {
        self.book = book;
        self
    }

    /// Serves monitors where they look for the node, as [`Observer::start`].
    ///
    /// # Errors
    /// [`ObserverError`].
    pub fn start(self) -> Result<Observer, ObserverError> {
        let cell = &self.node.table().cell().name;
        let path = place::prepare_socket(cell, self.node.name(), std::process::id())?;
        for socket in place::sockets_in(&place::base_dir())? {
            if socket.parent() == path.parent() {
                // Not there, another user's, or alive after all: then it stays.
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

    /// Serves monitors at a TCP address (port 0: any free one).
    ///
    /// # Errors
    /// [`ObserverError::Tcp`].
    pub fn start_tcp(self, address: SocketAddr) -> Result<Observer, ObserverError> {
        Observer::serve_tcp(self, address)
    }

    /// Where the other nodes of the cell are found: beside this node's socket, or where this node was told.
    pub(super) fn places(&self) -> Places {
        let Some(own) = &self.beside else { return Places { nodes: self.book.places() } };
        let sockets = own.parent().and_then(Path::parent).map(place::sockets_in);
        let nodes = &self.node.table().cell().nodes;
        let place = |socket: PathBuf| {
            let name = place::node_of(&socket)?;
            let node = nodes.iter().position(|node| place::file_name(&node.name) == name)?;
            let address = format!("unix:{}", socket.to_str()?);
            Some(NodePlace { node: NodeId::from_index(node), address })
        };
        let beside = sockets
            .into_iter()
            .flatten()
            .flatten()
            .filter(|socket| socket.parent() == own.parent() && socket != own);
        Places { nodes: beside.filter_map(place).collect() }
    }
}
