//! Replays a recording of observations: the same screens as for running nodes, at any stop of the recording.
//!
//! A [`Film`] is the recording, and a [`Player`] is a position in it that may move. The position depends only on the
//! film, the keys pressed and the given moments.

mod film;
mod ribbon;
pub(crate) mod tell;
mod trouble;

pub use film::{Film, Reel, Stop};
pub use ribbon::Ribbon;
pub use trouble::Trouble;
pub(crate) use trouble::Troubles;

use crate::clock::{Moment, Span};
use crate::source::Arrival;
use crate::store::Store;
pub(crate) use film::Scene;
use imrs_wire::recording::Step;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// The greatest number of intermediate states that are kept, so that moving back is quick.
const KEPT: usize = 32;
/// The approximate memory limit of the kept intermediate states, in bytes. One state is kept even if it is larger.
const KEPT_BYTES: usize = 12 << 20;
/// The least number of stops between two kept states.
const APART: usize = 16;
/// If moving to a stop had to apply many frames, the state this many stops before it is kept, too, so that the next
/// steps back are quick.
const NEAR: usize = 64;
/// How long a step of a counterexample is shown at speed 1. Its real duration, in ticks, would be too short.
const STEP: Duration = Duration::from_secs(1);

/// A position in a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum At {
    /// A position this long after the beginning.
    After(Duration),
    /// A position this long before the end.
    BeforeEnd(Duration),
    /// The position at a tick of a counterexample, or at a second of another recording.
    Tick(u64),
}

/// The error that a text is not a position.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{0}` is no time: write 3s, 1500ms, -30s (before the end), or the tick of a counterexample")]
pub struct AtError(String);

impl FromStr for At {
    type Err = AtError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let error = || AtError(crate::name::shown(text));
        if let Ok(tick) = text.parse() {
            return Ok(Self::Tick(tick));
        }
        let (end, rest) = text.strip_prefix('-').map_or((false, text), |rest| (true, rest));
        let digits = rest.trim_end_matches(|c: char| c.is_ascii_alphabetic());
        let number: f64 = digits.parse().map_err(|_| error())?;
        let unit = match &rest[digits.len()..] {
            "us" => 1e-6,
            "ms" => 1e-3,
            "s" => 1.0,
            "m" | "min" => 60.0,
            "h" => 3600.0,
            _ => return Err(error()),
        };
        let length = Duration::try_from_secs_f64(number * unit).map_err(|_| error())?;
        Ok(if end { Self::BeforeEnd(length) } else { Self::After(length) })
    }
}

/// A position in a recording. If the recording plays, the position moves.
#[derive(Clone, Debug)]
pub struct Player {
    film: Arc<Film>,
    store: Store,
    step: Option<Step>,
    /// The stop that is shown.
    stop: usize,
    /// The time that is shown. While the recording plays, it lies between two stops.
    at: Moment,
    /// While the recording plays: the moment, the stop and the shown time at which it started to play.
    playing: Option<(Moment, usize, Moment)>,
    speed: f64,
    /// How often the panel of the shown stop was turned to its next lines.
    panel_page: usize,
    /// The kept intermediate states, in the order of their stops.
    kept: Vec<Kept>,
    /// The number of stops between two kept states.
    apart: usize,
    /// The state shortly before the last stop to which the user moved and for which many frames had to be applied.
    near: Option<Kept>,
}

/// The kept state at a stop.
#[derive(Clone, Debug)]
struct Kept {
    stop: usize,
    store: Store,
    step: Option<Step>,
}

impl Player {
    /// A player at the first stop, paused. `speed` is the multiple of the recorded speed at which it plays.
    #[must_use]
    pub fn new(film: Arc<Film>, speed: f64) -> Self {
        let mut player = Self {
            film,
            store: Store::default(),
            step: None,
            stop: 0,
            at: Duration::ZERO,
            playing: None,
            speed,
            panel_page: 0,
            kept: Vec::new(),
            apart: 0,
            near: None,
        };
        player.apart = player.film.stops().len().div_ceil(KEPT).max(APART);
        player.show(None, 0);
        player
    }

