//! A node's connection to its neighbours: its own UDP socket, or a network within this process.

use imrs_protocol::{NodeId, Packet};
use imrs_runtime::link::in_process::InProcess;
use imrs_runtime::link::udp::UdpLink;
use imrs_runtime::link::{Leading, Link, LinkBusy, PollEnd, Sink};
use std::time::Instant;

/// A link of either kind.
pub enum Way {
    /// A UDP socket.
    Udp(Box<UdpLink>),
    /// A network within this process.
    InProcess(InProcess),
}

impl Way {
    /// The socket, if there is one.
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

    fn leading(&self) -> Option<&dyn Leading> {
        self.link().leading()
    }
}
