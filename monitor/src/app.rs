//! The state of the monitor's screen as one value. Every event is a [`Msg`], which [`App::update`] applies to this state.

mod command;
mod complete;
mod enter;
mod entry;
mod jump;
pub mod lanes;
mod mouse;
mod problems;
mod settings;
mod shown;
mod slices;
mod steer;
mod titles;
mod wind;

pub use command::COMMANDS;
pub use complete::{Completion, fuzzy};
pub use entry::Entry;
pub use settings::Setting;

use crate::clock::Moment;
use crate::drawn::Drawn;
use crate::history::History;
use crate::keymap::Keymap;
use crate::name::Name;
use crate::options::Endpoint;
use crate::problems::ProblemKey;
use crate::replay::{Player, Ribbon};
use crate::rows::Shape;
pub use crate::screen::Screen;
use crate::source::{Arrival, Wanted};
use crate::store::health::Place;
use crate::store::message::MessageKey;
use crate::store::{Condition, IncarnationId, Store};
use crate::theme::Theme;
pub use crate::typed::Kind;
use crate::typed::Typed;
use crossterm::event::{KeyEvent, KeyEventKind, MouseEvent};
use imrs_protocol::{MessageId, PortId, TaskId};
use imrs_wire::obs::Token;
use lanes::Lanes;
use std::path::PathBuf;
use std::time::Duration;

/// With more ports than this, the app subscribes only to the queues that are on the screen.
const MANY: usize = 2_000;

/// An event for the app.
#[derive(Clone, Debug)]
pub enum Msg {
    /// A node or a recording delivered frames.
    Feed(Arrival),
    /// A key was pressed.
    Key(KeyEvent),
    /// A mouse event.
    Mouse(MouseEvent),
    /// The main loop wants this text on the bottom line.
    Told(String),
    /// The terminal has another size.
    Resize,
    /// A frame was drawn, with this layout.
    Drawn(Drawn),
    /// Time has passed; a playing recording advances.
    Time,
}

/// What the main loop must do after a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Effect {
    /// The main loop need not do anything: the screen is unchanged.
    Nothing,
    /// Draw a frame.
    Draw,
    /// Start a recording, or end it.
    Record,
    /// Write the screen as text to a file.
    Write,
    /// Copy this text to the terminal's clipboard.
    Copy(String),
    /// Attach to this node in addition to the others.
    Connect(Endpoint),
    /// Use the mouse, or leave it to the terminal.
    Mouse(bool),
    /// Draw in the theme that the user has chosen, and store the choice.
    Theme,
    /// Release the terminal until the user returns.
    Suspend,
    /// End the monitor.
    Quit,
}

/// A port at one of its tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PortEnd {
    /// The incarnation of the node.
    pub incarnation: IncarnationId,
    /// The task that has the port.
    pub task: TaskId,
    /// The port of that task.
    pub port: PortId,
}

