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
    let label = "  model: ";
    let (texts, ink) = model(app, &cell);
    let brief = links(app, &cell, now, Delays::briefly_beside);
    // The verdict is more important than the links, but takes a shorter text if a link that needs attention has no room.
    let ailing = brief.iter().find(|piece| piece.rank < Piece::WELL).map(|piece| columns(&piece.text));
    let ailing = ailing.map_or(0, |ailing| LABEL_OF_ALL + ailing + columns(MORE));
    let width = |text: &String| columns(label).saturating_add(columns(text));
    let fits = |least| texts.iter().find(|text| width(text).saturating_add(least) <= canvas.area.width);
    let shortest = || if ailing > 0 { texts.last() } else { None };
    let text = fits(ailing).or_else(shortest).or_else(|| fits(0)).or(texts.last());
    let room = canvas.area.width.saturating_sub(text.map_or(0, width));
    let text = text.map_or("", String::as_str);
    let whole = links(app, &cell, now, |delays, bound_us| Some(delays.beside(bound_us)));
    let fits = whole.iter().map(|piece| columns(&piece.text)).sum::<u16>() <= room;
    let mut pieces = if fits { whole } else { brief };
    if ailing > room {
        pieces.remove(0);
    }
    let mut x = list(app, &cell, &pieces, room, canvas);
    let start = x;
    // The label explains itself, and the verdict leads to its screen.
    canvas.explain(x, 0, label);
    x = canvas.at(x, 0, u16::MAX, label, Ink::Dim);
    x = canvas.at(x, 0, u16::MAX, text, ink);
    canvas.target(start, 0, x.saturating_sub(start), Hit::Tab(Screen::Model));
}

/// Draws as many of the links as have room, and counts the others. Returns the column behind them.
fn list(app: &App, cell: &Name, pieces: &[Piece], room: u16, canvas: &mut Canvas<'_>) -> u16 {
    let (mut x, mut shown, mut is_cut) = (0, 0, false);
    for (number, Piece { text, ink, place, .. }) in pieces.iter().enumerate() {
        // A cut text about a link says nothing, so a link is drawn as a whole or only counted.
        let is_last = number + 1 == pieces.len();
        let more = if is_last { 0 } else { columns(MORE) };
        is_cut |= x > 0 && columns(text) + x + more > room;
        if is_cut {
            break;
        }
        canvas.explain(x, 0, text);
        let start = x;
        x = canvas.at(x, 0, room.saturating_sub(x), text, *ink);
        shown += usize::from(place.is_some());
        // A text about all links leads to the explanation of the label `links`.
        canvas.target(start, 0, x - start, place.map_or(Hit::Column("links"), Hit::Place));
    }
    if is_cut {
        let (start, all) = (x, app.store().names(cell).map_or(0, |names| names.links.len()));
        x = canvas.at(x, 0, room.saturating_sub(x), &format!(" +{}", all.saturating_sub(shown)), Ink::Dim);
        canvas.target(start, 0, x - start, Hit::Column("links"));
    }
    x
}

/// A text about a link, or about all of them.
struct Piece {
    /// The links with the least rank need attention most. Each rank is a state of a link, as below.
    rank: u8,
    text: String,
    ink: Ink,
    /// The place to which a click leads: the node at the end of the link that is in trouble, otherwise at its first end.
    place: Option<Place>,
}

impl Piece {
    const CUT: u8 = 0;
    const DOWN: u8 = 1;
    const FAULTY: u8 = 2;
    const LATE: u8 = 3;
    const NEAR: u8 = 4;
    const WELL: u8 = 5;

    /// A text that is about no single link.
    const fn of_all(text: String) -> Self {
        Self { rank: Self::WELL, text, ink: Ink::Dim, place: None }
    }
}

/// The width of the label before the links.
const LABEL_OF_ALL: u16 = 6;

/// Puts delays beside the bound of their link in microseconds, in words for a row.
type Words = fn(&Delays, u64) -> Option<String>;

/// For each link: whether it is active, for how long it has been quiet, or that a node at one of its ends is down. Links
/// that need attention come first, because others may have no room.
fn links(app: &App, cell: &Name, now: Moment, words: Words) -> Vec<Piece> {
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
        let (rank, text, ink) = match heard.into_iter().flatten().min() {
            _ if stopped(link.a) || stopped(link.b) => (Piece::WELL, "STOPPED".to_owned(), Ink::Dim),
            _ if gone(link.a) || gone(link.b) => (Piece::DOWN, "DOWN".to_owned(), Ink::Warn),
            _ if cut_at(link.a, link.b).is_some() => (Piece::CUT, "CUT".to_owned(), Ink::Bad),
            _ if is_faulty(&ends) => (Piece::FAULTY, "FAULTY".to_owned(), Ink::Bad),
            Some(us) if us <= LATELY_US => delay(app, cell, &ends, now, words),
            // Without traffic a link is quiet, which is no fault.
            Some(us) => (Piece::WELL, format!("quiet {}", Span::micros(us).in_seconds()), Ink::Dim),
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
        pieces.push(Piece { rank, text: name + &text, ink, place: Some(place) });
    }
    pieces.sort_by_key(|piece| piece.rank);
    pieces.insert(0, Piece::of_all(" links".to_owned()));
    if unknown > 0 {
        pieces.push(Piece::of_all(format!("  {unknown} unknown")));
    }
    if names.links.len() > SHOWN {
        pieces.push(Piece::of_all(format!("  {} more", names.links.len() - SHOWN)));
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

/// The recent delays in the slower direction of a link beside the declared bound, and how they compare with it.
fn delay(app: &App, cell: &Name, ends: &[(NodeId, NodeId)], now: Moment, words: Words) -> (u8, String, Ink) {
    let links = measured(app, cell, ends, now);
    let slowest = links.clone().max_by_key(|link| link.report.recent.p99_us);
    let words = slowest.and_then(|link| words(&link.report.recent, link.bound_us));
    let text = words.map_or_else(String::new, |words| format!(" {words}"));
    let has = |margin: Margin| links.clone().any(|link| link.margin() == margin);
    match (has(Margin::Exceeded), has(Margin::Near)) {
        (true, _) => (Piece::LATE, format!("late{text}"), Ink::Warn),
        (false, true) => (Piece::NEAR, format!("near{text}"), Ink::Warn),
        (false, false) => (Piece::WELL, format!("ok{text}"), Ink::Plain),
    }
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
        None if unknown == incarnations => {
            (vec!["UNKNOWN, not recorded".to_owned(), "UNKNOWN".to_owned()], Ink::Dim)
        }
        None if unknown > 0 => {
            let nodes = if unknown == 1 { "1 node".to_owned() } else { format!("{unknown} nodes") };
            let texts = [
                format!("{judged}, {nodes} UNKNOWN"),
                format!("conforms, {nodes} UNKNOWN"),
                format!("{unknown} UNKNOWN"),
            ];
            (texts.into(), Ink::Warn)
        }
        None => (vec![judged, "conforms".to_owned()], Ink::Good),
    }
}
