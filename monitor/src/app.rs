//! What is on the screen, as a value; everything that happens is a [`Msg`] that [`App::update`] reduces.

mod command;
pub mod lanes;
mod mouse;
mod shown;
mod steer;

pub use command::COMMANDS;

use crate::clock::Moment;
use crate::history::History;
use crate::keys;
use crate::name::Name;
use crate::options::Endpoint;
use crate::replay::Player;
use crate::rows::Shape;
pub use crate::screen::Screen;
use crate::source::{Arrival, Wanted};
use crate::store::health::Place;
use crate::store::message::MessageKey;
use crate::store::{Condition, LifeId, Store};
use crate::theme::Theme;
use crossterm::event::{KeyEvent, KeyEventKind, MouseEvent};
use imrs_protocol::{MessageId, PortId, TaskId};
use imrs_wire::obs::Token;
use lanes::Lanes;
use std::time::Duration;

/// Of more ports than this only the queues that are looked at are asked for.
const MANY: usize = 2_000;

/// Something that happened to the monitor.
#[derive(Clone, Debug)]
pub enum Msg {
    /// A source said something.
    Feed(Arrival),
    /// A key was pressed.
    Key(KeyEvent),
    /// The mouse did something.
    Mouse(MouseEvent),
    /// The main loop has something to tell the user, at the foot.
    Told(String),
    /// The screen is now so many columns and rows.
    Resize(u16, u16),
    /// Time has passed: a recording that plays moves on.
    Time,
}

/// What the main loop has to do after a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Nothing: the screen is as it was.
    Nothing,
    /// Draw.
    Draw,
    /// Begin a recording, or end it.
    Record,
    /// Write the screen as text into a file.
    Write,
    /// Give this to the terminal's clipboard.
    Copy(String),
    /// Attach to this node too.
    Connect(Endpoint),
    /// Give the terminal back until the user returns.
    Suspend,
    /// End.
    Quit,
}

/// One end of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PortEnd {
    /// At this node.
    pub life: LifeId,
    /// At this task.
    pub task: TaskId,
    /// This port.
    pub port: PortId,
}

/// All that the screen depends on, besides the moment.
#[derive(Clone, Debug)]
pub struct App {
    live: Store,
    /// While paused: the store as it was, and when.
    frozen: Option<(Box<Store>, Moment)>,
    /// What came in lately.
    history: History,
    /// While paused and gone back: where in it.
    back: Option<Box<Player>>,
    /// The recording shown instead of running nodes.
    replay: Option<Box<Player>>,
    /// Where what comes in is recorded to.
    pub recording: Option<String>,
    /// The screen shown.
    pub screen: Screen,
    /// The screen that `Esc` returns to.
    before: Screen,
    /// How it looks.
    pub theme: Theme,
    cell: Option<Name>,
    only: Option<String>,
    /// The rows of the overview.
    pub shape: Shape,
    selected: Option<Place>,
    port: Option<PortEnd>,
    /// The first line shown on the screens that only scroll.
    pub scroll: usize,
    /// While not following: the number of the last event shown.
    pub held: Option<u64>,
    /// Whether the ordinary course of events is shown too.
    pub everything: bool,
    /// Whether keys go into the filter.
    pub typing: bool,
    /// The command that is typed.
    pub command: Option<String>,
    /// What was last told at the foot; the next key takes it away.
    pub told: Option<String>,
    /// The message whose life is shown.
    message: Option<MessageKey>,
    /// The screen that it was chosen on.
    chosen_on: Screen,
    /// The selected message of the queue shown: it stays selected while others come and go.
    entry: Option<(TaskId, MessageId)>,
    lanes: Lanes,
    /// What the user marked, to compare with.
    mark: Option<Box<(Moment, Store)>>,
    /// Whether counters are shown since the mark.
    pub since_mark: bool,
    /// Whether only what is in a wait-for cycle is shown of who waits for whom.
    pub only_cycles: bool,
    /// What nodes that ask for it are shown.
    pub token: Option<Token>,
    /// Whether the mouse is used.
    pub mouse: bool,
    /// Whether countdowns are drawn once a second only.
    pub reduced_motion: bool,
    size: (u16, u16),
}