/// The state of the screen: everything on which it depends, except the time.
#[derive(Clone, Debug)]
pub struct App {
    live: Store,
    /// While paused: the store at the moment of the pause, and that moment.
    frozen: Option<(Box<Store>, Moment)>,
    /// While paused: which times before the pause the history covers.
    ribbon: Option<Ribbon>,
    /// The frames of the last minutes.
    history: History,
    /// While paused, if the user has moved back in the history: the position there.
    back: wind::Back,
    /// The recording that is shown instead of running nodes; `None` if running nodes are shown.
    replay: Option<Box<Player>>,
    /// The file to which the arriving frames are recorded.
    pub recording: Option<String>,
    /// The screen that is shown.
    pub screen: Screen,
    /// The screen to which `Esc` returns.
    before: Screen,
    /// The theme in which the screen is drawn.
    pub theme: Theme,
    /// The file in which the chosen theme is stored.
    pub remember: Option<PathBuf>,
    /// Which key has which action.
    pub keymap: Keymap,
    /// The columns that the user chose for the overview, in this order. Each number is the index of a cell in a row. If there
    /// are none, the width of the terminal decides.
    pub columns: Vec<usize>,
    cell: Option<Name>,
    only: Option<String>,
    /// How the rows of the overview are sorted, folded and filtered.
    pub shape: Shape,
    selected: Option<Place>,
    /// Whether the cursor is on the banner, above the first row.
    on_banner: bool,
    port: Option<PortEnd>,
    /// The number of the first shown line, on the screens that only scroll.
    pub scroll: usize,
    /// The number of the last event shown, if the event screen does not follow new events.
    pub held: Option<u64>,
    /// Whether the event screen also shows routine events.
    pub everything: bool,
    /// Whether the event screen leaves discards out.
    pub discards_hidden: bool,
    /// The filter of the event screen.
    event_filter: String,
    /// The filter of the timeline.
    lane_filter: String,
    /// The line that the user types at present: a filter or a command.
    pub entry_line: Option<Entry>,
    /// The lines that were typed before.
    typed_before: Typed,
    /// Whether a line was entered that is not in the file yet.
    is_line_new: bool,
    /// The text on the bottom line; the next key removes it.
    pub told: Option<String>,
    /// The selected title of a column or figure, which the bottom line explains.
    title: Option<&'static str>,
    /// The message whose history is shown.
    message: Option<MessageKey>,
    /// The screen on which the user selected that message.
    chosen_on: Screen,
    /// The selected message of the shown queue. It stays selected while other messages enter and leave the queue.
    entry: Option<(TaskId, MessageId)>,
    /// The selected row of the problems screen.
    problem: Option<ProblemKey>,
    /// The code whose page is shown, and the screen on which the user chose it.
    explained: Option<&'static str>,
    explained_on: Screen,
    /// The screen over which the settings are shown, and the position on that screen.
    settings_over: (Screen, usize),
    lanes: Lanes,
    /// The user's mark: a moment, and the store at that moment, with which counters are compared.
    mark: Option<Box<(Moment, Store)>>,
    /// Whether counters are shown relative to the mark.
    pub since_mark: bool,
    /// Whether the wait-for screen shows only cycles.
    pub only_cycles: bool,
    /// The token for nodes that require one.
    pub token: Option<Token>,
    /// Whether the mouse is used.
    pub mouse: bool,
    /// Whether countdowns are redrawn only once a second.
    pub reduced_motion: bool,
    /// The layout of the last frame.
    drawn: Drawn,
}

impl App {
    /// Makes the overview of an empty store. `only` is the one cell to show, if there is one.
    #[must_use]
    pub fn new(theme: Theme, only: Option<String>) -> Self {
        Self {
            live: Store::of_running_nodes(),
            frozen: None,
            ribbon: None,
            history: History::default(),
            back: wind::Back::default(),
            replay: None,
            recording: None,
            screen: Screen::Overview,
            before: Screen::Overview,
            theme,
            remember: None,
            keymap: Keymap::default(),
            columns: Vec::new(),
            cell: None,
            only,
            shape: Shape::default(),
            selected: None,
            on_banner: false,
            port: None,
            scroll: 0,
            held: None,
            everything: false,
            discards_hidden: false,
            event_filter: String::new(),
            lane_filter: String::new(),
            entry_line: None,
            typed_before: Typed::default(),
            is_line_new: false,
            told: None,
            title: None,
            message: None,
            chosen_on: Screen::Port,
            entry: None,
            problem: None,
            explained: None,
            explained_on: Screen::Problems,
            settings_over: (Screen::Overview, 0),
            lanes: Lanes::default(),
            mark: None,
            since_mark: false,
            only_cycles: false,
            token: None,
            mouse: true,
            reduced_motion: false,
            drawn: Drawn::default(),
        }
    }

    /// Makes the app show a recording.
    #[must_use]
    pub fn replaying(self, player: Player) -> Self {
        Self { replay: Some(Box::new(player)), ..self }
    }

    /// Shows a stop of the recording.
    pub fn show_stop(&mut self, stop: usize) {
        if let Some(player) = &mut self.replay {
            player.go(stop);
        }
    }

    /// The recording that is shown; `None` if running nodes are shown.
    #[must_use]
    pub fn replay(&self) -> Option<&Player> {
        self.replay.as_deref()
    }

    /// The position in the history, while the screen is paused and the user has moved back.
    #[must_use]
    pub fn gone_back(&self) -> Option<&Player> {
        self.back.player()
    }

    /// While paused: which times before the pause the history covers.
    #[must_use]
    pub const fn ribbon(&self) -> Option<&Ribbon> {
        self.ribbon.as_ref()
    }

    /// The history of recent arrivals.
    #[must_use]
    pub const fn history(&self) -> &History {
        &self.history
    }

