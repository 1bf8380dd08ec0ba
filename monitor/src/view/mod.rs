//! Draws the screens: pure functions of the app and the moment, one screen per file.

mod accused;
mod banner;
mod below;
mod canvas;
mod columns;
mod events;
mod explain;
mod explained;
mod foot;
mod help;
mod lists;
mod message;
mod model;
mod nodes;
mod overview;
mod port;
mod problems;
mod rendezvous;
mod replay;
mod scrub;
mod settings;
mod sums;
mod timeline;
mod timers;
mod words;

use crate::app::{App, Msg, Screen};
use crate::clock::{Moment, Span};
pub use crate::drawn::{Drawn, Hit};
use crate::keys::Action;
use crate::name::Name;
use crate::store::journal::Severity;
use crate::store::{Condition, Presence};
use crate::theme::Ink;
use canvas::{Canvas, columns};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

/// Draws the screen of `app` at the moment `now` into `area`. Returns the layout, for [`Msg::Drawn`].
pub fn view(app: &App, now: Moment, area: Rect, buffer: &mut Buffer) -> Drawn {
    let now = app.moment(now);
    let area = area.intersection(buffer.area);
    let mut drawn = Drawn { screen: app.screen, ..Drawn::default() };
    if !area.is_empty() {
        draw(app, now, &mut Canvas { buffer, area, theme: &app.theme, words: &[], drawn: &mut drawn });
        // The selected title looks like a selected row.
        if let Some(at) = app.title().and_then(|title| drawn.title(title)) {
            buffer.set_style(at, app.theme.style(Ink::Selected));
        }
    }
    drawn
}

/// Draws the screen of `app` into the whole of `buffer`, and passes the layout to the app.
pub fn show(app: &mut App, now: Moment, buffer: &mut Buffer) {
    let drawn = view(app, now, buffer.area, buffer);
    app.update(Msg::Drawn(drawn), now);
}

fn draw(app: &App, now: Moment, canvas: &mut Canvas<'_>) {
    let area = canvas.area;
    canvas.buffer.set_style(area, app.theme.style(Ink::Plain));
    head(app, now, canvas);
    let (findings, blockers) = (app.findings(now), app.blockers(now));
    let foot = u16::from(area.height > 2);
    let middle = Rect { y: area.y + 1, height: area.height.saturating_sub(1 + foot), ..area };
    if foot == 1 {
        foot::draw(app, &findings, &blockers, now, canvas);
    }
    let banner = banner::rows(app, &blockers, area.height);
    banner::draw(app, &findings, &blockers, now, &mut canvas.part(Rect { height: banner, ..middle }));
    let middle = Rect { y: middle.y + banner, height: middle.height - banner, ..middle };
    let bar = scrub::rows(app, area.height);
    let (middle, scrub) = split(middle, bar);
    scrub::draw(app, now, &mut canvas.part(scrub));
    let told = app.replay().map_or(0, |player| replay::rows(player, middle.height));
    let (middle, panel) = split(middle, told);
    if let Some(player) = app.replay() {
        replay::draw(app, player, &mut canvas.part(panel));
    }
    let mut canvas = canvas.part(middle);
    canvas.words = explained::columns(below_window(app));
    match below_window(app) {
        Screen::Help => help::draw(app, &mut canvas),
        _ if app.cell().is_none() => nothing(app, &mut canvas),
        Screen::Overview => overview::draw(app, &findings, &blockers, now, &mut canvas),
        Screen::Port => port::draw(app, now, &mut canvas),
        Screen::Message => message::draw(app, now, &mut canvas),
        Screen::Rendezvous => rendezvous::draw(app, now, &mut canvas),
        Screen::Timeline => timeline::draw(app, &mut canvas),
        Screen::Timers => timers::draw(app, now, &mut canvas),
        Screen::Events => events::draw(app, now, &mut canvas),
        Screen::Model => model::draw(app, now, &mut canvas),
        Screen::Problems => problems::draw(app, &findings, &blockers, now, &mut canvas),
        Screen::Explain => explain::draw(app, &mut canvas),
        Screen::Settings => {}
    }
    if app.screen == Screen::Settings {
        settings::draw(app, &mut canvas);
    }
}

/// The screen that is shown, also if the window of the settings covers a part of it.
fn below_window(app: &App) -> Screen {
    if app.screen == Screen::Settings { app.settings_over() } else { app.screen }
}

/// Splits off the last `rows` rows of an area. Returns the other rows first.
const fn split(area: Rect, rows: u16) -> (Rect, Rect) {
    let rows = if rows < area.height { rows } else { area.height };
    let above = area.height - rows;
    (Rect { height: above, ..area }, Rect { y: area.y + above, height: rows, ..area })
}

use explained::INSECURE;
pub use explained::column as explain_column;
pub(crate) use explained::columns as explained_columns;
pub(crate) use overview::label;

