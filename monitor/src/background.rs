//! Asks the terminal whether its background is light (OSC 11).

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use std::time::Duration;
use terminal_colorsaurus::{QueryOptions, background_color};

/// How long the terminal's answer may take. The first frame waits for it.
const WITHIN: Duration = Duration::from_millis(120);
/// The greatest number of keys that are read as an answer.
const LONGEST: usize = 40;

/// Whether the terminal says that its background is light; `None` if it does not say.
pub fn is_light() -> Option<bool> {
    let mut options = QueryOptions::default();
    options.timeout = WITHIN;
    // Only the background is queried, because some terminals do not answer a query for the text colour.
    let background = background_color(options).ok()?;
    Some(background.perceived_lightness() > 0.5)
}

/// Drops an answer of the terminal that came too late. Such an answer begins with an escape that crossterm does not know, so
/// crossterm reads the answer as keys: Alt and `]`, then `11;rgb:ffff/ffff/ffff`, then Alt and `\\` or Ctrl and `g`.
#[derive(Debug, Default)]
pub struct LateAnswer {
    read: Option<usize>,
}

impl LateAnswer {
    /// Whether a key is a part of a late answer.
    pub fn has(&mut self, key: &KeyEvent) -> bool {
        let alt = key.modifiers.contains(KeyModifiers::ALT);
        let ctrl = key.modifiers.contains(KeyModifiers::CONTROL);
        let Some(read) = self.read else {
            let begins = alt && key.code == KeyCode::Char(']');
            self.read = begins.then_some(0);
            return begins;
        };
        let is_part = match key.code {
            KeyCode::Char('1') => true,
            KeyCode::Char(c) => read > 0 && (c.is_ascii_hexdigit() || "rgb:/;".contains(c)),
            _ => false,
        };
        let ends = alt && key.code == KeyCode::Char('\\') || ctrl && key.code == KeyCode::Char('g');
        self.read = (is_part && !ends && read < LONGEST).then_some(read + 1);
        is_part || ends
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(c: char, modifiers: KeyModifiers) -> KeyEvent {
        KeyEvent::new(KeyCode::Char(c), modifiers)
    }

    #[test]
    fn an_answer_that_comes_late_presses_no_key() {
        for end in [key('\\', KeyModifiers::ALT), key('g', KeyModifiers::CONTROL)] {
            let mut late = LateAnswer::default();
            assert!(late.has(&key(']', KeyModifiers::ALT)));
            for c in "11;rgb:fF0a/1e1e/0000".chars() {
                assert!(late.has(&key(c, KeyModifiers::NONE)), "{c}");
            }
            assert!(late.has(&end));
            for c in "1q:r".chars() {
                assert!(!late.has(&key(c, KeyModifiers::NONE)), "{c} after the end");
            }
        }
    }

    #[test]
    fn keys_of_the_user_are_no_answer() {
        let mut late = LateAnswer::default();
        for c in "1q:r]".chars() {
            assert!(!late.has(&key(c, KeyModifiers::NONE)), "{c}");
        }
        // The test presses only Alt and a bracket: the next key is the user's.
        assert!(late.has(&key(']', KeyModifiers::ALT)));
        assert!(!late.has(&key('r', KeyModifiers::NONE)));
        assert!(!late.has(&key('1', KeyModifiers::NONE)));
        // The test sends more keys than an answer can have.
        assert!(late.has(&key(']', KeyModifiers::ALT)));
        let dropped = (0..1_000).take_while(|_| late.has(&key('1', KeyModifiers::NONE))).count();
        assert!(dropped <= LONGEST + 1, "{dropped}");
    }
}
