//! The rows of the timeline, and which events share a row.

use crate::store::timeline::{Gap, Mark, Timeline};
use std::time::Duration;

/// Up to this many empty rows are drawn one by one; a longer run takes one row.
const QUIET: u128 = 2;

/// A row of the timeline.
#[derive(Clone, Debug)]
pub enum Slice {
    /// Events: their positions in [`Timeline::marks`].
    Marks(Vec<usize>),
    /// The monitor lost events here.
    Lost(Gap),
    /// Nothing happened for this long.
    Quiet(Duration),
    /// Folded rows whose marks are all in lanes without room: the positions of these marks in [`Timeline::marks`].
    Elsewhere(Vec<usize>),
}

impl Slice {
    /// The positions of the row's marks.
    #[must_use]
    pub fn marks(&self) -> &[usize] {
        match self {
            Self::Marks(marks) | Self::Elsewhere(marks) => marks,
            Self::Lost(_) | Self::Quiet(_) => &[],
        }
    }
}

/// Folds each sequence of rows whose marks are all in hidden lanes into one row.
pub(super) fn folded(rows: Vec<Slice>, is_visible: impl Fn(usize) -> bool) -> Vec<Slice> {
    let mut out: Vec<Slice> = Vec::with_capacity(rows.len());
    for row in rows {
        let Slice::Marks(marks) = row else {
            out.push(row);
            continue;
        };
        if marks.is_empty() || marks.iter().any(|&at| is_visible(at)) {
            out.push(Slice::Marks(marks));
            continue;
        }
        // A quiet row between two rows of hidden lanes shows nothing, so it is folded, too.
        let is_quiet =
            |row: &Slice| matches!(row, Slice::Quiet(_)) || matches!(row, Slice::Marks(m) if m.is_empty());
        let before = out.iter().rposition(|row| !is_quiet(row));
        match before.map(|at| (at, &mut out[at])) {
            Some((at, Slice::Elsewhere(earlier))) => {
                earlier.extend(marks);
                out.truncate(at + 1);
            }
            _ => out.push(Slice::Elsewhere(marks)),
        }
    }
    out
}

/// The rows of the wanted marks. Without a zoom, consecutive marks in hidden lanes share a row from the start.
pub(super) fn slices(
    timeline: &Timeline,
    wanted: impl Fn(&Mark) -> bool,
    is_visible: impl Fn(usize) -> bool,
    zoom: Option<Duration>,
) -> Vec<Slice> {
    let mut rows = Vec::new();
    let mut gaps = timeline.gaps.iter().peekable();
    let mut before: Option<u128> = None;
    let marks = timeline.marks.iter().enumerate().filter(|(_, mark)| wanted(mark));
    for (at, mark) in marks {
        while let Some(gap) = gaps.next_if(|gap| gap.order <= mark.order) {
            rows.push(Slice::Lost(*gap));
            before = None;
        }
        let Some(zoom) = zoom else {
            match rows.last_mut() {
                _ if is_visible(at) => rows.push(Slice::Marks(vec![at])),
                Some(Slice::Elsewhere(marks)) => marks.push(at),
                _ => rows.push(Slice::Elsewhere(vec![at])),
            }
            continue;
        };
        let bucket = mark.order.as_micros() / zoom.as_micros().max(1);
        match (before, rows.last_mut()) {
            (Some(same), Some(Slice::Marks(marks))) if same == bucket => marks.push(at),
            (earlier, _) => {
                let quiet = earlier.map_or(0, |earlier| bucket.saturating_sub(earlier).saturating_sub(1));
                if quiet > QUIET {
                    rows.push(Slice::Quiet(zoom.saturating_mul(u32::try_from(quiet).unwrap_or(u32::MAX))));
                } else {
                    rows.extend((0..quiet).map(|_| Slice::Marks(Vec::new())));
                }
                rows.push(Slice::Marks(vec![at]));
            }
        }
        before = Some(bucket);
    }
    rows.extend(gaps.map(|gap| Slice::Lost(*gap)));
    rows
}