    /// The recording that is shown.
    #[must_use]
    pub fn film(&self) -> &Film {
        &self.film
    }

    /// The store at the shown stop.
    #[must_use]
    pub const fn store(&self) -> &Store {
        &self.store
    }

    /// The step of a counterexample that is shown.
    #[must_use]
    pub const fn step(&self) -> Option<&Step> {
        self.step.as_ref()
    }

    /// The index of the shown stop.
    #[must_use]
    pub const fn stop(&self) -> usize {
        self.stop
    }

    /// How often the panel of the shown stop was turned to its next lines.
    pub(crate) const fn panel_page(&self) -> usize {
        self.panel_page
    }

    /// Turns the panel of the shown stop to its next lines.
    pub(crate) const fn turn_panel(&mut self) {
        self.panel_page = self.panel_page.wrapping_add(1);
    }

    /// The time that is shown.
    #[must_use]
    pub const fn moment(&self) -> Moment {
        self.at
    }

    /// Whether the recording plays.
    #[must_use]
    pub const fn is_playing(&self) -> bool {
        self.playing.is_some()
    }

    /// Whether the last stop is shown.
    #[must_use]
    pub fn is_at_end(&self) -> bool {
        self.stop + 1 == self.film.stops().len()
    }

    /// The position as text: `3/17 tick 4`, or `1.20s of 9.00s`.
    #[must_use]
    pub fn position(&self) -> String {
        match (&self.step, &self.film.story) {
            (Some(step), Some(story)) => format!("{}/{} tick {}", step.number, story.steps, step.tick),
            _ => format!("{} of {}", Span(self.at), Span(self.film.length())),
        }
    }

    /// Applies an arrival that the recording does not contain to the shown store.
    pub(crate) fn add(&mut self, arrival: Arrival) {
        self.store.apply(arrival);
    }

    /// Moves to the stop at a position, and pauses.
    pub fn seek(&mut self, at: At) {
        let length = self.film.length();
        let tick_us = self.film.story.as_ref().map_or(1_000_000, |story| story.tick_us);
        let at = match at {
            At::After(after) => after,
            At::BeforeEnd(before) => length.saturating_sub(before),
            At::Tick(tick) => Duration::from_micros(tick.saturating_mul(tick_us)),
        };
        self.go(self.film.stop_at(at.min(length)));
    }

    /// Moves to a stop, and pauses.
    pub fn go(&mut self, stop: usize) {
        self.playing = None;
        self.turn_to(stop.min(self.film.stops().len().saturating_sub(1)));
    }

    /// Moves by this many stops.
    pub fn step_by(&mut self, by: isize) {
        self.go(self.stop.saturating_add_signed(by));
    }

    /// Moves to the last stop.
    pub fn go_to_end(&mut self) {
        self.go(usize::MAX);
    }

    /// The gravest trouble between the previous stop and the present one.
    pub(crate) fn trouble(&self) -> Trouble {
        self.film.stops().get(self.stop).map_or(Trouble::None, |stop| stop.trouble)
    }

    /// Moves to the next or previous stop with a grave trouble or, if there is none, with a slight one.
    pub fn go_to_trouble(&mut self, forward: bool) {
        let stops = self.film.stops();
        let find = |least: Trouble| {
            let has = |&at: &usize| stops[at].trouble >= least;
            if forward { (self.stop + 1..stops.len()).find(has) } else { (0..self.stop).rev().find(has) }
        };
        self.go(find(Trouble::Grave).or_else(|| find(Trouble::Slight)).unwrap_or(self.stop));
    }