    /// The subscription that the screen needs.
    #[must_use]
    pub fn want(&self) -> Wanted {
        let end = if self.screen == Screen::Port { self.port(&self.queues()) } else { None };
        let watched = end.and_then(|end| Some((self.live.incarnation(end.incarnation)?, end)));
        let ports = |incarnation: &crate::store::NodeIncarnation| {
            incarnation.tasks().iter().map(|task| task.view.ports.len()).sum::<usize>()
        };
        let many = self.live.incarnations().iter().map(ports).sum::<usize>() > MANY;
        Wanted {
            watched: watched
                .iter()
                .map(|(incarnation, end)| (incarnation.node_id, end.task, end.port))
                .collect(),
            cell: watched.map(|(incarnation, _)| incarnation.names.cell.raw().to_owned()),
            queue_limit: if many { 0 } else { Wanted::default().queue_limit },
            ..Wanted::default()
        }
    }

    /// The store that is shown: that of the running nodes, the one at the pause, or that of a position in a recording.
    #[must_use]
    pub fn store(&self) -> &Store {
        let present = || self.frozen.as_ref().map_or(&self.live, |(store, _)| store);
        self.replay.as_deref().or(self.back.player()).map_or_else(present, Player::store)
    }

    /// The store of the running nodes, also while paused.
    #[must_use]
    pub const fn live(&self) -> &Store {
        &self.live
    }

    /// The moment that the screen shows.
    #[must_use]
    pub fn moment(&self, now: Moment) -> Moment {
        let present = || self.paused().unwrap_or(now);
        self.replay.as_deref().or(self.back.player()).map_or_else(present, Player::moment)
    }

    /// The moment of the pause, if the screen is paused.
    #[must_use]
    pub fn paused(&self) -> Option<Moment> {
        self.frozen.as_ref().map(|(_, at)| *at)
    }

    /// The cell that is shown: the selected cell while it exists, otherwise the first one.
    #[must_use]
    pub fn cell(&self) -> Option<Name> {
        let cells = self.cells();
        self.cell.clone().filter(|c| cells.contains(c)).or_else(|| cells.into_iter().next())
    }

    /// The cells that can be shown.
    #[must_use]
    pub fn cells(&self) -> Vec<Name> {
        let mut cells = self.store().cells();
        cells.retain(|c| self.only.as_ref().is_none_or(|only| c.raw() == only));
        cells
    }

    /// How soon the screen must be redrawn without a message, because it shows a countdown.
    #[must_use]
    pub fn redraw_after(&self) -> Option<Duration> {
        if let Some(player) = &self.replay {
            return player.is_playing().then_some(Duration::from_millis(50));
        }
        if self.frozen.is_some() || self.live.incarnations().is_empty() {
            return None;
        }
        let attached = self.live.incarnations().iter().any(|l| l.condition == Condition::Attached);
        Some(Duration::from_millis(if attached && !self.reduced_motion { 100 } else { 1000 }))
    }

    /// Applies a message to the state.
    pub fn update(&mut self, msg: Msg, now: Moment) -> Effect {
        match msg {
            Msg::Feed(arrival) => {
                self.history.take(&arrival, &self.live);
                self.live.apply(arrival);
                // The screen stays on the cell that it shows, whichever cells appear later.
                self.cell = self.cell.take().or_else(|| self.cell());
                // With reduced motion, frames of nodes do not cause a redraw; the screen is redrawn with the countdowns.
                if self.frozen.is_some() || self.reduced_motion { Effect::Nothing } else { Effect::Draw }
            }
            Msg::Told(text) => {
                self.told = Some(text);
                Effect::Draw
            }
            Msg::Time => {
                let moved = self.replay.as_mut().is_some_and(|player| player.advance(now));
                if moved { Effect::Draw } else { Effect::Nothing }
            }
            Msg::Resize => Effect::Draw,
            Msg::Drawn(drawn) => {
                self.drawn = drawn;
                Effect::Nothing
            }
            Msg::Key(event) if event.kind == KeyEventKind::Release => Effect::Nothing,
            Msg::Key(event) if self.entry_line.is_some() => self.typed(&event, now),
            Msg::Key(event) => {
                let told = self.told.take().is_some();
                let action = self.keymap.action(&event, self.screen);
                let told = told | (action.is_none() && self.lacks_filter(&event));
                let nothing = if told { Effect::Draw } else { Effect::Nothing };
                action.map_or(nothing, |action| self.press(action, now))
            }
            Msg::Mouse(event) => self.clicked(event, now),
        }
    }
}

fn port_end(place: Place) -> Option<PortEnd> {
    Some(PortEnd { incarnation: place.node.ok()?, task: place.task?, port: place.port? })
}