impl App {
    /// The overview of an empty store. `only`: the one cell to show.
    #[must_use]
    pub fn new(theme: Theme, only: Option<String>) -> Self {
        Self {
            live: Store::of_running_nodes(),
            frozen: None,
            history: History::default(),
            back: None,
            replay: None,
            recording: None,
            screen: Screen::Overview,
            before: Screen::Overview,
            theme,
            cell: None,
            only,
            shape: Shape::default(),
            selected: None,
            port: None,
            scroll: 0,
            held: None,
            everything: false,
            typing: false,
            command: None,
            told: None,
            message: None,
            chosen_on: Screen::Port,
            entry: None,
            lanes: Lanes::default(),
            mark: None,
            since_mark: false,
            only_cycles: false,
            token: None,
            mouse: true,
            reduced_motion: false,
            size: (80, 24),
        }
    }

    /// The overview of a recording.
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

    /// The recording shown, if one is.
    #[must_use]
    pub fn replay(&self) -> Option<&Player> {
        self.replay.as_deref()
    }

    /// The place in the present run that is shown, while the screen stands still and the user has gone back.
    #[must_use]
    pub fn gone_back(&self) -> Option<&Player> {
        self.back.as_deref()
    }

    /// What came in lately.
    #[must_use]
    pub const fn history(&self) -> &History {
        &self.history
    }

    /// What the screen needs of the nodes.
    #[must_use]
    pub fn want(&self) -> Wanted {
        let end = if self.screen == Screen::Port { self.port(&self.queues()) } else { None };
        let watched = end.and_then(|end| Some((self.live.life(end.life)?, end)));
        let ports =
            |life: &crate::store::Life| life.tasks().iter().map(|task| task.view.ports.len()).sum::<usize>();
        let many = self.live.lives().iter().map(ports).sum::<usize>() > MANY;
        Wanted {
            watched: watched.iter().map(|(life, end)| (life.node_id, end.task, end.port)).collect(),
            cell: watched.map(|(life, _)| life.names.cell.raw().to_owned()),
            queue_limit: if many { 0 } else { Wanted::default().queue_limit },
            ..Wanted::default()
        }
    }

    /// What is shown: the present, what was when the user paused, or a place in a recording.
    #[must_use]
    pub fn store(&self) -> &Store {
        if let Some(player) = self.replay.as_ref().or(self.back.as_ref()) {
            return player.store();
        }
        self.frozen.as_ref().map_or(&self.live, |(store, _)| store)
    }

    /// The present, also while paused.
    #[must_use]
    pub const fn live(&self) -> &Store {
        &self.live
    }

    /// The moment that the screen shows.
    #[must_use]
    pub fn moment(&self, now: Moment) -> Moment {
        if let Some(player) = self.replay.as_ref().or(self.back.as_ref()) {
            return player.moment();
        }
        self.frozen.as_ref().map_or(now, |(_, at)| *at)
    }

    /// Since when the screen has stood still.
    #[must_use]
    pub fn paused(&self) -> Option<Moment> {
        self.frozen.as_ref().map(|(_, at)| *at)
    }

    /// The cell shown: the chosen one while it exists, or else the first.
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

    /// How soon the screen must be drawn again though nothing comes in, because a countdown is on it.
    #[must_use]
    pub fn redraw_after(&self) -> Option<Duration> {
        if let Some(player) = &self.replay {
            return player.is_playing().then_some(Duration::from_millis(50));
        }
        if self.frozen.is_some() || self.live.lives().is_empty() {
            return None;
        }
        let attached = self.live.lives().iter().any(|l| l.condition == Condition::Attached);
        Some(Duration::from_millis(if attached && !self.reduced_motion { 100 } else { 1000 }))
    }

    /// Takes a message over.
    pub fn update(&mut self, msg: Msg, now: Moment) -> Effect {
        match msg {
            Msg::Feed(arrival) => {
                self.history.take(&arrival, &self.live);
                self.live.apply(arrival);
                // With reduced motion the screen changes with the countdowns, not with every word of a node.
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
            Msg::Resize(width, height) => {
                self.size = (width, height);
                Effect::Draw
            }
            Msg::Key(event) if event.kind == KeyEventKind::Release => Effect::Nothing,
            Msg::Key(event) if self.typing => self.typed(&event),
            Msg::Key(event) if self.command.is_some() => self.typed_command(&event),
            Msg::Key(event) => {
                let told = self.told.take().is_some();
                let effect = keys::action(&event, self.screen).map(|action| self.act(action, now));
                let nothing = if told { Effect::Draw } else { Effect::Nothing };
                effect.unwrap_or(nothing)
            }
            Msg::Mouse(event) => self.clicked(event, now),
        }
    }
}

fn port_end(place: Place) -> Option<PortEnd> {
    Some(PortEnd { life: place.node.ok()?, task: place.task?, port: place.port? })
}
