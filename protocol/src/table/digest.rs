//! The digests that keep nodes of different tables apart (D47, D48).

use super::{Party, Port};
use crate::cell::{Cell, PortDecl};
use crate::packet::Class;
use alloc::format;
use alloc::vec::Vec;

const CRC: crc::Crc<u32, crc::Table<1>> = crc::Crc::<u32, crc::Table<1>>::new(&crc::CRC_32_AUTOSAR);

/// Feeds values to a checksum. Lengths precede texts and lists, so that different tables never feed the same bytes.
struct Canonical<'a>(crc::Digest<'a, u32, crc::Table<1>>);

impl Canonical<'_> {
    fn number(&mut self, value: u64) {
        self.0.update(&value.to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.number(text.len() as u64);
        self.0.update(text.as_bytes());
    }
}

/// The hash of a port, which the checksum of each of the port's packets covers first.
pub(super) fn of_port(decl: &PortDecl) -> u32 {
    let mut c = Canonical(CRC.digest());
    c.text(&decl.name);
    c.text(&decl.format);
    c.text(decl.usage.word());
    c.number(u64::from(decl.class == Class::Command));
    c.0.finalize()
}

/// The digest of the whole table.
pub(super) fn of_cell(cell: &Cell, ports: &[Port]) -> u32 {
    let mut c = Canonical(CRC.digest());
    c.text(&cell.name);
    c.number(cell.tick.0);
    c.number(cell.nodes.len() as u64);
    for node in &cell.nodes {
        c.text(&node.name);
    }
    let mut links: Vec<_> = cell.links.iter().map(|l| (l.a.min(l.b), l.a.max(l.b), l.delay)).collect();
    links.sort_unstable();
    c.number(links.len() as u64);
    for (a, b, delay) in links {
        c.number(u64::from(a.0) << 16 | u64::from(b.0));
        c.number(delay.0);
    }
    c.number(cell.tasks.len() as u64);
    for task in &cell.tasks {
        c.text(&task.name);
        c.number(u64::from(task.node.0));
    }
    c.number(ports.len() as u64);
    for port in ports {
        c.number(u64::from(port.hash));
        c.number(
            u64::from(port.decl.bounded_buffer) << 16
                | u64::from(port.decl.retry) << 8
                | u64::from(port.decl.losses),
        );
        c.number(port.decl.resend.0);
        c.number(port.margin.0);
        let PortDecl { penalty, latest, fragments, answer_fragments, rate, guard, .. } = &port.decl;
        c.text(&format!("{penalty:?} {latest} {fragments} {answer_fragments} {rate:?} {guard:?}"));
        c.number(port.parties.len() as u64);
        for party in &port.parties {
            c.number(u64::from(party.task.0));
            c.number(party.time_out.0);
        }
    }
    c.text(&format!("{:?}", cell.couples));
    c.text(&format!("{:?}", cell.rules));
    for port in ports {
        let own = |party: &&Party| (party.retry, party.rate) != (port.decl.retry, port.decl.rate);
        for party in port.parties.iter().filter(own) {
            c.text(&format!("{} {} {} {:?}", port.id, party.task, party.retry, party.rate));
        }
    }
    c.0.finalize()
}
