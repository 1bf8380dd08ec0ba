//! The user's settings for the timeline: lanes, zoom and position. A lane is the column of a task; a mark is an event
//! that the timeline draws.

pub use super::slices::Slice;
use super::slices::{folded, slices};
use super::{App, Screen};
use crate::name::Name;
use crate::store::timeline::{Mark, Timeline, timeline};
use crate::store::{IncarnationId, Names, NodeIncarnation};
use imrs_protocol::{Event, NodeId, PortId, TaskId};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::time::Duration;

/// The greatest number of marks that a frame puts in order.
const MOST: usize = 4096;
/// The time that one row covers; `None` gives every mark its own row.
pub const ZOOMS: [Option<Duration>; 8] = [
    None,
    Some(Duration::from_millis(1)),
    Some(Duration::from_millis(5)),
    Some(Duration::from_millis(20)),
    Some(Duration::from_millis(100)),
    Some(Duration::from_millis(500)),
    Some(Duration::from_secs(2)),
    Some(Duration::from_secs(10)),
];

/// Identifies a mark even when its position changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Anchor {
    incarnation: IncarnationId,
    task: TaskId,
    mono_us: u64,
    number: u32,
}

impl Anchor {
    fn of(mark: &Mark) -> Self {
        Self {
            incarnation: mark.incarnation,
            task: mark.task,
            mono_us: mark.seen.mono_us,
            number: mark.seen.what.number,
        }
    }
}

/// The user's settings for the timeline.
#[derive(Clone, Debug, Default)]
pub struct Lanes {
    /// The lane whose clock labels the rows.
    lane: Option<TaskId>,
    /// The tasks when the timeline was opened, busiest first. If there is no room for all lanes, the busiest are shown first.
    busiest: Vec<TaskId>,
    /// The zoom of the timeline, as an index into [`ZOOMS`].
    zoom: usize,
    /// The mark in the bottom row; `None` if the timeline follows the latest mark.
    held: Option<Anchor>,
    /// Whether the timeline hides routine messages.
    sparse: bool,
}

/// The timeline in rows.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    /// The marks of all lanes. A mark is an event that the timeline draws.
    pub timeline: Timeline,
    /// The lanes, in the order of the cell. If there is no room for all lanes, the busiest lanes come first.
    pub lanes: Vec<TaskId>,
    /// For each task, by its index: the index of its lane.
    lane_of: Vec<Option<usize>>,
    /// The lanes that have room.
    pub shown: Range<usize>,
    /// The index of the selected lane.
    pub lane: usize,
    /// The rows, oldest first.
    pub rows: Vec<Slice>,
    /// The index of the last row that is shown.
    pub bottom: usize,
    /// Whether the bottom row stays fixed while new events arrive.
    pub held: bool,
    /// The time that one row covers.
    pub zoom: Option<Duration>,
    /// Whether the timeline hides routine messages.
    pub sparse: bool,
}

impl Chart {
    /// The index of a task's lane.
    #[must_use]
    pub fn lane_of(&self, task: TaskId) -> Option<usize> {
        self.lane_of.get(task.index()).copied().flatten()
    }

    /// The last mark of a row, if it has any.
    #[must_use]
    pub fn mark(&self, row: usize) -> Option<&Mark> {
        self.rows.get(row)?.marks().last().and_then(|&at| self.timeline.marks.get(at))
    }
}

impl App {
    /// The timeline of the shown cell, with as many lanes as had room in the last frame.
    #[must_use]
    pub fn chart(&self) -> Chart {
        self.chart_of(if self.drawn.screen == Screen::Timeline { self.drawn.lanes } else { usize::MAX })
    }

