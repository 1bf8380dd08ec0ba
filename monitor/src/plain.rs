//! Output without a screen: one sample, a sample per period, or a line for each event.

use crate::clock::Clock;
use crate::error::MonitorError;
use crate::judge::{ConformanceWorker, Judge};
use crate::name::shown_line;
use crate::options::{Format, Options, Verdict};
use crate::query::Assertion;
use crate::record::{Recorded, Tape};
use crate::replay::{Player, tell};
use crate::report;
use crate::signals::{self, Call, Listener};
use crate::source::live::{Live, Which};
use crate::source::{Arrival, Feed, Sink, Source, SourceId};
use crate::store::Store;
use crate::store::journal::Entry;
use imrs_wire::files;
use imrs_wire::obs::ServerFrame;
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

/// How long a node that runs at the start may take to deliver its state: on a busy machine its thread for monitors runs last.
const PATIENCE: Duration = Duration::from_secs(4);
/// The time between two printed lines if the user gave no period.
const PERIOD: Duration = Duration::from_secs(1);
/// How often assertions are checked against the store.
const ASSERTED: Duration = Duration::from_millis(100);
/// How often a recording without a screen checks whether it must end.
const LOOK: Duration = Duration::from_millis(50);

/// Watches nodes without a screen: collects their frames in a [`Store`].
pub struct Watch {
    clock: Clock,
    store: Store,
    arrivals: Receiver<Arrival>,
    /// Sources that have delivered a node's state, or have failed to deliver it.
    settled: BTreeSet<SourceId>,
    source: Live,
}

impl Watch {
    /// Starts to watch the nodes of `which`.
    ///
    /// # Errors
    /// [`MonitorError`].
    pub fn start(which: Which, clock: Clock) -> Result<Self, MonitorError> {
        Self::start_taped(Live::new(which), clock, &Arc::default())
    }

    /// Starts to watch `source`. Every arrival passes through `tape`, which may record it.
    ///
    /// # Errors
    /// [`MonitorError`].
    pub fn start_taped(source: Live, clock: Clock, tape: &Arc<Tape>) -> Result<Self, MonitorError> {
        Self::start_judged(source, clock, tape, None)
    }

    /// As [`start_taped`](Self::start_taped); additionally `judge` checks the recordings of the nodes.
    ///
    /// # Errors
    /// [`MonitorError`].
    pub fn start_judged(
        mut source: Live,
        clock: Clock,
        tape: &Arc<Tape>,
        judge: Option<Arc<dyn Judge>>,
    ) -> Result<Self, MonitorError> {
        let (sender, arrivals) = sync_channel(64);
        let (taped, judged) = (Arc::clone(tape), sender.clone());
        let worker =
            ConformanceWorker::open(judge, Sink::new(clock, move |arrival| judged.send(arrival).is_ok()));
        source.start(Sink::new(clock, move |arrival| {
            taped.take(&arrival);
            worker.hear(&arrival.feed);
            sender.send(arrival).is_ok()
        }))?;
        Ok(Self { clock, store: Store::of_running_nodes(), arrivals, settled: BTreeSet::new(), source })
    }

    /// Collects the frames that arrive during `length`.
    pub fn watch(&mut self, length: Duration) {
        let until = Instant::now() + length;
        while let Ok(arrival) = self.arrivals.recv_timeout(until.saturating_duration_since(Instant::now())) {
            self.take(arrival);
            if Instant::now() >= until {
                break;
            }
        }
    }

    /// Waits until every node that ran at the start has delivered its state or failed. Returns false if none delivered its state.
    pub fn settle(&mut self) -> bool {
        let until = Instant::now() + PATIENCE;
        while self.settled.len() < self.source.started() {
            match self.arrivals.recv_timeout(until.saturating_duration_since(Instant::now())) {
                Ok(arrival) => self.take(arrival),
                Err(_) => break,
            }
        }
        !self.store.incarnations().is_empty()
    }

    /// The collected state of all nodes.
    #[must_use]
    pub const fn store(&self) -> &Store {
        &self.store
    }

    fn take(&mut self, arrival: Arrival) {
        let settles = match &arrival.feed {
            Feed::Frame(frame) => matches!(**frame, ServerFrame::Snapshot(_) | ServerFrame::Delta(_)),
            Feed::Lost { .. } | Feed::Failed { .. } | Feed::Left | Feed::Stale { .. } => true,
            Feed::Attached { .. } | Feed::Judged { .. } => false,
        };
        if settles {
            self.settled.insert(arrival.source);
        }
        let gaps = self.store.gaps();
        self.store.apply(arrival);
        if self.store.gaps() > gaps {
            self.source.wishes().want_whole();
        }
    }
}

