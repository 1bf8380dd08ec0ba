//! The rows of the overview screen: nodes, tasks and ports, sorted and filtered.

use crate::clock::Moment;
use crate::name::Name;
use crate::query::{Field, Filter, NodeRow, PortRow, Row as Fields, Value};
use crate::store::health::{Finding, Place};
use crate::store::journal::Severity;
use crate::store::{Condition, IncarnationId, NodeIncarnation, Presence, Store, Unseen, unseen};
use imrs_protocol::PortView;
use imrs_wire::obs::TaskSnapshot;
use std::collections::BTreeSet;

/// A row of the overview.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// The place that the row shows.
    pub place: Place,
    /// The depth of the row: 0 for a node, 1 for a task, 2 for a port.
    pub depth: u8,
    /// Whether there are rows within this row.
    pub parent: bool,
    /// Whether the rows within this row are shown.
    pub open: bool,
}

/// The order in which rows are sorted. Rows stay within their node and task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sort {
    /// No sorting: rows keep the order in which the cell declares them.
    #[default]
    Name,
    /// The row with the least time left comes first.
    Slack,
    /// The row with the longest queue comes first.
    Queue,
    /// The row with the most severe finding comes first.
    Health,
}

impl Sort {
    /// The next of the sort orders.
    #[must_use]
    pub const fn next(self) -> Self {
        match self {
            Self::Name => Self::Slack,
            Self::Slack => Self::Queue,
            Self::Queue => Self::Health,
            Self::Health => Self::Name,
        }
    }

    /// The name of the sort order, in one word.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Name => "name",
            Self::Slack => "slack",
            Self::Queue => "queue",
            Self::Health => "health",
        }
    }
}

/// The user's settings for the rows of the overview.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    /// Rows that the user has opened although they are closed by default, or has closed although they are open by default.
    pub toggled: BTreeSet<Place>,
    /// The sort order.
    pub sort: Sort,
    /// Whether the sort order is inverted.
    pub inverted: bool,
    /// A condition ([`crate::query`]). A row that does not fulfil it is left out, unless a row within it does.
    pub filter: String,
    /// Whether ended earlier incarnations of nodes have rows, too.
    pub earlier: bool,
}

/// In a cell of up to this many nodes, each node has an open row of its own.
const FEW: usize = 6;

/// The healthy nodes that share one row. In a cell of many nodes these are the nodes that are up and without a
/// finding. The nodes in `loud` always keep rows of their own. With a filter, or sorted by slack or queue, all nodes
/// do.
#[must_use]
pub fn healthy(
    store: &Store,
    cell: &Name,
    shape: &Shape,
    (findings, loud): (&[Finding], &[Place]),
    now: Moment,
) -> Vec<IncarnationId> {
    let compares = matches!(shape.sort, Sort::Slack | Sort::Queue) || !shape.filter.is_empty();
    if compares || !is_large(store, cell) {
        return Vec::new();
    }
    let is_healthy = |incarnation: &&NodeIncarnation| {
        let place = Place { node: Ok(incarnation.id), task: None, port: None };
        let mut named = findings.iter().map(|finding| &finding.place).chain(loud);
        incarnation.presence(now) == Presence::Up && !named.any(|named| place.holds(named))
    };
    let found: Vec<_> = store.present(cell).filter(is_healthy).map(|incarnation| incarnation.id).collect();
    if found.len() > 1 { found } else { Vec::new() }
}

/// Whether the cell has more than a few nodes. Then the rows of nodes are closed by default.
fn is_large(store: &Store, cell: &Name) -> bool {
    store.names(cell).is_some_and(|names| names.nodes.len() > FEW)
}

/// The rows of a cell. One row stands for the `healthy` nodes, after all other rows.
#[must_use]
pub fn rows(
    store: &Store,
    cell: &Name,
    shape: &Shape,
    (findings, healthy): (&[Finding], &[IncarnationId]),
    now: Moment,
) -> Vec<Row> {
    let filter = Filter::lenient(&shape.filter);
    let is_large = is_large(store, cell);
    let maker = Maker { store, shape, filter: filter.as_ref(), findings, is_large, now };
    let mut nodes: Vec<(Key, Vec<Row>)> = Vec::new();
    let mut well: Vec<(Key, Vec<Row>)> = Vec::new();
    for incarnation in store.incarnations_of(cell) {
        let latest = store.is_present(incarnation);
        // A second process of a node that still runs must not hide the first one.
        if latest || shape.earlier || incarnation.condition == Condition::Attached {
            let group = if healthy.contains(&incarnation.id) { &mut well } else { &mut nodes };
            group.extend(maker.node(incarnation, latest));
        }
    }
    for one in unseen(store, cell) {
        if maker.filter.is_none_or(|filter| filter.takes(&one)) {
            let place = Place { node: Err(one.node), task: None, port: None };
            nodes.push((maker.key(&place, u64::MAX, 0), vec![maker.row(place, 0, false, true)]));
        }
    }
    let mut rows = maker.flat(nodes);
    if !healthy.is_empty() {
        let row = maker.row(Place::HEALTHY, 0, true, false);
        rows.push(row);
        rows.extend(maker.flat(well).into_iter().filter(|_| row.open));
    }
    rows
}

impl Fields for Unseen {
    fn field(&self, field: Field) -> Value<'_> {
        if field == Field::Node { Value::Text(self.name.raw().into()) } else { Value::Missing }
    }

    fn mentions(&self, words: &str) -> bool {
        self.name.shown().to_lowercase().contains(words)
    }
}

