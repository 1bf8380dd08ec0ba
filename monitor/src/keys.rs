//! The key bindings, in one table. Input handling and help use the same entries, so they cannot differ.

use crate::screen::Screen;
use crossterm::event::KeyCode;

/// The action of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Action {
    /// Shows a screen.
    Show(Screen),
    /// Selects the row above.
    Up,
    /// Selects the row below.
    Down,
    /// Moves one page up.
    PageUp,
    /// Moves one page down.
    PageDown,
    /// Selects the first row.
    First,
    /// Selects the last row, and follows later ones.
    Last,
    /// Hides the rows within the selected one, or selects its parent; on the screen of a port, shows the previous port.
    Left,
    /// Shows the rows within the selected one; on the screen of a port, shows the next port.
    Right,
    /// Selects the next title of a column or figure, and explains it.
    NextTitle,
    /// Selects the previous title of a column or figure, and explains it.
    PreviousTitle,
    /// Opens the selected row.
    Enter,
    /// Returns to the previous screen, or clears the filter.
    Back,
    /// Opens the filter input.
    Filter,
    /// Sorts the rows by the next of the sort orders.
    Sort,
    /// Inverts the sort order.
    Invert,
    /// Pauses or resumes the screen.
    Pause,
    /// Shows routine events, too, or hides them.
    Everything,
    /// Hides discards from the events, or shows them.
    Discards,
    /// Selects the next critical event.
    NextError,
    /// Selects the previous critical event.
    PreviousError,
    /// Shows the beginning of a recording or, while paused, of the history; on other screens selects the first row.
    Oldest,
    /// Shows the end of a recording; on other screens selects the last row.
    Newest,
    /// Moves back to the previous stop: an instant of the recording at which something changed.
    StepBack,
    /// Moves on to the next stop of the recording.
    StepOn,
    /// Moves back to the previous stop of the recording that has an anomaly.
    PreviousAnomaly,
    /// Moves on to the next stop of the recording that has an anomaly.
    NextAnomaly,
    /// Shows the next lines of the panel about a step of a recording.
    MoreOfStep,
    /// Starts or ends a recording.
    Record,
    /// Writes the screen as text to a file.
    Write,
    /// Copies the name of the selected row.
    Copy,
    /// Opens the command input.
    Command,
    /// Sets a mark, with which counters can be compared.
    Mark,
    /// Shows counters since the user's mark, or since the start.
    Difference,
    /// Shows only wait-for cycles, or all waits.
    Cycles,
    /// Zooms in: less time per row.
    Closer,
    /// Zooms out: more time per row.
    Wider,
    /// Selects the next row that matches the filter, or has a finding.
    NextMatch,
    /// Selects the previous row that matches the filter, or has a finding.
    PreviousMatch,
    /// Shows the next cell.
    Cell,
    /// Shows the page about a finding's code.
    Explain,
    /// Selects the place that blocks the cell most.
    Culprit,
    /// Shows the settings, or closes them.
    Settings,
    /// Draws the screen in the next theme.
    Theme,
    /// Suspends the monitor until the shell's `fg`.
    Suspend,
    /// Ends the monitor.
    Quit,
}

/// A key, with or without Ctrl.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    /// The key itself, without Ctrl.
    pub code: KeyCode,
    /// Whether Ctrl is held down.
    pub ctrl: bool,
}

const fn key(c: char) -> Key {
    Key { code: KeyCode::Char(c), ctrl: false }
}

const fn ctrl(c: char) -> Key {
    Key { code: KeyCode::Char(c), ctrl: true }
}

const fn code(code: KeyCode) -> Key {
    Key { code, ctrl: false }
}

/// A key binding: keys and their action.
#[derive(Clone, Copy, Debug)]
pub struct Binding {
    /// The keys. Each of them triggers the action.
    pub keys: &'static [Key],
    /// The action of these keys.
    pub action: Action,
    /// The text about the action on the help screen.
    pub help: &'static str,
    /// The screens on which the binding applies; if empty, all.
    pub on: &'static [Screen],
}

const fn everywhere(keys: &'static [Key], action: Action, help: &'static str) -> Binding {
    Binding { keys, action, help, on: &[] }
}

const fn on(on: &'static [Screen], keys: &'static [Key], action: Action, help: &'static str) -> Binding {
    Binding { keys, action, help, on }
}

/// The screens that have a filter.
pub const FILTERED: &[Screen] = &[Screen::Overview, Screen::Events, Screen::Timeline];