/// The screen of `app` at the moment `now` as text, at this width and height.
#[must_use]
pub fn page(app: &App, now: Moment, (width, height): (u16, u16)) -> String {
    let mut buffer = Buffer::empty(Rect::new(0, 0, width, height));
    view(app, now, buffer.area, &mut buffer);
    text(&buffer)
}

/// A buffer as text, line by line, without trailing spaces.
#[must_use]
pub fn text(buffer: &Buffer) -> String {
    let area = buffer.area;
    let mut out = String::new();
    for y in area.y..area.y + area.height {
        let row: String = (area.x..area.x + area.width).map(|x| buffer[(x, y)].symbol()).collect();
        out += row.trim_end();
        out.push('\n');
    }
    out
}

/// The tabs in the header. Other screens belong to one of these.
const TABS: [(Screen, char, &str); 8] = [
    (Screen::Overview, '1', "Over"),
    (Screen::Port, '2', "Port"),
    (Screen::Rendezvous, '3', "Rdv"),
    (Screen::Timeline, '4', "Time"),
    (Screen::Timers, '5', "Timers"),
    (Screen::Events, '6', "Events"),
    (Screen::Model, '7', "Model"),
    (Screen::Problems, '8', "Prob"),
];

/// How many columns of the header the name of a cell takes at most.
const LONGEST_CELL: u16 = 24;

/// A piece of the header, with what a click on it does.
type Piece = (String, Ink, Option<Hit>);

fn head(app: &App, now: Moment, canvas: &mut Canvas<'_>) {
    let mut x = 0;
    for (text, ink, hit) in pieces(app, canvas.area.width, now) {
        let end = canvas.at(x, 0, u16::MAX, &text, ink);
        if let Some(hit) = hit {
            canvas.target(x, 0, end - x, hit);
        }
        x = end;
    }
}

fn pieces(app: &App, width: u16, now: Moment) -> Vec<Piece> {
    let screen = below_window(app);
    let narrow = width < 60;
    let long = |pieces: &[Piece]| pieces.iter().map(|(text, ..)| columns(text)).fold(0, u16::saturating_add);
    let mut pieces = vec![(" imrs ".to_owned(), Ink::Head, Some(Hit::Key(Action::Settings)))];
    if let Some(cell) = app.cell() {
        cell_at_a_glance(app, &cell, narrow, now, &mut pieces);
    }
    if narrow {
        // The end of the line is cut first, so the tab comes before the less important pieces.
        let at = pieces.len().min(4);
        pieces.insert(at, only_tab(screen));
        while long(&pieces) > width && pieces.len() > at + 1 {
            pieces.pop();
        }
        // A place in the past is more important than the name of the program and that of the screen.
        if long(&pieces) > width {
            pieces.remove(0);
        }
        if long(&pieces) > width
            && let Some((text, ..)) = pieces.last_mut()
            && let Some((digit, _)) = text.split_once(' ').and_then(|(_, tab)| tab.split_once(' '))
        {
            *text = format!(" {digit}]");
        }
        return pieces;
    }
    let short = tabs(screen, &SHORTEST);
    // The tabs are always shown completely: without room for all pieces, the last warnings are left out.
    while long(&pieces).saturating_add(long(&short)) > width && pieces.len() > 4 {
        pieces.pop();
    }
    let room = width.saturating_sub(long(&pieces));
    let mut forms = FORMS.iter().filter(|form| width >= 110 || !form.names).map(|form| tabs(screen, form));
    pieces.extend(forms.find(|form| long(form) <= room).unwrap_or(short));
    pieces
}

/// The tab for a narrow screen: the name of the shown screen. A click on it opens the next one.
fn only_tab(shown: Screen) -> Piece {
    let at = TABS.iter().position(|(screen, ..)| *screen == tab_of(shown));
    let name = at.map_or("Help".to_owned(), |at| format!("{} {}", TABS[at].1, TABS[at].2));
    let (next, ..) = TABS[at.map_or(0, |at| (at + 1) % TABS.len())];
    (format!(" [{name}]"), Ink::Head, Some(Hit::Tab(next)))
}

/// A form in which the tabs are drawn. Each form names the shown screen.
struct Form {
    /// Whether the form names the other screens, too.
    names: bool,
    /// The text before and after each tab.
    gap: &'static str,
    /// The text about the help key.
    help: &'static str,
}

/// The forms of the tabs, best first.
const FORMS: [Form; 4] = [
    Form { names: true, gap: " ", help: "  ? help" },
    Form { names: true, gap: " ", help: " ?" },
    Form { names: false, gap: " ", help: "  ? help" },
    Form { names: false, gap: " ", help: " ?" },
];
const SHORTEST: Form = Form { names: false, gap: "", help: " ?" };

