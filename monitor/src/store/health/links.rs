//! Findings between nodes: damaged or foreign datagrams, kernel drops, and a full transit buffer.

use super::codes::{self, Lint};
use super::{Finding, Lately, Place};
use crate::store::NodeIncarnation;

/// The link counters (`runtime/src/link`) that have a lint of their own. An increase of any other counter is reported
/// as [`codes::LINK_DISCARDS`], unless it is routine.
const SIGNS: &[(&str, &Lint)] = &[
    ("checksum", &codes::INTEGRITY),
    ("length", &codes::INTEGRITY),
    ("too_short", &codes::INTEGRITY),
    ("not_imrs", &codes::INTEGRITY),
    ("replayed", &codes::INTEGRITY),
    ("forged", &codes::INTEGRITY),
    ("packet_checksum", &codes::INTEGRITY),
    ("packet_malformed", &codes::INTEGRITY),
    ("packet_port", &codes::INTEGRITY),
    ("version", &codes::VERSION_MISMATCH),
    ("mode", &codes::VERSION_MISMATCH),
    ("packet_version", &codes::VERSION_MISMATCH),
    ("other_cell", &codes::DIGEST_MISMATCH),
    ("other_statements", &codes::DIGEST_MISMATCH),
    ("refused_by_peer", &codes::DIGEST_MISMATCH),
    ("misdelivered", &codes::INTEGRITY),
    ("purpose", &codes::INTEGRITY),
    ("kernel_dropped", &codes::KERNEL_RESIDENCY),
];

/// The reasons of routine drops. Packets of a neighbour's previous incarnation still arrive after a restart. Answers in
/// handshakes may arrive too late on a busy machine.
const ORDINARY: &[&str] = &["stale_incarnation", "unproven_session", "stale_session"];

pub(super) fn look(incarnation: &NodeIncarnation, lately: &Lately<'_>, found: &mut Vec<Finding>) {
    let place = Place::node(incarnation);
    for (name, more) in lately.link_discards() {
        if ORDINARY.contains(&name) {
            continue;
        }
        let sign = SIGNS.iter().find(|(known, _)| *known == name);
        let lint = sign.map_or(&codes::LINK_DISCARDS, |(_, lint)| *lint);
        let text = format!("link drops: {} (+{more})", crate::name::shown(name));
        found.push(Finding::new(lint, place, text));
    }
    let transit = &lately.after.transit;
    if transit.capacity > 0 && u32::from(transit.len) * 10 >= u32::from(transit.capacity) * 9 {
        let text = format!("transit buffer {} of {}", transit.len, transit.capacity);
        found.push(Finding::new(&codes::TRANSIT_FULL, place, text));
    }
}

impl<'a> Lately<'a> {
    /// By how much the links' drop counters have grown, by reason.
    fn link_discards(&self) -> impl Iterator<Item = (&'a str, u64)> + use<'a> {
        let before = self.before;
        self.after.link_discards.iter().filter_map(move |count| {
            let was = before?.link_discards.iter().find(|c| c.name == count.name).map_or(0, |c| c.count);
            let more = count.count.saturating_sub(was);
            (more > 0).then_some((count.name.as_str(), more))
        })
    }
}