/// All key bindings. The first binding that matches applies.
pub const BINDINGS: &[Binding] = &[
    everywhere(&[key('1')], Action::Show(Screen::Overview), "overview: nodes, tasks, ports"),
    everywhere(&[key('2')], Action::Show(Screen::Port), "one port's queue in the order of service"),
    everywhere(&[key('3')], Action::Show(Screen::Rendezvous), "who waits for whom"),
    everywhere(&[key('4')], Action::Show(Screen::Timeline), "what happened in each task, side by side"),
    everywhere(&[key('5')], Action::Show(Screen::Timers), "what runs out when"),
    everywhere(&[key('6')], Action::Show(Screen::Events), "what happened"),
    everywhere(&[key('7')], Action::Show(Screen::Model), "do the nodes do what the model does"),
    everywhere(
        &[key('8')],
        Action::Show(Screen::Problems),
        "what needs attention, and the nearest deadlines",
    ),
    everywhere(&[key('?')], Action::Show(Screen::Help), "this help; it begins with the selected title"),
    everywhere(&[code(KeyCode::Tab)], Action::NextTitle, "select the next title or figure: what it shows"),
    everywhere(&[code(KeyCode::BackTab)], Action::PreviousTitle, "the title or figure before it"),
    everywhere(
        &[key('k'), code(KeyCode::Up)],
        Action::Up,
        "up; above the first row, to the banner: Enter goes there",
    ),
    everywhere(&[key('j'), code(KeyCode::Down)], Action::Down, "down"),
    everywhere(&[code(KeyCode::PageUp), ctrl('b')], Action::PageUp, "a page up"),
    everywhere(&[code(KeyCode::PageDown), ctrl('f')], Action::PageDown, "a page down"),
    everywhere(&[key('g')], Action::First, "first row"),
    everywhere(&[key('G')], Action::Last, "last row; events: follow"),
    everywhere(
        &[code(KeyCode::Home)],
        Action::Oldest,
        "first row; in a recording, or while paused, the beginning",
    ),
    everywhere(&[code(KeyCode::End)], Action::Newest, "last row; in a recording, or while paused, the end"),
    on(&[Screen::Overview], &[key('h'), code(KeyCode::Left)], Action::Left, "hide the rows within"),
    on(&[Screen::Overview], &[key('l'), code(KeyCode::Right)], Action::Right, "show the rows within"),
    on(&[Screen::Port], &[key('h'), code(KeyCode::Left)], Action::Left, "previous port"),
    on(&[Screen::Port], &[key('l'), code(KeyCode::Right)], Action::Right, "next port"),
    on(&[Screen::Timeline], &[key('h'), code(KeyCode::Left)], Action::Left, "the lane to the left"),
    on(&[Screen::Timeline], &[key('l'), code(KeyCode::Right)], Action::Right, "the lane to the right"),
    on(&[Screen::Timeline], &[key('+'), key('=')], Action::Closer, "less time a row, down to an event a row"),
    on(&[Screen::Timeline], &[key('-')], Action::Wider, "more time a row"),
    on(
        &[Screen::Timeline],
        &[key('a')],
        Action::Everything,
        "every event, or only rendezvous and what went wrong",
    ),
    on(&[Screen::Rendezvous], &[key('c')], Action::Cycles, "only what waits in a cycle, or all"),
    on(&[Screen::Port], &[code(KeyCode::Enter)], Action::Enter, "the history of this message"),
    on(
        &[Screen::Events, Screen::Timeline],
        &[code(KeyCode::Enter)],
        Action::Enter,
        "the history of its message; otherwise to its node or task",
    ),
    on(
        &[Screen::Rendezvous, Screen::Timers, Screen::Model, Screen::Message],
        &[code(KeyCode::Enter)],
        Action::Enter,
        "to the node or task of this row",
    ),
    everywhere(
        &[key('b')],
        Action::Culprit,
        "to the task or node that blocks the cell (or click the banner)",
    ),
    on(&[Screen::Problems], &[code(KeyCode::Enter)], Action::Enter, "to the place or the message"),
    on(
        &[Screen::Problems, Screen::Overview],
        &[key('x')],
        Action::Explain,
        "what the finding of this row means, and what to do",
    ),
    on(&[Screen::Overview], &[code(KeyCode::Enter)], Action::Enter, "open: node, task, port, rendezvous"),
    everywhere(&[code(KeyCode::Esc)], Action::Back, "back; clear the filter"),
    on(FILTERED, &[key('/')], Action::Filter, "show only rows with a text"),
    on(
        &[Screen::Overview],
        &[key('a')],
        Action::Everything,
        "earlier incarnations of the nodes too, or only the latest",
    ),
    on(&[Screen::Overview], &[key('s')], Action::Sort, "sort by name, slack, queue, health"),
    on(&[Screen::Overview], &[key('i')], Action::Invert, "invert the order"),
    on(
        &[Screen::Events],
        &[key('a')],
        Action::Everything,
        "every event (repeated copies too), or those that matter",
    ),
    on(&[Screen::Events], &[key('x')], Action::Discards, "leave discards out, or show them"),
    on(&[Screen::Events], &[key('e')], Action::NextError, "next bad event"),
    on(&[Screen::Events], &[key('E')], Action::PreviousError, "previous bad event"),
    everywhere(&[key(' ')], Action::Pause, "pause this screen (never the nodes); play a recording"),
    everywhere(&[key('[')], Action::StepBack, "in a recording, or while paused: one step back"),
    everywhere(&[key(']')], Action::StepOn, "in a recording, or while paused: one step on"),
    everywhere(&[key('{')], Action::PreviousAnomaly, "in a recording, or while paused: back to trouble"),
    everywhere(&[key('}')], Action::NextAnomaly, "in a recording, or while paused: on to trouble"),
    everywhere(&[key('p')], Action::MoreOfStep, "in a recording of the checker: more of what a step did"),
    on(
        &[Screen::Overview, Screen::Events],
        &[key('n')],
        Action::NextMatch,
        "next row that the filter finds, or that is in trouble",
    ),
    on(&[Screen::Overview, Screen::Events], &[key('N')], Action::PreviousMatch, "the one before"),
    everywhere(&[key('m')], Action::Mark, "mark the present, to compare with"),
    on(&[Screen::Overview], &[key('d')], Action::Difference, "counters since the mark, or since the start"),
    everywhere(&[key('w')], Action::Write, "write this screen as text into a file"),
    on(
        &[Screen::Overview, Screen::Port, Screen::Message, Screen::Events, Screen::Timeline],
        &[key('y')],
        Action::Copy,
        "copy what the row is called (terminals with OSC 52)",
    ),
    everywhere(&[key(':')], Action::Command, "a command: connect, port, node, theme, quit"),
    everywhere(&[key('r')], Action::Record, "start a recording, or end it"),
    everywhere(&[key('C')], Action::Cell, "next cell"),
    on(&[Screen::Settings], &[code(KeyCode::Enter)], Action::Enter, "change this setting"),
    on(&[Screen::Explain], &[code(KeyCode::Enter)], Action::Enter, "to the worst of these findings"),
    on(
        &[Screen::Help],
        &[code(KeyCode::Enter)],
        Action::Enter,
        "use the key, command or column of this line",
    ),
    everywhere(&[key('o')], Action::Settings, "settings of the running monitor"),
    everywhere(&[key('t')], Action::Theme, "next theme"),
    everywhere(&[ctrl('z')], Action::Suspend, "to the shell; `fg` returns"),
    everywhere(&[key('q'), ctrl('c')], Action::Quit, "quit"),
];

