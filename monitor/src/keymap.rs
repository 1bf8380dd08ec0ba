//! The user's own keys: which keys an action has in place of the usual ones. Also the names of actions and keys in the
//! settings file.

use crate::keys::{Action, BINDINGS, Binding, Key, hinted};
use crate::screen::Screen;
use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use std::str::FromStr;

/// Which keys each action has.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Keymap {
    own: Vec<(Action, Vec<Key>)>,
}

/// ^C always ends the monitor, whatever the settings say.
const ALWAYS: Key = Key { code: KeyCode::Char('c'), ctrl: true };

impl Keymap {
    /// The usual keys, with other keys for some actions.
    ///
    /// # Errors
    /// An error if a key has two actions that apply on the same screen.
    pub fn of(own: Vec<(Action, Vec<Key>)>) -> Result<Self, String> {
        for (at, (action, keys)) in own.iter().enumerate() {
            for (other, others) in &own[..at] {
                let both = keys.iter().find(|key| others.contains(key));
                if let Some(key) = both.filter(|_| meet(*action, *other)) {
                    let (a, b) = (name(*other), name(*action));
                    return Err(format!("`{}` cannot be both `{a}` and `{b}`", key.label()));
                }
            }
        }
        Ok(Self { own })
    }

    /// The action that the key press `event` has on `screen`. The user's own keys take precedence.
    #[must_use]
    pub fn action(&self, event: &KeyEvent, screen: Screen) -> Option<Action> {
        let pressed = Key { code: event.code, ctrl: event.modifiers.contains(KeyModifiers::CONTROL) };
        if pressed == ALWAYS {
            return Some(Action::Quit);
        }
        let is_on = |action: Action| BINDINGS.iter().any(|b| b.action == action && b.is_on(screen));
        let own = self.own.iter().find(|(action, keys)| keys.contains(&pressed) && is_on(*action));
        own.map(|(action, _)| *action).or_else(|| {
            let fits = |b: &&Binding| b.is_on(screen) && self.keys(b).contains(&pressed);
            BINDINGS.iter().find(fits).map(|b| b.action)
        })
    }

    /// The keys of a binding.
    #[must_use]
    pub fn keys<'a>(&'a self, binding: &'a Binding) -> &'a [Key] {
        let own = self.own.iter().find(|(action, _)| *action == binding.action);
        own.map_or(binding.keys, |(_, keys)| keys)
    }

    /// The keys of a binding, in the form in which the help shows them.
    #[must_use]
    pub fn label(&self, binding: &Binding) -> String {
        let names: Vec<_> = self.keys(binding).iter().map(|key| key.label()).collect();
        names.join(" ")
    }

    /// The keys of an action that has one binding, in the form in which the help shows them.
    #[must_use]
    pub fn label_of(&self, action: Action) -> String {
        BINDINGS.iter().find(|binding| binding.action == action).map_or_else(String::new, |b| self.label(b))
    }

    /// The hints at keys for a screen, the help first: `? help`, `Enter open`, each with its action.
    pub fn hints(&self, screen: Screen) -> impl Iterator<Item = (String, Action)> + '_ {
        let help = [(Action::Show(Screen::Help), "help")];
        let all = help.into_iter().chain(hinted(screen).iter().copied()).chain([(Action::Quit, "quit")]);
        all.filter_map(move |(action, word)| {
            let binding =
                BINDINGS.iter().find(|binding| binding.action == action && binding.is_on(screen))?;
            let keys = self.keys(binding);
            // A special key such as Enter is easier to understand than a letter with the same action.
            let is_letter = |key: &Key| matches!(key.code, KeyCode::Char('a'..='z'));
            let key = keys.iter().find(|key| !is_letter(key)).or_else(|| keys.first())?;
            let key = if action == Action::Quit { keys.first()? } else { key };
            Some((format!("{} {word}", key.label()), action))
        })
    }
}