/// Records frames without a screen, for the given length or until a signal.
///
/// # Errors
/// [`MonitorError`], also if a frame could not be written.
pub fn record(
    options: &Options,
    path: &Path,
    which: Which,
    out: &mut impl Write,
) -> Result<Verdict, MonitorError> {
    let (clock, tape, looked) = (Clock::start(), Arc::new(Tape::default()), looked(&which));
    crate::record::free(path, options.force)?;
    tape.start(path, clock.now())?;
    let ended = Arc::new(AtomicBool::new(false));
    let called = Arc::clone(&ended);
    let listener = Listener::start(move |call| {
        match call {
            Call::End(_) => called.store(true, Ordering::Relaxed),
            Call::Stop => signals::stop(),
            Call::GoOn => {}
        }
        true
    })?;
    let mut watch = Watch::start_taped(crate::live(options, which, &tape), clock, &tape)?;
    let found = watch.settle();
    while found && !ended.load(Ordering::Relaxed) && options.length.is_none_or(|length| clock.now() < length)
    {
        watch.watch(LOOK);
    }
    drop(listener);
    let failed = |why| MonitorError::Recording { path: path.to_owned(), why };
    let Some(Recorded { status, .. }) = tape.stop() else { return Err(MonitorError::Internal) };
    if let Some(why) = status.failure {
        return Err(failed(why));
    }
    if !found {
        // An empty recording is useless, so its file is removed.
        files::discard(path);
        let failed = watch.store().troubles().map(str::to_owned).collect();
        return Err(MonitorError::NothingFound { looked, failed });
    }
    if !status.ended {
        return Err(failed("the disk takes too long: the recording has no end".to_owned()));
    }
    let (records, bytes, lost) = (status.records, status.bytes, status.lost);
    let said = match options.format {
        Format::Json => {
            writeln!(out, "{{\"version\":1,\"records\":{records},\"bytes\":{bytes},\"lost\":{lost}}}")
        }
        Format::Text => {
            let lost = if lost > 0 { format!(", {lost} lost") } else { String::new() };
            let file = shown_line(&path.display().to_string());
            writeln!(out, "{records} records, {bytes} bytes{lost}: imrs monitor --replay {file}")
        }
    };
    finish(said.map(|()| Verdict::Healthy))
}

/// Prints a recording. With `text`, prints every step of a counterexample, or a line for every notable event of other recordings.
/// Otherwise prints one stop: the requested one, or the last.
///
/// # Errors
/// [`MonitorError`]. A reader that closes the pipe is no error.
pub fn replay(options: &Options, mut player: Player, out: &mut impl Write) -> Result<Verdict, MonitorError> {
    let only = options.cell.as_deref();
    let all = options.text && !options.once && options.at.is_none();
    if !options.assertions.is_empty() {
        return finish(asserted_of(options, &mut player, out));
    }
    let said = match options.format {
        Format::Text if all && player.film().story.is_some() => steps(&mut player, out),
        Format::Text if all => entries(&mut player, out),
        Format::Json | Format::Text => {
            match options.at {
                Some(at) => player.seek(at),
                None => player.go_to_end(),
            }
            match options.format {
                Format::Json => writeln!(out, "{}", report::json_of_replay(&player, only)),
                Format::Text => out.write_all(report::text_of_replay(&player, only).as_bytes()),
            }
        }
    };
    let found = player.film().story.is_some() && player.is_at_end();
    let critical = found || report::is_critical(player.store(), only, player.moment());
    finish(
        said.and_then(|()| out.flush()).map(|()| if critical { Verdict::Finding } else { Verdict::Healthy }),
    )
}

/// Checks the assertions at every stop of a recording until one of them fails, or only at the requested stop.
fn asserted_of(options: &Options, player: &mut Player, out: &mut impl Write) -> io::Result<Verdict> {
    let stops = match options.at {
        Some(at) => {
            player.seek(at);
            player.stop()..player.stop() + 1
        }
        None => 0..player.film().stops().len(),
    };
    let mut held = Vec::new();
    for stop in stops {
        player.go(stop);
        let cells = report::cells(player.store(), options.cell.as_deref());
        let hold = |assertion: &Assertion| assertion.holds(player.store(), &cells, player.moment());
        held = options.assertions.iter().map(hold).collect();
        if held.iter().any(|held| !held.holds) {
            break;
        }
    }
    let failed = held.iter().any(|held| !held.holds);
    match options.format {
        Format::Json => writeln!(out, "{}", report::json_of_assertions(&options.assertions, &held))?,
        Format::Text => {
            out.write_all(report::text_of_assertions(&options.assertions, &held).as_bytes())?;
            if failed {
                writeln!(out, "  at {}", player.position())?;
            }
        }
    }
    Ok(if failed { Verdict::Finding } else { Verdict::Healthy })
}