/// The actions that a screen's bottom line names, most useful first.
pub(crate) const fn hinted(screen: Screen) -> &'static [(Action, &'static str)] {
    match screen {
        Screen::Overview => &[
            (Action::Enter, "open"),
            (Action::Filter, "filter"),
            (Action::Explain, "explain"),
            (Action::Sort, "sort"),
            (Action::Pause, "pause"),
        ],
        Screen::Port => {
            &[(Action::Enter, "history"), (Action::Left, "previous"), (Action::Right, "next port")]
        }
        Screen::Settings => &[(Action::Enter, "change"), (Action::Back, "close"), (Action::Down, "down")],
        Screen::Help => &[(Action::Back, "back"), (Action::Enter, "use"), (Action::Down, "down")],
        Screen::Message | Screen::Explain => {
            &[(Action::Back, "back"), (Action::Enter, "go there"), (Action::Down, "down")]
        }
        Screen::Rendezvous => {
            &[(Action::Enter, "go there"), (Action::Culprit, "culprit"), (Action::Cycles, "cycles")]
        }
        Screen::Timeline => &[
            (Action::Right, "next lane"),
            (Action::Closer, "closer"),
            (Action::Wider, "wider"),
            (Action::Enter, "open"),
            (Action::Filter, "filter"),
        ],
        Screen::Timers | Screen::Model => &[(Action::Enter, "go there"), (Action::Culprit, "culprit")],
        Screen::Events => &[
            (Action::NextError, "next error"),
            (Action::Everything, "all"),
            (Action::Enter, "open"),
            (Action::Filter, "filter"),
            (Action::Last, "follow"),
        ],
        Screen::Problems => &[(Action::Enter, "go there"), (Action::Explain, "explain")],
    }
}

impl Binding {
    /// Whether the binding applies on `screen`.
    #[must_use]
    pub fn is_on(&self, screen: Screen) -> bool {
        self.on.is_empty() || self.on.contains(&screen)
    }
}

impl Key {
    /// The name of the key, as the help shows it.
    #[must_use]
    pub fn label(self) -> String {
        let name = match self.code {
            KeyCode::Char(' ') => "space".to_owned(),
            KeyCode::Char(c) => c.to_string(),
            KeyCode::PageUp => "PgUp".to_owned(),
            KeyCode::PageDown => "PgDn".to_owned(),
            KeyCode::BackTab => "Shift-Tab".to_owned(),
            other => format!("{other}"),
        };
        if self.ctrl { format!("^{}", name.to_uppercase()) } else { name }
    }
}