    /// Plays or pauses. At the end it plays from the beginning.
    pub fn toggle(&mut self, now: Moment) {
        if self.playing.take().is_none() {
            if self.is_at_end() {
                self.turn_to(0);
            }
            self.playing = Some((now, self.stop, self.at));
        }
    }

    /// Advances to the position at the moment `now`. Returns whether the recording plays, so that the screen may have
    /// changed.
    pub fn advance(&mut self, now: Moment) -> bool {
        let Some((since, from, at)) = self.playing else { return false };
        let passed = now.saturating_sub(since).as_secs_f64() * self.speed;
        let last = self.film.stops().len().saturating_sub(1);
        let to = if self.film.story.is_some() {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of steps")]
            let steps = (passed / STEP.as_secs_f64()) as usize;
            from.saturating_add(steps).min(last)
        } else {
            let to = at.saturating_add(Duration::try_from_secs_f64(passed).unwrap_or(Duration::MAX));
            self.at = to.min(self.film.length());
            self.film.stop_at(self.at)
        };
        let between = self.at;
        if to != self.stop {
            self.turn_to(to);
        }
        if self.film.story.is_none() {
            self.at = between;
        }
        if to == last {
            self.playing = None;
        }
        true
    }

    fn turn_to(&mut self, stop: usize) {
        self.panel_page = 0;
        if stop < self.stop {
            let before = self.kept.iter().chain(&self.near).filter(|kept| kept.stop <= stop);
            let kept = before.max_by_key(|kept| kept.stop).cloned();
            let from = kept.map(|kept| {
                (self.store, self.step) = (kept.store, kept.step);
                kept.stop
            });
            if from.is_none() {
                (self.store, self.step) = (Store::default(), None);
            }
            self.show(from, stop);
        } else if stop > self.stop {
            self.show(Some(self.stop), stop);
        }
    }

    /// Applies the frames after stop `from` (with `None`, from the beginning on) up to stop `to`.
    fn show(&mut self, from: Option<usize>, to: usize) {
        let film = Arc::clone(&self.film);
        let stops = film.stops();
        let first = from.map_or(0, |from| from + 1);
        let near = to.checked_sub(NEAR).filter(|near| *near > first + NEAR);
        let mut next = from.and_then(|from| stops.get(from)).map_or(0, |stop| stop.frames);
        for (number, stop) in stops.iter().enumerate().take(to + 1).skip(first) {
            for frame in next..stop.frames {
                match film.scene(frame) {
                    Scene::Arrival(arrival) => self.store.apply(arrival),
                    Scene::Step(step) => self.step = Some(step),
                    Scene::Nothing => {}
                }
            }
            next = stop.frames;
            let last = self.kept.last().map_or(0, |last| last.stop);
            if number >= last.saturating_add(self.apart) && self.make_room() {
                self.kept.push(self.keep(number));
            }
            if near == Some(number) {
                self.near = None;
                self.make_room();
                self.near = Some(self.keep(number));
            }
        }
        self.stop = to;
        self.at = stops.get(to).map_or(Duration::ZERO, |stop| stop.at);
    }

    fn keep(&self, stop: usize) -> Kept {
        Kept { stop, store: self.store.clone(), step: self.step.clone() }
    }

    /// Drops every second kept state, and doubles the distance between kept states, until the memory limit has room
    /// for the shown state, too. Returns whether there is room: in a very large cell `near` alone may fill the limit.
    fn make_room(&mut self) -> bool {
        let weight = |kept: &Kept| kept.store.weight();
        let more = self.store.weight() + self.near.as_ref().map_or(0, weight);
        let fits =
            |kept: &[Kept]| kept.len() < KEPT && more + kept.iter().map(weight).sum::<usize>() <= KEPT_BYTES;
        while !self.kept.is_empty() && !fits(&self.kept) {
            let mut at = 0;
            self.kept.retain(|_| {
                at += 1;
                at % 2 == 0
            });
            self.apart = self.apart.saturating_mul(2);
        }
        fits(&self.kept)
    }
}