fn tabs(shown: Screen, form: &Form) -> Vec<Piece> {
    let gap = form.gap;
    let tab = |(screen, key, name): &(Screen, char, &str)| {
        if *screen == tab_of(shown) {
            return (format!("[{key} {name}]"), Ink::Head, Some(Hit::Tab(*screen)));
        }
        let name = if form.names { format!(" {name}") } else { String::new() };
        (format!("{gap}{key}{name}{gap}"), Ink::Dim, Some(Hit::Tab(*screen)))
    };
    let help = (form.help.to_owned(), Ink::Dim, Some(Hit::Tab(Screen::Help)));
    let first = (format!(" {gap}"), Ink::Plain, None);
    std::iter::once(first).chain(TABS.iter().map(tab)).chain([help]).collect()
}

/// The tab to which a screen belongs.
fn tab_of(screen: Screen) -> Screen {
    match screen {
        Screen::Message => Screen::Port,
        Screen::Explain => Screen::Problems,
        Screen::Settings => Screen::Overview,
        _ => screen,
    }
}

/// Writes the cell's name, the number of nodes that are up, and warnings that concern the whole cell.
fn cell_at_a_glance(app: &App, cell: &Name, narrow: bool, now: Moment, pieces: &mut Vec<Piece>) {
    let cells = app.cells();
    let at = cells.iter().position(|c| c == cell).filter(|_| cells.len() > 1);
    let of = at.map_or_else(String::new, |at| format!(" ({}/{}, C: next)", at + 1, cells.len()));
    let name = if narrow { cell.to_string() } else { canvas::cut(cell.shown(), LONGEST_CELL) };
    let nodes_of_it = Hit::Tab(Screen::Overview);
    let next = if at.is_some() { Hit::Key(Action::Cell) } else { nodes_of_it };
    pieces.push((format!(" {name}{of}"), Ink::Plain, Some(next)));
    let (up, all) = nodes(app, now);
    let nodes = if narrow { "" } else { " nodes" };
    let ink = if up < all { Ink::Bad } else { Ink::Plain };
    pieces.push((format!("  {up}/{all}{nodes}"), ink, Some(nodes_of_it)));
    if let Some(player) = app.replay() {
        replay::head(player, pieces);
    } else {
        let (word, ink) = match (app.paused().is_some(), up) {
            (true, _) => ("PAUSED", Ink::Warn),
            (false, 0) => ("NO NODE UP", Ink::Bad),
            (false, _) => ("LIVE", Ink::Good),
        };
        let before = before_pause(app, now).map_or_else(String::new, |before| format!(" -{}", Span(before)));
        pieces.push((format!("  {word}{before}"), ink, Some(Hit::Key(Action::Pause))));
    }
    if app.recording.is_some() {
        pieces.push(("  REC".to_owned(), Ink::Bad, Some(Hit::Key(Action::Record))));
    }
    let insecure =
        app.store().incarnations_of(cell).filter_map(|l| l.last.as_ref()).any(|s| s.snapshot.insecure);
    if insecure {
        pieces.push(("  INSECURE".to_owned(), Ink::Bad, Some(Hit::Fact(INSECURE))));
    }
    let lost: u64 = app.store().incarnations_of(cell).map(|l| l.lost).sum();
    if lost > 0 {
        pieces.push((format!("  lost {lost}"), Ink::Warn, Some(Hit::Tab(Screen::Events))));
    }
}

/// If the user has moved back during a pause: how long before the pause the shown moment is.
fn before_pause(app: &App, now: Moment) -> Option<std::time::Duration> {
    app.gone_back()?;
    Some(app.paused()?.saturating_sub(now))
}

/// The number of nodes that are up, and of all nodes.
fn nodes(app: &App, now: Moment) -> (usize, usize) {
    let Some(cell) = app.cell() else { return (0, 0) };
    let store = app.store();
    let up = |incarnation: &&crate::store::NodeIncarnation| incarnation.presence(now) == Presence::Up;
    let up = store.incarnations_of(&cell).filter(up).count();
    let known = store.names(&cell).map_or(0, |n| n.nodes.len());
    (up, known.max(store.incarnations_of(&cell).filter(|l| l.condition == Condition::Attached).count()))
}

/// The sign of a severity.
const fn mark(level: Severity) -> &'static str {
    match level {
        Severity::Trace | Severity::Note => " ",
        Severity::Warn => "!",
        Severity::Bad => "!!",
    }
}

fn nothing(app: &App, canvas: &mut Canvas<'_>) {
    canvas.line(1, &[(" Waiting for a node to appear ...", Ink::Plain)]);
    for (y, trouble) in (3..).zip(app.store().troubles()) {
        canvas.line(y, &[(" ! ", Ink::Warn), (trouble, Ink::Plain)]);
    }
}