    /// The timeline of the shown cell, with room for this many lanes.
    #[must_use]
    pub fn chart_of(&self, room: usize) -> Chart {
        let Some(cell) = self.cell() else { return Chart::default() };
        let timeline = timeline(self.store(), &cell, MOST);
        let lanes = self.ordered(self.wanted_lanes(&cell), &timeline, room);
        let ports = self.wanted_ports(&cell);
        let mut lane_of = vec![None; lanes.iter().map(|task| task.index() + 1).max().unwrap_or(0)];
        for (lane, task) in lanes.iter().enumerate() {
            lane_of[task.index()] = Some(lane);
        }
        let place = |task: TaskId| lane_of.get(task.index()).copied().flatten();
        let wanted = |mark: &Mark| {
            let what = mark.seen.what;
            place(mark.task).is_some()
                && ports.as_ref().is_none_or(|ports| ports.contains(&what.port))
                && !(self.lanes.sparse && is_traffic(what.event))
        };
        let lane = self.lanes.lane.and_then(|wanted| lanes.iter().position(|t| *t == wanted)).unwrap_or(0);
        let zoom = ZOOMS.get(self.lanes.zoom).copied().flatten();
        let count = room.clamp(1, lanes.len().max(1));
        let first = (lane + 1).saturating_sub(count);
        let visible = first..first + count;
        let is_visible =
            |at: usize| place(timeline.marks[at].task).is_some_and(|lane| visible.contains(&lane));
        let rows = folded(slices(&timeline, wanted, is_visible, zoom), is_visible);
        let last = rows.len().saturating_sub(1);
        let is_held = |row: &Slice| {
            row.marks().iter().any(|&at| Some(Anchor::of(&timeline.marks[at])) == self.lanes.held)
        };
        let held = self.lanes.held.map(|_| rows.iter().rposition(is_held).unwrap_or(0));
        let bottom = held.unwrap_or(last).min(last);
        Chart {
            timeline,
            lanes,
            lane_of,
            shown: visible,
            lane,
            rows,
            bottom,
            held: held.is_some(),
            zoom,
            sparse: self.lanes.sparse,
        }
    }

    /// The lanes, the busiest first if there is no room for all of them; otherwise in the order of the cell.
    fn ordered(&self, lanes: Vec<TaskId>, timeline: &Timeline, room: usize) -> Vec<TaskId> {
        if lanes.len() <= room || !self.lane_filter.is_empty() {
            return lanes;
        }
        let now = if self.lanes.busiest.is_empty() { busiest(timeline) } else { Vec::new() };
        let known = if now.is_empty() { &self.lanes.busiest } else { &now };
        let chosen: BTreeSet<TaskId> =
            known.iter().copied().filter(|task| lanes.contains(task)).take(room).collect();
        let (mut first, rest): (Vec<_>, Vec<_>) = lanes.into_iter().partition(|task| chosen.contains(task));
        first.extend(rest);
        first
    }

    /// Determines the busiest lanes anew, when the timeline is opened.
    pub(super) fn choose_lanes(&mut self) {
        let timeline = self.cell().map(|cell| timeline(self.store(), &cell, MOST));
        self.lanes.busiest = timeline.as_ref().map(busiest).unwrap_or_default();
    }

    /// Selects the lane of a task.
    pub(super) fn choose_lane(&mut self, task: TaskId) {
        self.lanes.lane = Some(task);
    }

    /// The tasks whose name or node contains the filter's text; all tasks if none does.
    fn wanted_lanes(&self, cell: &Name) -> Vec<TaskId> {
        let Some(names) = self.store().names(cell) else { return Vec::new() };
        let found = tasks_with(names, &self.lane_filter);
        if found.is_empty() { (0..names.tasks.len()).map(TaskId::from_index).collect() } else { found }
    }

    /// The ports whose name contains the filter's text, if it matches no task and no node.
    fn wanted_ports(&self, cell: &Name) -> Option<BTreeSet<PortId>> {
        let names = self.store().names(cell)?;
        if !tasks_with(names, &self.lane_filter).is_empty() {
            return None;
        }
        let found = ports_with(names, &self.lane_filter);
        (!found.is_empty()).then_some(found)
    }

    /// Whether a text is a filter of the timeline: a task, a node or a port contains it.
    pub(super) fn finds_on_timeline(&self, text: &str) -> bool {
        let names = self.cell().and_then(|cell| self.store().names(&cell));
        names.is_none_or(|names| !tasks_with(names, text).is_empty() || !ports_with(names, text).is_empty())
    }

    /// The latest incarnation of the node on which a task of the shown cell runs.
    #[must_use]
    pub fn incarnation_of_task(&self, task: TaskId) -> Option<&NodeIncarnation> {
        let cell = self.cell()?;
        let home: NodeId = self.store().names(&cell)?.home(task)?;
        self.store().latest(&cell, home)
    }

    pub(super) fn next_lane(&mut self, forward: bool) {
        let chart = self.chart();
        let count = chart.lanes.len().max(1);
        let to = if forward { chart.lane + 1 } else { chart.lane + count - 1 } % count;
        self.lanes.lane = chart.lanes.get(to).copied();
    }

