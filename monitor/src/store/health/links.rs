//! Findings between nodes: cut links, damaged or foreign datagrams, kernel drops, and a full transit buffer.

use super::codes::{self, Lint};
use super::{Finding, Lately, Place};
use crate::clock::{Moment, Span};
use crate::name::Name;
use crate::store::cuts::{ORDINARY, cuts};
use crate::store::{NodeIncarnation, Store};
use imrs_wire::obs::{Delays, Margin};

/// The link counters (`runtime/src/link`) with a lint of their own, and what the dropped datagrams are. Any other counter is
/// [`codes::LINK_DISCARDS`], unless it is routine.
const SIGNS: &[(&str, &Lint, &str)] = &[
    ("checksum", &codes::INTEGRITY, "damaged datagrams"),
    ("length", &codes::INTEGRITY, "damaged datagrams"),
    ("too_short", &codes::INTEGRITY, "damaged datagrams"),
    ("not_imrs", &codes::INTEGRITY, "foreign datagrams"),
    ("replayed", &codes::INTEGRITY, "repeated datagrams"),
    ("forged", &codes::INTEGRITY, "forged datagrams"),
    ("packet_checksum", &codes::INTEGRITY, "damaged packets"),
    ("packet_malformed", &codes::INTEGRITY, "damaged packets"),
    ("packet_port", &codes::INTEGRITY, "damaged packets"),
    ("version", &codes::VERSION_MISMATCH, "another release sends"),
    ("mode", &codes::VERSION_MISMATCH, "keys at one end only"),
    ("packet_version", &codes::VERSION_MISMATCH, "another release sends"),
    ("other_cell", &codes::DIGEST_MISMATCH, "another cell sends"),
    ("other_statements", &codes::DIGEST_MISMATCH, "another text of the cell sends"),
    ("refused_by_peer", &codes::DIGEST_MISMATCH, "the peer runs another text of the cell"),
    ("misdelivered", &codes::INTEGRITY, "datagrams for another node"),
    ("purpose", &codes::INTEGRITY, "datagrams for another purpose"),
    ("kernel_dropped", &codes::KERNEL_RESIDENCY, "the node reads too slowly"),
];

pub(super) fn look(incarnation: &NodeIncarnation, lately: &Lately<'_>, found: &mut Vec<Finding>) {
    let place = Place::node(incarnation);
    for (name, more) in lately.link_discards() {
        if ORDINARY.contains(&name) {
            continue;
        }
        let sign = SIGNS.iter().find(|(known, ..)| *known == name);
        let lint = sign.map_or(&codes::LINK_DISCARDS, |(_, lint, _)| *lint);
        let words = sign.map_or_else(String::new, |(.., words)| format!("{words}, "));
        let text = format!("link drops: {words}{} (+{more})", crate::name::shown(name));
        found.push(Finding::new(lint, place, text));
    }
    let transit = &lately.after.transit;
    if transit.capacity > 0 && u32::from(transit.len) * 10 >= u32::from(transit.capacity) * 9 {
        let text = format!("transit buffer {} of {}", transit.len, transit.capacity);
        found.push(Finding::new(&codes::TRANSIT_FULL, place, text));
    }
}

/// Reports the links whose datagrams take long, against the declared bound, and those that count as faulty, at the node that
/// receives.
pub(super) fn measured(incarnation: &NodeIncarnation, now: Moment, found: &mut Vec<Finding>) {
    let place = Place::node(incarnation);
    for link in incarnation.measured(now) {
        let from = incarnation.names.node(link.report.peer);
        let (recent, bound) = (link.report.recent, Span::micros(link.bound_us));
        if link.report.integrity.is_faulty {
            let failures = link.report.integrity.failures;
            let text =
                format!("link from {from} is faulty: {failures} damaged datagrams, and others are missing");
            found.push(Finding::new(&codes::LINK_FAULTY, place, text));
        }
        match link.margin() {
            Margin::Enough => {}
            Margin::Near => {
                let text = format!("link from {from}: {}", recent.beside(link.bound_us));
                found.push(Finding::new(&codes::LINK_NEAR, place, text));
            }
            Margin::Exceeded => {
                let Delays { count, late, .. } = recent;
                let text = format!(
                    "link from {from} over its bound of {bound}: {late} of {count} datagrams took longer"
                );
                found.push(Finding::new(&codes::LINK_LATE, place, text));
            }
        }
    }
}

/// Reports the links over which nothing arrives, at the node that hears nothing.
pub(super) fn cut(store: &Store, cell: &Name, now: Moment, found: &mut Vec<Finding>) {
    for cut in cuts(store, cell, now) {
        let text = format!(
            "link from {} is cut: {} packets sent, none accepted for {}",
            cut.from.node,
            cut.sent,
            Span(cut.silent)
        );
        found.push(Finding::new(&codes::LINK_CUT, Place::node(cut.to), text));
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