/// Whether there is a screen on which both actions apply.
fn meet(a: Action, b: Action) -> bool {
    let on = |action: Action, screen: Screen| BINDINGS.iter().any(|b| b.action == action && b.is_on(screen));
    a != b && Screen::ALL.into_iter().any(|screen| on(a, screen) && on(b, screen))
}

/// The names of the actions in the settings file.
const NAMES: &[(Action, &str)] = &[
    (Action::Show(Screen::Overview), "overview"),
    (Action::Show(Screen::Port), "port"),
    (Action::Show(Screen::Rendezvous), "rendezvous"),
    (Action::Show(Screen::Timeline), "timeline"),
    (Action::Show(Screen::Timers), "timers"),
    (Action::Show(Screen::Events), "events"),
    (Action::Show(Screen::Model), "model"),
    (Action::Show(Screen::Problems), "problems"),
    (Action::Show(Screen::Help), "help"),
    (Action::Up, "up"),
    (Action::Down, "down"),
    (Action::PageUp, "page_up"),
    (Action::PageDown, "page_down"),
    (Action::First, "first"),
    (Action::Last, "last"),
    (Action::Left, "left"),
    (Action::Right, "right"),
    (Action::NextTitle, "next_title"),
    (Action::PreviousTitle, "previous_title"),
    (Action::Enter, "enter"),
    (Action::Back, "back"),
    (Action::Filter, "filter"),
    (Action::Sort, "sort"),
    (Action::Invert, "invert"),
    (Action::Pause, "pause"),
    (Action::Everything, "everything"),
    (Action::Discards, "discards"),
    (Action::NextError, "next_error"),
    (Action::PreviousError, "previous_error"),
    (Action::Oldest, "oldest"),
    (Action::Newest, "newest"),
    (Action::StepBack, "step_back"),
    (Action::StepOn, "step_on"),
    (Action::PreviousAnomaly, "previous_anomaly"),
    (Action::NextAnomaly, "next_anomaly"),
    (Action::MoreOfStep, "more_of_step"),
    (Action::Record, "record"),
    (Action::Write, "write"),
    (Action::Copy, "copy"),
    (Action::Command, "command"),
    (Action::Mark, "mark"),
    (Action::Difference, "difference"),
    (Action::Cycles, "cycles"),
    (Action::Closer, "closer"),
    (Action::Wider, "wider"),
    (Action::NextMatch, "next_match"),
    (Action::PreviousMatch, "previous_match"),
    (Action::Cell, "cell"),
    (Action::Explain, "explain"),
    (Action::Culprit, "culprit"),
    (Action::Settings, "settings"),
    (Action::Theme, "theme"),
    (Action::Suspend, "suspend"),
    (Action::Quit, "quit"),
];

fn name(action: Action) -> &'static str {
    NAMES.iter().find(|(known, _)| *known == action).map_or("", |(_, name)| name)
}

impl FromStr for Action {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = NAMES.iter().find(|(_, name)| *name == text);
        found.map(|(action, _)| *action).ok_or_else(|| {
            let names: Vec<_> = NAMES.iter().map(|(_, name)| *name).collect();
            crate::name::unknown("action", text, &names)
        })
    }
}

/// The keys that have names, as they are written.
const SPECIAL: [(&str, KeyCode); 15] = [
    ("space", KeyCode::Char(' ')),
    ("enter", KeyCode::Enter),
    ("esc", KeyCode::Esc),
    ("tab", KeyCode::Tab),
    ("shift-tab", KeyCode::BackTab),
    ("backspace", KeyCode::Backspace),
    ("insert", KeyCode::Insert),
    ("delete", KeyCode::Delete),
    ("home", KeyCode::Home),
    ("end", KeyCode::End),
    ("pageup", KeyCode::PageUp),
    ("pagedown", KeyCode::PageDown),
    ("up", KeyCode::Up),
    ("down", KeyCode::Down),
    ("left", KeyCode::Left),
];

