//! The numbers in a row of the overview: those of a port, or sums over the ports of tasks.

use super::columns::Cells;
use crate::app::App;
use crate::clock::Moment;
use crate::store::recent::WINDOW;
use crate::store::{Left, NodeIncarnation};
use crate::theme::Ink;
use imrs_protocol::{PortCounters, PortView, TaskId, Usage};
use imrs_wire::obs::TaskSnapshot;

/// The sums over ports: queued messages, least slack, rate and counters.
#[derive(Default)]
pub(super) struct Sum {
    len: u64,
    capacity: u64,
    rate: Option<f64>,
    least: Option<Left>,
    counts: Counts,
}

impl Sum {
    /// The sums over the ports of `tasks`.
    pub(super) fn of(app: &App, incarnation: &NodeIncarnation, tasks: &[TaskSnapshot], now: Moment) -> Self {
        let mut sum = Self::default();
        sum.add(app, incarnation, tasks, now);
        sum
    }

    pub(super) fn add(
        &mut self,
        app: &App,
        incarnation: &NodeIncarnation,
        tasks: &[TaskSnapshot],
        now: Moment,
    ) {
        for task in tasks {
            let earlier = incarnation.earlier(task);
            let slacks = task.view.ports.iter().filter_map(|port| port.min_slack);
            let left = slacks.min().map(|slack| incarnation.left(slack, task.age_us, now));
            self.least = [self.least, left].into_iter().flatten().min();
            for port in &task.view.ports {
                if port.usage != Usage::Waitfor {
                    self.len += u64::from(port.len);
                    self.capacity += u64::from(port.capacity);
                }
                let rate = incarnation.rate_of(earlier, port);
                self.rate = [self.rate, rate].into_iter().flatten().reduce(|a, b| a + b);
                self.counts.add(&Counts::of(app, incarnation, task.view.task, port, now));
            }
        }
    }

    pub(super) fn show(&self, cells: &mut Cells) {
        if self.capacity > 0 {
            cells[2] = (format!("{}/{}", self.len, self.capacity), Ink::Plain);
        }
        cells[3] = (self.least.map_or_else(|| "-".to_owned(), |l| l.to_string()), Ink::Plain);
        cells[4] = (per_second(self.rate), Ink::Plain);
        self.counts.show(cells);
    }
}

/// A rate as text, rounded.
pub(super) fn per_second(rate: Option<f64>) -> String {
    rate.map_or_else(|| "-".to_owned(), |rate| format!("{rate:.0}"))
}

/// Five counters of a port: expired, refused or evicted, rejected, sent again, timed out. `all` counts since the start
/// or the mark, `lately` in the last seconds.
#[derive(Default)]
pub(super) struct Counts {
    all: [u64; 5],
    lately: [u64; 5],
}

impl Counts {
    /// The counters of a port: since the start, or since the mark if the user chose that.
    pub(super) fn of(
        app: &App,
        incarnation: &NodeIncarnation,
        task: TaskId,
        view: &PortView,
        now: Moment,
    ) -> Self {
        let five = |c: &PortCounters| {
            [c.expired, c.refused.saturating_add(c.evicted), c.rejected, c.resent, c.timed_out]
        };
        if app.since_mark
            && let Some((_, store)) = app.mark()
        {
            let before = store.incarnation(incarnation.id).and_then(|marked| marked.port(task, view.port));
            let before = five(&before.map(|port| port.counters).unwrap_or_default());
            let now = five(&view.counters);
            return Self { all: std::array::from_fn(|i| now[i].saturating_sub(before[i])), lately: [0; 5] };
        }
        // A node that no longer sends its state has no counts of the last seconds.
        let is_fresh = incarnation.last.as_ref().is_some_and(|last| now.saturating_sub(last.at) < WINDOW);
        let is_here = is_fresh && !incarnation.presence(now).is_gone();
        let grown = is_here.then(|| incarnation.recent.grown(task, view.port, &view.counters));
        Self { all: five(&view.counters), lately: five(&grown.unwrap_or_default()) }
    }

    fn add(&mut self, other: &Self) {
        for i in 0..self.all.len() {
            self.all[i] = self.all[i].saturating_add(other.all[i]);
            self.lately[i] = self.lately[i].saturating_add(other.lately[i]);
        }
    }

    /// Shows a counter that has grown in the last seconds as `+3`, and any other counter as its whole count.
    pub(super) fn show(&self, cells: &mut Cells) {
        for (cell, (all, lately)) in cells[5..10].iter_mut().zip(self.all.iter().zip(&self.lately)) {
            *cell = match (*lately, *all) {
                (0, 0) => ("0".to_owned(), Ink::Dim),
                (0, all) => (short(all), Ink::Plain),
                (lately, _) => (format!("+{}", short(lately)), Ink::Warn),
            };
        }
    }
}

fn short(count: u64) -> String {
    match count {
        0..1_000 => count.to_string(),
        1_000..1_000_000 => format!("{}k", count / 1000),
        _ => format!("{}M", count / 1_000_000),
    }
}