/// A number by which rows are sorted, ascending.
type Key = u64;

struct Maker<'a> {
    store: &'a Store,
    shape: &'a Shape,
    filter: Option<&'a Filter>,
    findings: &'a [Finding],
    is_large: bool,
    now: Moment,
}

impl Maker<'_> {
    /// Whether the filter selects the node or the task itself.
    fn wants(&self, incarnation: &NodeIncarnation, task: Option<&TaskSnapshot>) -> bool {
        let row = NodeRow { incarnation, task, findings: self.findings };
        self.filter.is_none_or(|filter| filter.takes(&row))
    }

    /// Whether the filter selects all rows within a selected row.
    fn wants_within(&self) -> bool {
        self.filter.is_none_or(Filter::is_words)
    }

    /// Makes a row. `first` says whether the rows within it are shown by default.
    fn row(&self, place: Place, depth: u8, parent: bool, first: bool) -> Row {
        // A filter also shows its matches within rows that are closed.
        let open = parent && (first != self.shape.toggled.contains(&place) || !self.shape.filter.is_empty());
        Row { place, depth, parent, open }
    }

    fn key(&self, place: &Place, slack_us: u64, queued: u64) -> Key {
        match self.shape.sort {
            Sort::Name => 0,
            Sort::Slack => slack_us,
            Sort::Queue => u64::MAX - queued,
            Sort::Health => {
                let worst = self.findings.iter().filter(|f| place.holds(&f.place)).map(|f| f.level).max();
                match worst {
                    Some(Severity::Bad) => 0,
                    Some(Severity::Warn) => 1,
                    Some(Severity::Note | Severity::Trace) => 2,
                    None => 3,
                }
            }
        }
    }

    fn flat(&self, mut groups: Vec<(Key, Vec<Row>)>) -> Vec<Row> {
        if self.shape.sort != Sort::Name {
            groups.sort_by_key(|(key, _)| *key);
        }
        if self.shape.inverted {
            groups.reverse();
        }
        groups.into_iter().flat_map(|(_, rows)| rows).collect()
    }

    /// The rows of a node and of its tasks and ports. The row of an earlier incarnation is closed by default, because
    /// users look for the latest one.
    fn node(&self, incarnation: &NodeIncarnation, latest: bool) -> Option<(Key, Vec<Row>)> {
        let place = Place { node: Ok(incarnation.id), task: None, port: None };
        let wanted = self.wants(incarnation, None);
        let all = wanted && self.wants_within();
        let tasks: Vec<_> =
            incarnation.tasks().iter().filter_map(|t| self.task(incarnation, t, place, all)).collect();
        if !wanted && tasks.is_empty() {
            return None;
        }
        let slack = incarnation.tasks().iter().map(|t| self.slack(incarnation, t)).min().unwrap_or(u64::MAX);
        let queued = incarnation.tasks().iter().flat_map(|t| &t.view.ports).map(|p| u64::from(p.len)).sum();
        let row = self.row(place, 0, !tasks.is_empty(), latest && !self.is_large);
        let mut rows = vec![row];
        if row.open {
            rows.extend(self.flat(tasks));
        }
        Some((self.key(&place, slack, queued), rows))
    }

    fn task(
        &self,
        incarnation: &NodeIncarnation,
        task: &TaskSnapshot,
        node: Place,
        all: bool,
    ) -> Option<(Key, Vec<Row>)> {
        let place = Place { task: Some(task.view.task), ..node };
        let wanted = all || self.wants(incarnation, Some(task));
        let within = wanted && self.wants_within();
        let port = |p: &PortView| {
            let place = Place { port: Some(p.port), ..place };
            let by_slack = p.min_slack.filter(|_| self.shape.sort == Sort::Slack);
            let slack = by_slack.map_or(u64::MAX, |s| incarnation.left(s, task.age_us, self.now).us);
            let takes = |filter: &Filter| {
                let (store, findings, now) = (self.store, self.findings, self.now);
                filter.takes(&PortRow { store, incarnation, task, port: p, findings, now })
            };
            let wanted = within || self.filter.is_none_or(takes);
            wanted.then(|| (self.key(&place, slack, p.len.into()), self.row(place, 2, false, true)))
        };
        let mut ports: Vec<(Key, Row)> = task.view.ports.iter().filter_map(port).collect();
        if !wanted && ports.is_empty() {
            return None;
        }
        let queued = task.view.ports.iter().map(|p| u64::from(p.len)).sum();
        let row = self.row(place, 1, !ports.is_empty(), true);
        let mut rows = vec![row];
        if row.open {
            if self.shape.sort != Sort::Name {
                ports.sort_by_key(|(key, _)| *key);
            }
            if self.shape.inverted {
                ports.reverse();
            }
            rows.extend(ports.into_iter().map(|(_, row)| row));
        }
        Some((self.key(&place, self.slack(incarnation, task), queued), rows))
    }

    /// The shortest slack at a task, if the rows are sorted by slack.
    fn slack(&self, incarnation: &NodeIncarnation, task: &TaskSnapshot) -> u64 {
        if self.shape.sort != Sort::Slack {
            return u64::MAX;
        }
        let slacks = task.view.ports.iter().filter_map(|p| p.min_slack);
        slacks.min().map_or(u64::MAX, |s| incarnation.left(s, task.age_us, self.now).us)
    }
}
