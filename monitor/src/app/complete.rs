//! Completions of the text that the user types, and names that are similar to it.

use super::{App, Screen};
use crate::query::{FIELDS, Filter, Scope};
use nucleo_matcher::pattern::{AtomKind, CaseMatching, Normalization, Pattern};
use nucleo_matcher::{Config, Matcher};

/// The words that can complete a text at one place.
#[derive(Clone, Debug, Default)]
pub struct Completion {
    /// The text before the word.
    pub before: String,
    /// The words, best first.
    pub words: Vec<String>,
    /// The text after the word.
    pub after: String,
}

impl Completion {
    /// The words among `candidates` that contain the letters of `word`.
    pub(super) fn new(before: &str, word: &str, after: &str, candidates: Vec<String>) -> Self {
        let words = fuzzy(word, candidates);
        Self { before: before.to_owned(), words, after: after.to_owned() }
    }
}

/// The candidates that contain the letters of `word` in this order, in any case; the best matches come first. For an
/// empty word, returns all candidates in their order.
#[must_use]
pub fn fuzzy(word: &str, candidates: Vec<String>) -> Vec<String> {
    if word.is_empty() {
        return candidates;
    }
    let pattern = Pattern::new(word, CaseMatching::Ignore, Normalization::Smart, AtomKind::Fuzzy);
    let mut matcher = Matcher::new(Config::DEFAULT);
    let found = pattern.match_list(candidates, &mut matcher);
    found.into_iter().map(|(name, _)| name).collect()
}

/// Splits a text into three: the text before the word at the cursor, that word up to the cursor, and the rest. The
/// cursor is a number of characters.
pub(super) fn word_at(text: &str, cursor: usize) -> (&str, &str, &str) {
    let end = text.char_indices().nth(cursor).map_or(text.len(), |(at, _)| at);
    let is_of_word = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-' | '.');
    let start = text[..end]
        .rfind(|c| !is_of_word(c))
        .map_or(0, |at| at + text[at..].chars().next().map_or(1, char::len_utf8));
    (&text[..start], &text[start..end], &text[end..])
}

impl App {
    /// The names of the nodes and tasks of the shown cell.
    pub(super) fn names_of_places(&self) -> Vec<String> {
        let names = self.cell().and_then(|cell| self.store().names(&cell).cloned());
        let Some(names) = names else { return Vec::new() };
        let nodes = names.nodes.iter().map(|node| node.shown().to_owned());
        nodes.chain(names.tasks.iter().map(|task| task.name.shown().to_owned())).collect()
    }

    /// The names of the shown cell's ports: alone, and together with their tasks.
    pub(super) fn names_of_ports(&self) -> Vec<String> {
        let names = self.cell().and_then(|cell| self.store().names(&cell).cloned());
        let Some(names) = names else { return Vec::new() };
        let mut all: Vec<String> = names.ports.iter().map(|port| port.name.shown().to_owned()).collect();
        for port in &names.ports {
            let ends = port.parties.iter().map(|party| format!("{}.{}", names.task(party.task), port.name));
            all.extend(ends);
        }
        let mut seen = std::collections::HashSet::new();
        all.retain(|name| seen.insert(name.clone()));
        all
    }

    /// The words that a filter of a screen may contain: names and, where it may be a condition, fields.
    pub(super) fn words_of_filter(&self, screen: Screen) -> Vec<String> {
        let mut all: Vec<String> = Vec::new();
        if let Some(scope) = scope(screen) {
            let known = FIELDS.iter().filter(|info| [Scope::Both, scope].contains(&info.scope));
            all.extend(known.map(|info| info.name.to_owned()));
            all.extend(["and", "or", "not"].map(str::to_owned));
        }
        all.extend(self.names_of_places());
        let ports = self.names_of_ports();
        all.extend(ports.into_iter().filter(|name| !name.contains('.')));
        all
    }

    /// What is wrong with a filter of a screen. Text that is no condition is searched for as it is.
    pub(super) fn slip_of_filter(&self, screen: Screen, text: &str) -> Option<String> {
        let parsed = Filter::parse(text);
        let Some(scope) = scope(screen) else {
            let is_condition = !parsed.is_ok_and(|filter| filter.is_none_or(|filter| filter.is_words()));
            let found = self.finds_on_timeline(text);
            let why = if is_condition { "no condition works here" } else { "nothing has this name" };
            return (!found).then(|| format!("{why}, so all is shown; write a part of a task, node or port"));
        };
        let what = if scope == Scope::Events { "an event" } else { "a row" };
        match parsed {
            Ok(filter) => {
                let field = filter?.foreign(scope)?;
                Some(format!("{what} has no `{field}`"))
            }
            Err(error) => Some(error.to_string()),
        }
    }
}

/// Which rows the conditions of a screen's filter are about; `None` if its filter is only text.
const fn scope(screen: Screen) -> Option<Scope> {
    match screen {
        Screen::Timeline => None,
        Screen::Events => Some(Scope::Events),
        _ => Some(Scope::Rows),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_word_before_the_cursor_is_completed() {
        assert_eq!(word_at("port be", 7), ("port ", "be", ""));
        assert_eq!(word_at("slack<3ms and le", 2), ("", "sl", "ack<3ms and le"));
        assert_eq!(word_at("port armL.b", 11), ("port ", "armL.b", ""));
        assert_eq!(word_at("not (task=\u{e9}\u{e9}", 12), ("not (task=", "\u{e9}\u{e9}", ""));
        assert_eq!(word_at("", 0), ("", "", ""));
        assert_eq!(word_at("port ", 5), ("port ", "", ""));
    }

    #[test]
    fn letters_in_order_find_a_name_and_the_best_comes_first() {
        let names = || ["grip_cmd", "beat", "better", "lift"].map(str::to_owned).to_vec();
        assert_eq!(fuzzy("grcm", names()), ["grip_cmd"]);
        assert_eq!(fuzzy("BEAT", names())[0], "beat");
        assert_eq!(fuzzy("", names()), names());
        assert!(fuzzy("xyz", names()).is_empty());
    }
}
