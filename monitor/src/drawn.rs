//! The layout of a drawn frame: what a click selects, and how much of a list had room.

use crate::keys::Action;
use crate::problems::ProblemKey;
use crate::rows::Sort;
use crate::screen::Screen;
use crate::store::health::Place;
use imrs_protocol::{MessageId, TaskId};
use ratatui::layout::{Position, Rect};

/// The target of a mouse click.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hit {
    /// The tab of a screen.
    Tab(Screen),
    /// A row of the overview.
    Row(Place),
    /// The banner: the place that blocks the cell most.
    Place(Place),
    /// The title of a sortable column.
    Title(Sort, &'static str),
    /// A position of the scrub bar, in microseconds or steps.
    Scrub(u64),
    /// A row of the problems screen.
    Problem(ProblemKey),
    /// A line of the screen's list.
    Line(usize),
    /// A line of the screen's list, chosen by a click on the scrollbar.
    Scroll(usize),
    /// A lane of the timeline.
    Lane(TaskId),
    /// The title of a column or a figure, to be explained.
    Column(&'static str),
    /// A key that the screen names, or a fact that a key changes.
    Key(Action),
    /// A command that the help names: its word is typed.
    Command(&'static str),
    /// A proposed completion of the typed line, by its index.
    Completion(usize),
    /// A place in the typed line, in characters from its beginning.
    Cursor(usize),
    /// The trouble with a node on the bottom line: its whole text.
    Trouble,
    /// A fact that needs an explanation: the sentence about it.
    Fact(&'static str),
    /// An answer on the bottom line, which any click removes.
    Answer,
    /// A message of a queue: its source and its id.
    Entry(TaskId, MessageId),
}

impl Hit {
    /// The title that this target explains.
    const fn title(&self) -> Option<&'static str> {
        match self {
            Self::Title(_, title) | Self::Column(title) => Some(title),
            _ => None,
        }
    }
}

/// The layout of a drawn frame. Keys and clicks act on what the user saw, so they use this instead of a second layout.
#[derive(Clone, Debug, Default)]
pub struct Drawn {
    /// The screen that was drawn.
    pub screen: Screen,
    /// How many rows of the screen's list had room.
    pub page: usize,
    /// How many lines the screen's list has.
    pub lines: usize,
    /// How many lanes of the timeline had room.
    pub lanes: usize,
    /// The place to which the banner leads.
    pub(crate) banner: Option<Place>,
    /// Whether the cursor is on the banner. Then no row of a list shows it.
    pub(crate) is_on_banner: bool,
    /// What Enter does on each line of the list, as a click on a target.
    pub(crate) opens: Vec<Option<Hit>>,
    pub(crate) hits: Vec<(Rect, Hit)>,
}

impl Drawn {
    /// The target at a column and row of the terminal.
    #[must_use]
    pub fn hit(&self, column: u16, row: u16) -> Option<Hit> {
        let at = Position::new(column, row);
        self.hits.iter().find(|(area, _)| area.contains(at)).map(|(_, hit)| *hit)
    }

    /// The titles of columns and figures, in reading order.
    #[must_use]
    pub fn titles(&self) -> Vec<&'static str> {
        let mut found: Vec<_> =
            self.hits.iter().filter_map(|(area, hit)| Some((*area, hit.title()?))).collect();
        found.sort_by_key(|(area, _)| (area.y, area.x));
        let mut titles = Vec::with_capacity(found.len());
        for (_, title) in found {
            if !titles.contains(&title) {
                titles.push(title);
            }
        }
        titles
    }

    /// Where a title is.
    pub(crate) fn title(&self, title: &str) -> Option<Rect> {
        self.hits.iter().find(|(_, hit)| hit.title() == Some(title)).map(|(area, _)| *area)
    }

    pub(crate) fn has_title(&self, title: &str) -> bool {
        self.title(title).is_some()
    }

    /// Drops the targets within an area, because a window is drawn over it.
    pub(crate) fn forget(&mut self, area: Rect) {
        self.hits.retain(|(target, _)| !target.intersects(area));
    }

    /// Makes an area of the terminal a target of clicks.
    pub(crate) fn target(&mut self, area: Rect, hit: Hit) {
        self.hits.push((area, hit));
    }

    /// Makes an area a target that is above the other targets.
    pub(crate) fn target_above(&mut self, area: Rect, hit: Hit) {
        self.hits.insert(0, (area, hit));
    }
}
