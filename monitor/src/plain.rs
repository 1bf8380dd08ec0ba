//! Without a screen: a sample once, a sample every so often, or a line for everything that happens.

use crate::clock::Clock;
use crate::error::MonitorError;
use crate::options::{Format, Options, Verdict};
use crate::report;
use crate::source::live::{Live, Which};
use crate::source::{Arrival, Feed, Sink, Source, SourceId};
use crate::store::Store;
use crate::store::journal::Entry;
use imrs_wire::obs::ServerFrame;
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

/// How long the nodes that are there have to show themselves.
const PATIENCE: Duration = Duration::from_millis(1500);
/// How often lines are written where no period was asked for.
const PERIOD: Duration = Duration::from_secs(1);

/// Nodes, and what is known of them.
pub struct Watch {
    clock: Clock,
    store: Store,
    arrivals: Receiver<Arrival>,
    /// Sources that have shown a node's state, or that there is none.
    settled: BTreeSet<SourceId>,
    source: Live,
}

impl Watch {
    /// Begins to watch `which`.
    ///
    /// # Errors
    /// [`MonitorError`].
    pub fn start(which: Which, clock: Clock) -> Result<Self, MonitorError> {
        let (sender, arrivals) = sync_channel(64);
        let mut source = Live::new(which);
        source.start(Sink::new(clock, move |arrival| sender.send(arrival).is_ok()))?;
        Ok(Self { clock, store: Store::default(), arrivals, settled: BTreeSet::new(), source })
    }

    /// Takes what comes for so long.
    pub fn watch(&mut self, length: Duration) {
        let until = Instant::now() + length;
        while let Ok(arrival) = self.arrivals.recv_timeout(until.saturating_duration_since(Instant::now())) {
            self.take(arrival);
            if Instant::now() >= until {
                break;
            }
        }
    }

    /// Waits until every node that was there at the start has shown itself or failed to. `false`: nobody did.
    pub fn settle(&mut self) -> bool {
        let until = Instant::now() + PATIENCE;
        while self.settled.len() < self.source.started() {
            match self.arrivals.recv_timeout(until.saturating_duration_since(Instant::now())) {
                Ok(arrival) => self.take(arrival),
                Err(_) => break,
            }
        }
        !self.store.lives().is_empty()
    }

    /// What is known.
    #[must_use]
    pub const fn store(&self) -> &Store {
        &self.store
    }

    fn take(&mut self, arrival: Arrival) {
        let settles = match &arrival.feed {
            Feed::Frame(frame) => matches!(**frame, ServerFrame::Snapshot(_)),
            Feed::Lost { .. } | Feed::Failed { .. } | Feed::Left | Feed::Stale { .. } => true,
            Feed::Attached { .. } => false,
        };
        if settles {
            self.settled.insert(arrival.source);
        }
        self.store.apply(arrival);
    }
}

/// Prints what `options` ask for to `out`.
///
/// # Errors
/// [`MonitorError`]; a reader that has seen enough is none.
pub fn print(
    options: &Options,
    which: Which,
    clock: Clock,
    out: &mut impl Write,
) -> Result<Verdict, MonitorError> {
    let looked = match &which {
        Which::Under(base) => Some(base.clone()),
        Which::Named(_) => None,
    };
    let mut watch = Watch::start(which, clock)?;
    let only = options.cell.as_deref();
    if !watch.settle() || report::cells(watch.store(), only).is_empty() {
        let failed = watch.store().troubles().map(str::to_owned).collect();
        return Err(MonitorError::NothingFound { looked, failed });
    }
    let repeat = !options.once && (options.watch.is_some() || options.text);
    let lines = repeat && options.watch.is_none() && options.format == Format::Text;
    let mut verdict = sample(&watch, options, out);
    let mut next = watch.store().journal().next_number();
    while repeat && verdict.is_ok() {
        watch.watch(options.watch.unwrap_or(PERIOD));
        verdict =
            if lines { happened(&watch, &mut next, options, out) } else { sample(&watch, options, out) };
    }
    match verdict {
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(Verdict::Healthy),
        other => other.map_err(MonitorError::Terminal),
    }
}

fn sample(watch: &Watch, options: &Options, out: &mut impl Write) -> io::Result<Verdict> {
    let (now, only) = (watch.clock.now(), options.cell.as_deref());
    match options.format {
        Format::Json => writeln!(out, "{}", report::json(watch.store(), only, now))?,
        Format::Text => out.write_all(report::text(watch.store(), only, now).as_bytes())?,
    }
    out.flush()?;
    Ok(verdict(watch, options))
}

fn verdict(watch: &Watch, options: &Options) -> Verdict {
    let critical = report::is_critical(watch.store(), options.cell.as_deref(), watch.clock.now());
    if critical { Verdict::Finding } else { Verdict::Healthy }
}

/// One line for everything that matters and that happened since the line `next`.
fn happened(watch: &Watch, next: &mut u64, options: &Options, out: &mut impl Write) -> io::Result<Verdict> {
    let journal = watch.store().journal();
    for entry in journal.since(*next) {
        writeln!(out, "{}", line(entry))?;
    }
    *next = journal.next_number();
    out.flush()?;
    Ok(verdict(watch, options))
}

fn line(entry: &Entry) -> String {
    let times = if entry.times > 1 { format!(" x{}", entry.times) } else { String::new() };
    let at = entry.at.as_secs_f64();
    let text =
        format!("{at:.3} {} {} {} {}{times}", entry.node, entry.kind(), entry.object(), entry.detail());
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
