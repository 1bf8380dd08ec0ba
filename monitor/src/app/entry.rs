//! The line that the user types: a filter after `/`, or a command after `:`. It has a cursor, a history and
//! completions, and errors in it are shown while the user types.

use super::complete::{Completion, word_at};
use super::{App, Effect, Screen};
use crate::clock::Moment;
use crate::keys::Action;
use crate::query::Filter;
use crate::typed::{Kind, Typed};
use crossterm::event::{Event, KeyCode, KeyEvent, KeyModifiers};
use tui_input::Input;
use tui_input::backend::crossterm::EventHandler as _;

/// The line that is typed.
#[derive(Clone, Debug)]
pub struct Entry {
    /// The purpose of the line.
    pub kind: Kind,
    /// The screen on which the line was opened, and to which its filter belongs.
    screen: Screen,
    /// The text of the line, and the cursor.
    pub input: Input,
    /// While the user leafs through the history: how far back, and the text that the user had typed before.
    back: Option<(usize, String)>,
    /// While the user tries completions: all of them, and the position of the one that is shown.
    tried: Option<(Completion, usize)>,
}

impl App {
    /// Begins with the lines that were typed in an earlier run.
    pub fn remember_typed(&mut self, typed: Typed) {
        self.typed_before = typed;
    }

    /// The lines to be kept for the next run, if one was entered since the last call.
    pub fn take_typed(&mut self) -> Option<Typed> {
        std::mem::take(&mut self.is_line_new).then(|| self.typed_before.clone())
    }

    /// Opens a line. The line for a filter begins with the screen's present filter.
    pub(super) fn open_entry(&mut self, kind: Kind) {
        let text = if kind == Kind::Filter { self.filter().to_owned() } else { String::new() };
        self.type_on(kind, text);
    }

    /// If the key is that of the filter on other screens, says that this screen has none. Returns whether it did.
    pub(super) fn lacks_filter(&mut self, event: &KeyEvent) -> bool {
        let is_filter = self.keymap.action(event, Screen::Overview) == Some(Action::Filter);
        if is_filter {
            self.told = Some("no filter on this screen; there is one on 1, 4 and 6".to_owned());
        }
        is_filter
    }

    fn type_on(&mut self, kind: Kind, text: String) {
        let screen = self.screen;
        self.entry_line = Some(Entry { kind, screen, input: text.into(), back: None, tried: None });
    }

    /// Opens the line for commands, with the word of a command.
    pub(super) fn open_command(&mut self, word: &str) {
        let has_more =
            super::COMMANDS.iter().any(|(usage, _)| usage.split(' ').next() == Some(word) && *usage != word);
        let text = format!("{word}{}", if has_more { " " } else { "" });
        self.type_on(Kind::Command, text);
    }

    /// Handles a key while the user types a line.
    pub(super) fn typed(&mut self, event: &KeyEvent, now: Moment) -> Effect {
        let Some(entry) = &mut self.entry_line else { return Effect::Nothing };
        let (kind, screen, ctrl) =
            (entry.kind, entry.screen, event.modifiers.contains(KeyModifiers::CONTROL));
        if !matches!(event.code, KeyCode::Tab | KeyCode::BackTab) {
            entry.tried = None;
        }
        match event.code {
            KeyCode::Char('c') if ctrl => return Effect::Quit,
            KeyCode::Char('z') if ctrl => return Effect::Suspend,
            KeyCode::Backspace if kind == Kind::Command && entry.input.value().is_empty() => {
                self.entry_line = None;
            }
            KeyCode::Esc => {
                self.entry_line = None;
                if kind == Kind::Filter {
                    self.filter_mut(screen).clear();
                }
            }
            KeyCode::Enter => return self.enter_typed(now),
            KeyCode::Up | KeyCode::Down => self.leaf(event.code == KeyCode::Up),
            KeyCode::Tab | KeyCode::BackTab => self.complete(event.code == KeyCode::Tab),
            _ => {
                if entry.input.handle_event(&Event::Key(*event)).is_none() {
                    return Effect::Nothing;
                }
            }
        }
        self.apply_filter();
        Effect::Draw
    }

    /// Closes the input line before the monitor does something else. A filter that was typed only in part stays the filter of
    /// its screen. Returns whether a line was open.
    pub(super) fn leave_line(&mut self) -> bool {
        self.entry_line.take().is_some()
    }