/// Prints every step of a counterexample, one block each.
fn steps(player: &mut Player, out: &mut impl Write) -> io::Result<()> {
    out.write_all(tell::story(player).as_bytes())?;
    for stop in 0..player.film().stops().len() {
        player.go(stop);
        write!(out, "\n{}", tell::step(player))?;
    }
    Ok(())
}

/// Prints a line for every notable event. The journal keeps only the newest entries, so it is read at every stop of the recording.
fn entries(player: &mut Player, out: &mut impl Write) -> io::Result<()> {
    let mut next = 0;
    for stop in 0..player.film().stops().len() {
        player.go(stop);
        let journal = player.store().journal();
        journal.since(next).into_iter().try_for_each(|entry| writeln!(out, "{}", line(entry)))?;
        next = journal.next_number();
    }
    Ok(())
}

fn looked(which: &Which) -> Option<PathBuf> {
    match which {
        Which::Under(base) => Some(base.clone()),
        Which::Named(_) => None,
    }
}

/// Turns the error of a closed pipe into success.
fn finish(verdict: io::Result<Verdict>) -> Result<Verdict, MonitorError> {
    match verdict {
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(Verdict::Healthy),
        other => other.map_err(MonitorError::Terminal),
    }
}

/// Prints to `out` the output for which `options` ask.
///
/// # Errors
/// [`MonitorError`]. A reader that closes the pipe is no error.
pub fn print(
    options: &Options,
    which: Which,
    clock: Clock,
    out: &mut impl Write,
) -> Result<Verdict, MonitorError> {
    let looked = looked(&which);
    let tape = Arc::default();
    let live = crate::live(options, which, &tape);
    let mut watch = Watch::start_judged(live, clock, &tape, options.judge.clone())?;
    let only = options.cell.as_deref();
    let found = watch.settle();
    if let (true, Some(name), true) = (found, only, report::cells(watch.store(), only).is_empty()) {
        let cells = watch.store().cells().iter().map(|cell| cell.shown().to_owned()).collect();
        return Err(MonitorError::NoSuchCell { name: name.to_owned(), cells });
    }
    if !found || report::cells(watch.store(), only).is_empty() {
        let failed = watch.store().troubles().map(str::to_owned).collect();
        return Err(MonitorError::NothingFound { looked, failed });
    }
    if !options.assertions.is_empty() {
        return finish(asserted(&mut watch, options, out));
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
    finish(verdict)
}

/// Checks the assertions: once, or periodically until one of them fails or the given length is over.
fn asserted(watch: &mut Watch, options: &Options, out: &mut impl Write) -> io::Result<Verdict> {
    let until = options.length.map(|length| Instant::now() + length);
    loop {
        let now = watch.clock.now();
        let cells = report::cells(watch.store(), options.cell.as_deref());
        let held: Vec<_> =
            options.assertions.iter().map(|assertion| assertion.holds(watch.store(), &cells, now)).collect();
        let failed = held.iter().any(|held| !held.holds);
        let over = until.is_none_or(|until| Instant::now() >= until);
        if failed || over {
            match options.format {
                Format::Json => writeln!(out, "{}", report::json_of_assertions(&options.assertions, &held))?,
                Format::Text => {
                    out.write_all(report::text_of_assertions(&options.assertions, &held).as_bytes())?;
                }
            }
            out.flush()?;
            return Ok(if failed { Verdict::Finding } else { Verdict::Healthy });
        }
        let left = until.map_or(LOOK, |until| until.saturating_duration_since(Instant::now()));
        watch.watch(options.watch.unwrap_or(ASSERTED).min(left));
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

/// Prints one line for every notable event, from the entry of the journal with number `next` on.
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
    let at = entry.at.as_secs_f64();
    let text = format!(
        "{at:.3} {} {} {} {} {}",
        entry.node,
        entry.kind(),
        entry.object(),
        entry.detail(),
        entry.count()
    );
    shown_line(&text.split_whitespace().collect::<Vec<_>>().join(" "))
}