    pub(super) fn zoom(&mut self, closer: bool) {
        let to = if closer { self.lanes.zoom.saturating_sub(1) } else { self.lanes.zoom + 1 };
        self.lanes.zoom = to.min(ZOOMS.len() - 1);
    }

    /// Whether a row of the timeline covers the most time.
    #[must_use]
    pub const fn is_widest(&self) -> bool {
        self.lanes.zoom + 1 >= ZOOMS.len()
    }

    pub(super) fn step_chart(&mut self, by: isize) {
        let chart = self.chart();
        self.hold(&chart, chart.bottom.saturating_add_signed(by), by < 0);
    }

    /// Selects a row of the timeline.
    pub(super) fn go_to_chart_row(&mut self, row: usize) {
        let chart = self.chart();
        self.hold(&chart, row, true);
        // A click selects exactly this row, even if it is the last one.
        self.lanes.held = self.lanes.held.or_else(|| chart.mark(row).map(Anchor::of));
    }

    /// Makes the row `to` the fixed bottom row. Only rows with marks can be fixed, so other rows are skipped in the
    /// direction of the step.
    fn hold(&mut self, chart: &Chart, to: usize, back: bool) {
        let last = chart.rows.len().saturating_sub(1);
        let mut to = to.min(last);
        while chart.mark(to).is_none() && to > 0 && to < last {
            to = if back { to - 1 } else { to + 1 };
        }
        // Above the first row with marks no row can be fixed, and the timeline would follow the last row. So the
        // first row with marks is fixed.
        if back && chart.mark(to).is_none() {
            to = (to..=last).find(|&row| chart.mark(row).is_some()).unwrap_or(last);
        }
        self.lanes.held = chart.mark(to).map(Anchor::of).filter(|_| to < last);
    }

    pub(super) fn thin_chart(&mut self) {
        self.lanes.sparse = !self.lanes.sparse;
        self.lanes.held = None;
    }

    pub(super) const fn is_chart_thin(&self) -> bool {
        self.lanes.sparse
    }

    pub(super) fn follow_chart(&mut self) {
        self.lanes.held = None;
    }
}

/// The tasks whose name, or whose node's name, contains a text.
fn tasks_with(names: &Names, text: &str) -> Vec<TaskId> {
    let has = |name: &Name| name.shown().to_lowercase().contains(&text.to_lowercase());
    let all = (0..names.tasks.len()).map(TaskId::from_index);
    let home = |task| names.home(task).is_some_and(|node| has(&names.node(node)));
    all.filter(|task| has(&names.task(*task)) || home(*task)).collect()
}

/// The ports whose name contains a text.
fn ports_with(names: &Names, text: &str) -> BTreeSet<PortId> {
    let has = |name: &Name| name.shown().to_lowercase().contains(&text.to_lowercase());
    (0..names.ports.len()).map(PortId::from_index).filter(|port| has(&names.port_name(*port))).collect()
}

/// Whether the event is routine traffic. If such events are hidden, rendezvous and faults are visible on a busy timeline.
const fn is_traffic(event: Event) -> bool {
    match event {
        Event::Sent
        | Event::Resent
        | Event::Enqueued
        | Event::Delivered
        | Event::Replied
        | Event::Answered
        | Event::Interrupted
        | Event::Resumed => true,
        Event::RefusedByPeer
        | Event::TimedOut
        | Event::TimedOutUnsent
        | Event::PeerRestarted
        | Event::Discarded(_)
        | Event::Reached
        | Event::Rejoined
        | Event::PartnerArrived
        | Event::PartnerAborted
        | Event::Confirmed
        | Event::ReleasedComplete
        | Event::ReleasedByConfirm
        | Event::WithinMargin
        | Event::GaveUp
        | Event::Rejected
        | Event::Granted
        | Event::TookOver
        | Event::Fenced => false,
    }
}

/// The tasks that have marks; the task with the most marks comes first.
fn busiest(timeline: &Timeline) -> Vec<TaskId> {
    let mut counts: BTreeMap<TaskId, usize> = BTreeMap::new();
    for mark in &timeline.marks {
        *counts.entry(mark.task).or_default() += 1;
    }
    let mut tasks: Vec<_> = counts.into_iter().collect();
    tasks.sort_by_key(|(task, count)| (Reverse(*count), *task));
    tasks.into_iter().map(|(task, _)| task).collect()
}
