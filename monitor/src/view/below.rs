//! The row below the overview: the links, and the verdict of the validator.

use super::canvas::{Canvas, columns};
use crate::app::{App, Screen};
use crate::clock::{Moment, Span};
use crate::drawn::Hit;
use crate::name::Name;
use crate::store::conformance::{Verdict, conformance};
use crate::store::cuts::cuts;
use crate::store::health::Place;
use crate::store::{Measured, Presence};
use crate::theme::Ink;
use imrs_protocol::NodeId;
use imrs_wire::obs::{Delays, Margin};

/// How many rows at the bottom of the overview this part takes.
pub(super) const fn rows(height: u16) -> u16 {
    if height < 8 { 0 } else { 1 }
}

/// Draws the links and the validator's verdict.
pub(super) fn draw(app: &App, now: Moment, canvas: &mut Canvas<'_>) {
    let Some(cell) = app.cell().filter(|_| canvas.height() > 0) else { return };
    // The verdict is more important than the links, so the links get the remaining room.
    let label = "  model: ";
    let (texts, ink) = model(app, &cell);
    let fits = texts.iter().find(|text| columns(label) + columns(text) <= canvas.area.width);
    let text = fits.or(texts.last()).map_or("", String::as_str);
    let width = columns(label).saturating_add(columns(text));
    let room = canvas.area.width.saturating_sub(width);
    let (mut x, mut shown, mut is_cut) = (0, 0, false);
    let whole = links(app, &cell, now, |delays, bound_us| Some(delays.beside(bound_us)));
    let fits = whole.iter().map(|(text, ..)| columns(text)).sum::<u16>() <= room;
    let pieces = if fits { whole } else { links(app, &cell, now, Delays::briefly_beside) };
    for (text, ink, place) in pieces {
        // A cut text about a link says nothing, so a link is drawn as a whole or only counted.
        is_cut |= x > 0 && columns(&text) + x + columns(MORE) > room;
        if is_cut {
            break;
        }
        canvas.explain(x, 0, &text);
        let start = x;
        x = canvas.at(x, 0, room.saturating_sub(x), &text, ink);
        shown += usize::from(place.is_some());
        // A text about all links leads to the explanation of the label `links`.
        canvas.target(start, 0, x - start, place.map_or(Hit::Column("links"), Hit::Place));
    }
    if is_cut {
        let (start, all) = (x, app.store().names(&cell).map_or(0, |names| names.links.len()));
        x = canvas.at(x, 0, room.saturating_sub(x), &format!(" +{}", all.saturating_sub(shown)), Ink::Dim);
        canvas.target(start, 0, x - start, Hit::Column("links"));
    }
    let start = x;
    // The label explains itself, and the verdict leads to its screen.
    canvas.explain(x, 0, label);
    x = canvas.at(x, 0, u16::MAX, label, Ink::Dim);
    x = canvas.at(x, 0, u16::MAX, text, ink);
    canvas.target(start, 0, x.saturating_sub(start), Hit::Tab(Screen::Model));
}

/// Puts delays beside the bound of their link in microseconds, in words for a row.
type Words = fn(&Delays, u64) -> Option<String>;

/// For each link: whether it is active, for how long it has been quiet, or that a node at one of its ends is down.
/// Each comes with the place to which a click leads: the node at the end that is in trouble, otherwise at its first end.
fn links(app: &App, cell: &Name, now: Moment, words: Words) -> Vec<(String, Ink, Option<Place>)> {
    let store = app.store();
    let Some(names) = store.names(cell) else { return Vec::new() };
    let gone = |node| store.latest(cell, node).is_some_and(|incarnation| incarnation.presence(now).is_gone());
    let stopped = |node| match store.latest(cell, node) {
        Some(incarnation) => matches!(incarnation.presence(now), Presence::Stopped(_)),
        None => store.is_said_to_have_stopped(cell, node),
    };
    let cuts = cuts(store, cell, now);
    // The node at the receiving end of a cut direction of the link.
    let cut_at = |a, b| {
        let found = cuts.iter().find(|cut| [(a, b), (b, a)].contains(&(cut.from.node_id, cut.to.node_id)));
        found.map(|cut| cut.to.node_id)
    };
    let is_faulty = |ends: &[_]| measured(app, cell, ends, now).any(|link| link.report.integrity.is_faulty);
    let is_late = |ends: &[_]| measured(app, cell, ends, now).any(|link| link.margin() != Margin::Enough);
    let mut pieces = Vec::new();
    let mut unknown = 0;
    for link in names.links.iter().take(SHOWN) {
        let name = format!(" {}-{} ", names.node(link.a), names.node(link.b));
        let ends = [(link.a, link.b), (link.b, link.a)];
        let heard = ends.map(|(at, peer)| heard(app, cell, at, peer, now));
        let (text, ink) = match heard.into_iter().flatten().min() {
            _ if stopped(link.a) || stopped(link.b) => ("STOPPED".to_owned(), Ink::Dim),
            _ if gone(link.a) || gone(link.b) => ("DOWN".to_owned(), Ink::Warn),
            _ if cut_at(link.a, link.b).is_some() => ("CUT".to_owned(), Ink::Bad),
            _ if is_faulty(&ends) => ("FAULTY".to_owned(), Ink::Bad),
            Some(us) if us <= LATELY_US => {
                let (delay, ink) = delay(app, cell, &ends, now, words);
                (format!("ok{delay}"), ink)
            }
            // Without traffic a link is quiet, which is no fault.
            Some(us) => (format!("quiet {}", Span::micros(us).in_seconds()), Ink::Dim),
            None => {
                unknown += 1;
                continue;
            }
        };
        let is_ended = |node| stopped(node) || gone(node);
        let at = |is_there: &dyn Fn(NodeId, &[_]) -> bool| {
            ends.iter().find(|(node, peer)| is_there(*node, &[(*node, *peer)])).map(|(node, _)| *node)
        };
        let ended = at(&|node, _| is_ended(node)).or_else(|| cut_at(link.a, link.b));
        let ailing = ended.or_else(|| at(&|_, end| is_faulty(end))).or_else(|| at(&|_, end| is_late(end)));
        let node = ailing.unwrap_or(link.a);
        let incarnation = store.latest(cell, node).map(|incarnation| incarnation.id);
        let place = Place { node: incarnation.ok_or(node), task: None, port: None };
        pieces.push((name + &text, ink, Some(place)));
    }
    // The links that need attention come first, because others may have no room.
    pieces.sort_by_key(|(_, ink, _)| match ink {
        Ink::Bad => 0,
        Ink::Warn => 1,
        _ => 2,
    });
    pieces.insert(0, (" links".to_owned(), Ink::Dim, None));
    if unknown > 0 {
        pieces.push((format!("  {unknown} unknown"), Ink::Dim, None));
    }
    if names.links.len() > SHOWN {
        pieces.push((format!("  {} more", names.links.len() - SHOWN), Ink::Dim, None));
    }
    pieces
}

