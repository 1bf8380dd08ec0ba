//! Whole nodes over loopback UDP.

use imrs_protocol::{CellTable, Incarnation, NodeId, NodeTable, Packet, Ticks};
use imrs_runtime::link::faulty::FaultyLink;
use imrs_runtime::link::udp::keys::{NodeKeys, SecretKey, draw_cell_key, draw_node_keys};
use imrs_runtime::link::udp::{UdpLink, UdpOptions};
use imrs_runtime::link::{Link, LinkDiscard, PollEnd, Sink};
use imrs_runtime::{Builder, Runtime};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// The sink of a link whose neighbours have sent nothing yet.
pub struct Nobody;

impl Sink for Nobody {
    fn packets(&self, _from: NodeId, _packets: &[Packet], _charge: Ticks, _at: Instant) {}
    fn peer(&self, _node: NodeId, _incarnation: Incarnation, _restarted: bool) {}
    fn discarded(&self, _reason: LinkDiscard) {}
}

/// Links for both nodes of a cell, without faults. Each link knows the other one's address.
#[allow(dead_code, reason = "`process.rs` uses it")]
pub fn udp_links(table: &Arc<CellTable>) -> [UdpLink; 2] {
    bound(table).try_into().unwrap_or_else(|_| panic!("two nodes"))
}

/// Links for all nodes of a cell. Each link knows the addresses of the others.
pub fn links(table: &Arc<CellTable>, loss: f64) -> Vec<Arc<FaultyLink<UdpLink>>> {
    let faulty = |(seed, link)| {
        let link = FaultyLink::new(link, seed);
        link.set_loss(loss);
        Arc::new(link)
    };
    (0..).zip(bound(table)).map(faulty).collect()
}

/// Links with keys for all nodes of a cell. Each link knows the addresses of the others.
#[allow(dead_code, reason = "`all.rs` uses it")]
pub fn links_with_keys(table: &Arc<CellTable>) -> Vec<UdpLink> {
    let cell = draw_cell_key().expect("random numbers");
    let draw = |node| (NodeId::from_index(node), draw_node_keys().expect("random numbers"));
    let pairs: Vec<_> = (0..table.cell().nodes.len()).map(draw).collect();
    let publics: BTreeMap<_, _> = pairs.iter().map(|(node, (_, public))| (*node, *public)).collect();
    let of = |(link, (_, (private, _))): (UdpLink, &(_, (SecretKey, _)))| {
        let keys = NodeKeys::new(cell.clone(), private.clone(), publics.clone());
        link.with_keys(&keys).expect("all keys")
    };
    bound(table).into_iter().zip(&pairs).map(of).collect()
}

fn bound(table: &Arc<CellTable>) -> Vec<UdpLink> {
    let count = table.cell().nodes.len();
    let bind = |node| {
        let here = NodeTable::new(Arc::clone(table), NodeId::from_index(node));
        let address = "127.0.0.1:0".parse().expect("an address");
        UdpLink::bind(here, address, UdpOptions::new(Incarnation(1), false)).expect("a free port")
    };
    let links: Vec<UdpLink> = (0..count).map(bind).collect();
    for (a, from) in links.iter().enumerate() {
        for neighbour in table.neighbours(NodeId::from_index(a)) {
            let address = links[neighbour.index()].local_address();
            from.set_address(neighbour, Some(address)).expect("a neighbour");
        }
        // The poll ends with the event of the new addresses here. Otherwise the receiving thread might get this event
        // at any later time, and send waiting packets just then.
        while from.poll(&Nobody, None) != PollEnd::Ready {}
    }
    links
}

pub fn builders(table: &Arc<CellTable>, links: &[Arc<FaultyLink<UdpLink>>]) -> Vec<Builder> {
    let links = links.iter().cloned().enumerate();
    links
        .map(|(node, link)| {
            Runtime::builder(Arc::clone(table), NodeId::from_index(node))
                .incarnation(Incarnation(1), false)
                .insecure(true)
                .link(link)
        })
        .collect()
}
