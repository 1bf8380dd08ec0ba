//! A node's connection to its neighbours: its own UDP socket, or a network within this process.

use super::NodeError;
use crate::cells::Loaded;
use crate::host::Host;
use crate::pipe::Setup;
use imrs_client::{incarnation, keys};
use imrs_protocol::{Incarnation, NodeId, NodeTable, Packet};
use imrs_runtime::link::in_process::InProcess;
use imrs_runtime::link::udp::{UdpLink, UdpOptions};
use imrs_runtime::link::{Leading, Link, LinkBusy, PollEnd, Sink};
use imrs_wire::obs::LinkReport;
use std::net::{Ipv4Addr, SocketAddr};
use std::time::Instant;

/// The link of a node, of either kind.
pub enum Way {
    /// A UDP socket.
    Udp(Box<UdpLink>),
    /// A network within this process.
    InProcess(InProcess),
}

impl Way {
    /// The UDP socket, if the node has one.
    pub fn udp(&self) -> Option<&UdpLink> {
        match self {
            Self::Udp(link) => Some(link),
            Self::InProcess(_) => None,
        }
    }

    fn link(&self) -> &dyn Link {
        match self {
            Self::Udp(link) => link.as_ref(),
            Self::InProcess(link) => link,
        }
    }
}

impl Link for Way {
    fn ready(&self, next: NodeId) -> bool {
        self.link().ready(next)
    }

    fn at_once(&self) -> usize {
        self.link().at_once()
    }

    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy> {
        self.link().send_at(next, packets, at)
    }

    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd {
        self.link().poll(sink, until)
    }

    fn wake(&self) {
        self.link().wake();
    }

    fn failures(&self) -> Vec<(&'static str, u64)> {
        self.link().failures()
    }

    fn evidence(&self) -> Vec<(&'static str, u64)> {
        self.link().evidence()
    }

    fn goodbye(&self) {
        self.link().goodbye();
    }

    fn health(&self) -> Vec<LinkReport> {
        self.link().health()
    }

    fn leading(&self) -> Option<&dyn Leading> {
        self.link().leading()
    }
}

/// Binds the socket of a node, and takes the keys out of its setup. A node that runs on its own also counts its incarnation.
///
/// # Errors
/// [`NodeError`]: the keys do not belong to this node, the socket cannot be bound, or the incarnation cannot be counted.
pub fn socket(
    host: &'static dyn Host,
    setup: &mut Setup,
    loaded: &Loaded,
    table: &NodeTable,
) -> Result<(UdpLink, Option<incarnation::State>), NodeError> {
    let address = setup.bind.unwrap_or_else(|| SocketAddr::from((Ipv4Addr::LOCALHOST, 0)));
    let keys = setup.keys.take().map(|text| keys::parse(&text, loaded, table.node)).transpose();
    let keys = keys.map_err(|why| NodeError::Setup(format!("keys that are none: {why}")))?;
    if !setup.counts {
        let statements = loaded.all_statements();
        let options =
            UdpOptions { statements, ..UdpOptions::new(Incarnation(setup.incarnation), setup.restarted) };
        let link = UdpLink::bind(table.clone(), address, options)?;
        let link = match keys {
            Some(keys) => link.with_keys(&keys)?,
            None => link,
        };
        return Ok((link, None));
    }
    let (link, counted) = incarnation::bind::<NodeError>(loaded, table.node, address, keys.as_ref())?;
    counted.notice.iter().for_each(|notice| host.complain(notice));
    (setup.incarnation, setup.restarted) = (counted.incarnation.0, counted.restarted);
    Ok((link, Some(counted.state)))
}
