//! The settings of the running monitor. Each is a line of the settings screen, and Enter changes it.

use super::{App, Effect, Screen};
use crate::clock::Moment;

/// A setting of the running monitor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setting {
    /// The theme in which the screen is drawn.
    Theme,
    /// Whether the monitor uses clicks and the wheel.
    Mouse,
    /// Whether countdowns are redrawn only once a second.
    ReducedMotion,
    /// Whether the overview shows earlier incarnations.
    Earlier,
    /// Whether the overview counts from the user's mark on.
    SinceMark,
    /// Whether the event screen shows routine events.
    Everything,
    /// Whether the event screen shows discards.
    Discards,
    /// Whether the timeline shows ordinary messages.
    Messages,
    /// Whether the rendezvous screen shows only cycles.
    OnlyCycles,
}

impl Setting {
    /// All settings, in the order of the screen.
    pub const ALL: [Self; 9] = [
        Self::Theme,
        Self::Mouse,
        Self::ReducedMotion,
        Self::Earlier,
        Self::SinceMark,
        Self::Everything,
        Self::Discards,
        Self::Messages,
        Self::OnlyCycles,
    ];

    /// A text about the setting, a shorter one for narrow screens, and its key in the settings file if it has one.
    #[must_use]
    pub const fn about(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::Theme => ("how the screen looks; remembered", "theme", "theme"),
            Self::Mouse => ("clicks and the wheel act, and do not select text", "mouse acts", "mouse"),
            Self::ReducedMotion => {
                ("redraw once a second, and after input", "redraw each second", "reduced_motion")
            }
            Self::Earlier => ("overview: earlier incarnations of the nodes, too", "earlier incarnations", ""),
            Self::SinceMark => ("overview: counters since the mark (m)", "counts since m", ""),
            Self::Everything => ("events: every event, repeated copies, too", "every event", ""),
            Self::Discards => ("events: discards", "discards", ""),
            Self::Messages => ("timeline: ordinary messages", "ordinary messages", ""),
            Self::OnlyCycles => ("rendezvous: only what waits in a cycle", "only wait cycles", ""),
        }
    }
}

impl App {
    /// The present value of a setting, as text.
    #[must_use]
    pub fn setting(&self, setting: Setting) -> &'static str {
        let is_on = match setting {
            Setting::Theme => return self.theme.name,
            Setting::Mouse => self.mouse,
            Setting::ReducedMotion => self.reduced_motion,
            Setting::Earlier => self.shape.earlier,
            Setting::SinceMark => self.since_mark,
            Setting::Everything => self.everything,
            Setting::Discards => !self.discards_hidden,
            Setting::Messages => !self.is_chart_thin(),
            Setting::OnlyCycles => self.only_cycles,
        };
        if is_on { "on" } else { "off" }
    }

    /// Changes the selected setting.
    pub(super) fn change_setting(&mut self, now: Moment) -> Effect {
        let Some(setting) = Setting::ALL.get(self.scroll).copied() else { return Effect::Draw };
        match setting {
            Setting::Theme => return self.next_theme(),
            Setting::Mouse => {
                self.mouse = !self.mouse;
                return Effect::Mouse(self.mouse);
            }
            Setting::ReducedMotion => self.reduced_motion = !self.reduced_motion,
            Setting::Earlier => self.shape.earlier = !self.shape.earlier,
            Setting::SinceMark if self.mark.is_none() => self.set_mark(now),
            Setting::SinceMark => self.since_mark = !self.since_mark,
            Setting::Everything => (self.everything, self.held) = (!self.everything, None),
            Setting::Discards => self.hide_discards(),
            Setting::Messages => self.thin_chart(),
            Setting::OnlyCycles => self.only_cycles = !self.only_cycles,
        }
        Effect::Draw
    }

    pub(super) fn next_theme(&mut self) -> Effect {
        self.theme = self.theme.next();
        Effect::Theme
    }

    /// Opens the settings screen, or returns to the screen from which it was opened.
    pub(super) fn toggle_settings(&mut self) {
        if self.screen == Screen::Settings {
            (self.screen, self.scroll) = self.settings_over;
        } else {
            self.settings_over = (self.screen, self.scroll);
            (self.screen, self.scroll) = (Screen::Settings, 0);
        }
    }
}