/// Links to a node from a neighbour, as the node measures them.
fn measured<'a>(
    app: &'a App,
    cell: &'a Name,
    ends: &'a [(NodeId, NodeId)],
    now: Moment,
) -> impl Iterator<Item = Measured<'a>> + Clone {
    ends.iter().filter_map(move |(at, from)| {
        let incarnation = app.store().latest(cell, *at)?;
        incarnation.measured(now).find(|link| link.report.peer == *from)
    })
}

/// The recent delays in the slower direction of a link beside the declared bound.
fn delay(app: &App, cell: &Name, ends: &[(NodeId, NodeId)], now: Moment, words: Words) -> (String, Ink) {
    let mut links = measured(app, cell, ends, now);
    let slowest = links.clone().max_by_key(|link| link.report.recent.p99_us);
    let words = slowest.and_then(|link| words(&link.report.recent, link.bound_us));
    let is_enough = links.all(|link| link.margin() == Margin::Enough);
    let text = words.map_or_else(String::new, |words| format!(" {words}"));
    (text, if is_enough { Ink::Plain } else { Ink::Warn })
}

/// The widest text for the number of links that have no room.
const MORE: &str = " +12";
/// How many links are shown at most; more have no room.
const SHOWN: usize = 12;
/// A link is quiet if its last datagram is older than this.
const LATELY_US: u64 = 1_000_000;

/// How long ago the node `at` last received a datagram from `peer`, in microseconds. `None` if it has received none, or
/// if the time is unknown.
fn heard(app: &App, cell: &Name, at: NodeId, peer: NodeId, now: Moment) -> Option<u64> {
    let incarnation =
        app.store().latest(cell, at).filter(|incarnation| !incarnation.presence(now).is_gone())?;
    let last = incarnation.last.as_ref()?;
    last.snapshot.links.iter().find(|link| link.peer == peer)?.heard_us
}

/// Whether all nodes together behave as the verified state machine, according to the replay of their recordings: in
/// texts of which each is shorter than the one before.
fn model(app: &App, cell: &Name) -> (Vec<String>, Ink) {
    let store = app.store();
    let (mut steps, mut unknown, mut violated) = (0_u64, 0, None);
    let mut incarnations = 0;
    for incarnation in store.present(cell) {
        let told = conformance(store, incarnation.id);
        incarnations += 1;
        steps = steps.saturating_add(told.steps);
        match told.verdict {
            Verdict::Unknown { .. } => unknown += 1,
            Verdict::Conforms => {}
            Verdict::Violates { .. } => violated = violated.or_else(|| Some(incarnation.node.to_string())),
        }
    }
    let judged = format!("conforms in {steps} steps");
    match violated {
        Some(node) => (vec![format!("{node} VIOLATES it (7)"), "VIOLATED (7)".to_owned()], Ink::Bad),
        None if unknown == incarnations => (vec!["UNKNOWN, not recorded".to_owned()], Ink::Dim),
        None if unknown > 0 => {
            let unknown = if unknown == 1 { "1 node".to_owned() } else { format!("{unknown} nodes") };
            let texts = [format!("{judged}, {unknown} UNKNOWN"), format!("conforms, {unknown} UNKNOWN")];
            (texts.into(), Ink::Warn)
        }
        None => (vec![judged, "conforms".to_owned()], Ink::Good),
    }
}