    /// While the user types a filter, the rows follow it.
    fn apply_filter(&mut self) {
        let text = self.entry_line.as_ref().filter(|entry| entry.kind == Kind::Filter);
        if let Some((screen, text)) = text.map(|entry| (entry.screen, entry.input.value().to_owned())) {
            *self.filter_mut(screen) = text;
        }
    }

    fn enter_typed(&mut self, now: Moment) -> Effect {
        let Some(entry) = self.entry_line.take() else { return Effect::Nothing };
        let text = entry.input.value();
        self.typed_before.remember(entry.kind, text);
        self.is_line_new |= !text.trim().is_empty();
        match entry.kind {
            Kind::Command => self.run(text.trim(), now),
            Kind::Filter => {
                self.told = self.slip_of_filter(entry.screen, text).map(|slip| match Filter::parse(text) {
                    Err(_) if entry.screen != Screen::Timeline => {
                        format!("no condition, so looked for as it is: {slip}")
                    }
                    _ => slip,
                });
                Effect::Draw
            }
        }
    }

    /// Shows an earlier or a later line of the history in place of the typed one.
    fn leaf(&mut self, earlier: bool) {
        let Some(entry) = &mut self.entry_line else { return };
        let lines = self.typed_before.of(entry.kind);
        let (at, draft) = entry.back.clone().unwrap_or_else(|| (0, entry.input.value().to_owned()));
        let to = if earlier { (at + 1).min(lines.len()) } else { at.saturating_sub(1) };
        let text = if to == 0 { draft.clone() } else { lines[lines.len() - to].clone() };
        entry.back = (to > 0).then_some((to, draft));
        entry.input = text.into();
    }

    /// Replaces the word before the cursor by the next completion.
    fn complete(&mut self, forward: bool) {
        let Some(entry) = &self.entry_line else { return };
        let (completion, at) = match &entry.tried {
            Some((completion, at)) => {
                let count = completion.words.len();
                let to = if forward { at + 1 } else { at + count - 1 };
                (completion.clone(), to % count)
            }
            None => {
                let completion = self.completion();
                let last = completion.words.len().saturating_sub(1);
                (completion, if forward { 0 } else { last })
            }
        };
        self.put(completion, at);
    }

    /// Takes one of the completions that are shown.
    pub(super) fn take_completion(&mut self, at: usize) {
        self.put(self.completion(), at);
        self.apply_filter();
    }

    /// Moves the cursor of the typed line to a place, in characters.
    pub(super) fn move_cursor(&mut self, at: usize) {
        if let Some(entry) = &mut self.entry_line {
            entry.input = entry.input.clone().with_cursor(at);
        }
    }

    /// Puts one of the completions in place of the word before the cursor.
    fn put(&mut self, completion: Completion, at: usize) {
        let Some(word) = completion.words.get(at).cloned() else { return };
        let text = format!("{}{word}{}", completion.before, completion.after);
        let cursor = completion.before.chars().count() + word.chars().count();
        if let Some(entry) = &mut self.entry_line {
            entry.input = Input::new(text).with_cursor(cursor);
            entry.tried = Some((completion, at));
        }
    }

    /// The completions at the cursor, best first.
    #[must_use]
    pub fn completion(&self) -> Completion {
        let Some(entry) = &self.entry_line else { return Completion::default() };
        let (before, word, after) = word_at(entry.input.value(), entry.input.cursor());
        // No name completes the number behind an operator: Tab would replace the number.
        let is_number = word.starts_with(|first: char| first.is_ascii_digit());
        let is_behind_operator = before.trim_end().ends_with(['<', '>', '=']);
        if entry.kind == Kind::Filter && is_number && is_behind_operator {
            return Completion::default();
        }
        let candidates = match entry.kind {
            Kind::Command => self.words_of_command(before),
            Kind::Filter => self.words_of_filter(entry.screen),
        };
        Completion::new(before, word, after, candidates)
    }

    /// What is wrong with the line so far; `None` if nothing is wrong.
    #[must_use]
    pub fn slip(&self) -> Option<String> {
        let entry = self.entry_line.as_ref()?;
        match entry.kind {
            Kind::Filter => self.slip_of_filter(entry.screen, entry.input.value()),
            Kind::Command => self.slip_of_command(entry.input.value()),
        }
    }
}