impl FromStr for Key {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "no key `{}`: write one sign (`p`), ctrl and a letter (`^p`), or enter, space, pageup, left, f5 ...",
                crate::name::shown(text)
            )
        };
        let (ctrl, rest) = match text.strip_prefix('^') {
            Some(rest) if !rest.is_empty() => (true, rest.to_lowercase()),
            _ => (false, text.to_owned()),
        };
        let mut signs = rest.chars();
        if let (Some(sign), None) = (signs.next(), signs.next()) {
            return if sign.is_control() {
                Err(wrong())
            } else {
                Ok(Self { code: KeyCode::Char(sign), ctrl })
            };
        }
        let word = rest.to_lowercase();
        let special = SPECIAL.iter().find(|(name, _)| *name == word).map(|(_, code)| *code);
        let right = (word == "right").then_some(KeyCode::Right);
        let function = word.strip_prefix('f').and_then(|number| number.parse().ok());
        let function = function.filter(|number| (1..=12).contains(number)).map(KeyCode::F);
        let code = special.or(right).or(function).filter(|_| !ctrl).ok_or_else(wrong)?;
        Ok(Self { code, ctrl })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn press(code: KeyCode, modifiers: KeyModifiers) -> KeyEvent {
        KeyEvent::new(code, modifiers)
    }

    #[test]
    fn each_action_of_the_table_has_a_name_of_its_own() {
        for binding in BINDINGS {
            assert_eq!(name(binding.action).parse(), Ok(binding.action), "{:?}", binding.action);
        }
        let mut names: Vec<_> = NAMES.iter().map(|(_, name)| *name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), NAMES.len());
    }

    #[test]
    fn each_key_of_the_table_can_be_written() {
        for key in BINDINGS.iter().flat_map(|b| b.keys) {
            let label = key.label().replace("PgUp", "pageup").replace("PgDn", "pagedown");
            assert_eq!(label.parse::<Key>(), Ok(*key), "{label}");
        }
        assert_eq!("f5".parse(), Ok(Key { code: KeyCode::F(5), ctrl: false }));
        for wrong in ["", "f0", "f13", "hyper", "^", "^enter", "pp"] {
            let known = wrong.parse::<Key>();
            assert!(known.is_err() || wrong == "^", "{wrong}: {known:?}");
        }
    }

    #[test]
    fn own_keys_replace_those_of_the_table() {
        let map = Keymap::of(vec![(Action::Pause, vec!["p".parse().unwrap()])]).unwrap();
        let p = press(KeyCode::Char('p'), KeyModifiers::NONE);
        let space = press(KeyCode::Char(' '), KeyModifiers::NONE);
        for screen in Screen::ALL {
            assert_eq!(map.action(&p, screen), Some(Action::Pause));
            assert_eq!(map.action(&space, screen), None);
        }
        // A key that the user gives to one action loses its usual action.
        let map = Keymap::of(vec![(Action::Pause, vec!["q".parse().unwrap()])]).unwrap();
        let q = press(KeyCode::Char('q'), KeyModifiers::NONE);
        assert_eq!(map.action(&q, Screen::Overview), Some(Action::Pause));
        let quit = press(KeyCode::Char('c'), KeyModifiers::CONTROL);
        let none = Keymap::of(vec![(Action::Quit, Vec::new())]).unwrap();
        assert_eq!(none.action(&quit, Screen::Overview), Some(Action::Quit));
    }

    #[test]
    fn a_key_cannot_mean_two_things_on_one_screen() {
        let p = || vec!["p".parse::<Key>().unwrap()];
        let both = Keymap::of(vec![(Action::Pause, p()), (Action::Theme, p())]);
        assert_eq!(both, Err("`p` cannot be both `pause` and `theme`".to_owned()));
        // These two actions never apply on the same screen.
        assert!(Keymap::of(vec![(Action::Cycles, p()), (Action::Sort, p())]).is_ok());
    }
}
