//! Decides which frames one monitor gets, and when.

use super::Showing;
use super::pass::Pass;
use crate::clock;
use crate::observe::lateness::Seen;
use crate::observe::observations::Observations;
use crate::observe::snapshot::{QUEUE_LIMIT, Watching};
use imrs_wire::obs::{
    EventFilter, FrameError, FrameWriter, HeldBack, MAX_WATCHED, Places, ServerFrame, Snapshot, Subscribe,
    Version, Want,
};
use std::io::Write;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The shortest time between two snapshots.
const LEAST_PERIOD: Duration = Duration::from_millis(10);
/// The time between two frames of events.
const EVENT_PERIOD: Duration = Duration::from_millis(20);
/// The shortest time between two frames of vitals, which are read from the system.
const LEAST_VITALS: Duration = Duration::from_millis(100);
/// How often the addresses of the other nodes are checked for changes.
const PLACES_PERIOD: Duration = Duration::from_secs(1);
/// How often the held-back scripts are checked.
const HELD_BACK_PERIOD: Duration = Duration::from_secs(1);
/// The first version that reports which scripts are held back.
const HELD_BACK: Version = Version { major: 1, minor: 2 };
/// The first version that reports on links.
const LINKS: Version = Version { major: 1, minor: 4 };

/// The frames for which one monitor has asked.
pub(super) struct Subscription {
    period: Duration,
    watching: Watching,
    pub credit: u16,
    next_snapshot: Instant,
    events: Option<Following>,
    /// The additional frames, only for monitors of version 1.1 or later.
    more: Option<More>,
}

/// The kinds of frames. Of several frames that have been due since the same instant, the kind first in this list is
/// sent first. So a monitor that gets the state already knows the other nodes and the held-back scripts.
#[derive(Clone, Copy)]
enum What {
    Places,
    HeldBack,
    Detail,
    State,
    Events,
    Vitals,
    Links,
}

impl What {
    /// Whether the frame costs one of the monitor's credits.
    const fn has_a_price(self) -> bool {
        !matches!(self, Self::Places | Self::HeldBack)
    }
}

/// The events that one monitor follows.
struct Following {
    next: Instant,
    observations: Observations,
    filter: EventFilter,
}

/// The frames that versions 1.1, 1.2 and 1.4 added.
struct More {
    /// The last snapshot that the monitor got; the next changes are relative to it.
    told: Option<Arc<Snapshot>>,
    /// Since when the frame about the watched queues is due.
    detail: Option<Instant>,
    vitals: Option<(Duration, Instant)>,
    /// Whether the monitor understands reports of links.
    hears_links: bool,
    /// Since when the report of the links is due.
    links: Option<Instant>,
    late: Seen,
    whole: Option<(Duration, Instant)>,
    places: (Places, Instant),
    /// Whether the monitor already has the list of held-back scripts, and when the list is checked next; `None` for
    /// version 1.1.
    held_back: Option<(bool, Instant)>,
}

impl Subscription {
    /// The subscription of a monitor of version 1.0. It replaces the earlier subscription `before`.
    pub fn old(wanted: &Subscribe, before: Option<Self>, showing: &Showing, now: Instant) -> Self {
        let events = wanted.events.then_some(EventFilter::ALL);
        Self {
            period: period(wanted.period_us),
            watching: Watching { queue_limit: wanted.queue_limit.min(QUEUE_LIMIT).into(), ports: Vec::new() },
            credit: wanted.credit,
            next_snapshot: now,
            events: following(events, before.and_then(|before| before.events), showing, now),
            more: None,
        }
    }

    /// The subscription of a monitor of version 1.1 or later.
    pub fn new(
        wanted: Want,
        before: Option<Self>,
        showing: &Showing,
        now: Instant,
        version: Version,
    ) -> Self {
        let (events, more, next) = match before {
            Some(before) => (before.events, before.more, before.next_snapshot),
            None => (None, None, now),
        };
        let every = |us: u32, least: Duration| (us > 0).then(|| Duration::from_micros(us.into()).max(least));
        let mut ports = wanted.watched;
        ports.truncate(MAX_WATCHED);
        let period = period(wanted.period_us);
        let more = more.unwrap_or_else(|| More {
            told: None,
            detail: None,
            vitals: None,
            late: Seen::default(),
            whole: None,
            places: (Places::default(), now),
            held_back: (version.minor >= HELD_BACK.minor).then_some((false, now)),
            hears_links: version.minor >= LINKS.minor,
            links: None,
        });
        // A new subscription does not postpone a frame of vitals: otherwise a monitor that often subscribes would
        // never get one.
        let at = more.vitals.map_or(now, |(_, at)| at.min(now));
        let vitals = every(wanted.vitals_us, LEAST_VITALS).map(|every| (every, at));
        let whole = every(wanted.whole_us, period).map(|every| (every, now + every));
        Self {
            period,
            watching: Watching { queue_limit: wanted.queue_limit.min(QUEUE_LIMIT).into(), ports },
            credit: wanted.credit,
            next_snapshot: next.min(now + period),
            events: following(wanted.events, events, showing, now),
            more: Some(More { vitals, whole, ..more }),
        }
    }

    /// Makes the next state frame a whole snapshot, because the monitor asked for one. Frames that were due earlier
    /// still go first.
    pub fn whole(&mut self, now: Instant) {
        if let Some(more) = &mut self.more {
            more.told = None;
            self.next_snapshot = now;
        }
    }

    /// For each kind of frame, when the next frame is due, if at all.
    fn dues(&self) -> [(Option<Instant>, What); 7] {
        let more = self.more.as_ref();
        [
            (more.map(|more| more.places.1), What::Places),
            (more.and_then(|more| more.held_back).map(|(_, at)| at), What::HeldBack),
            (more.and_then(|more| more.detail), What::Detail),
            (Some(self.next_snapshot), What::State),
            (self.events.as_ref().map(|events| events.next), What::Events),
            (more.and_then(|more| more.vitals).map(|(_, at)| at), What::Vitals),
            (more.and_then(|more| more.links), What::Links),
        ]
    }

    /// When the next frame is due, if the monitor has credit.
    pub fn due(&self) -> Option<Instant> {
        let due = self.dues().into_iter().filter_map(|(at, _)| at).min();
        due.filter(|_| self.credit > 0)
    }

    /// Makes at most one frame, and none while an earlier frame is still being sent. The frame that has been due for
    /// longest goes first: otherwise, on a busy machine, state frames, which have the shortest period, would delay
    /// all others for ever.
    pub fn push(
        &mut self,
        showing: &Showing,
        pass: &mut Pass,
        writer: &mut FrameWriter<impl Write>,
    ) -> Result<(), FrameError> {
        if self.credit == 0 {
            return Ok(());
        }
        let now = pass.now;
        let mut dues = self.dues();
        dues.sort_by_key(|(at, _)| *at);
        for (_, what) in dues.into_iter().filter(|(at, _)| at.is_some_and(|at| at <= now)) {
            let frame = match what {
                What::State => {
                    self.next_snapshot = pass.next(self.period);
                    self.push_snapshot(showing, pass, writer)?;
                    self.credit -= 1;
                    return Ok(());
                }
                What::Events => {
                    let frame = self.events(pass)?;
                    if !frame.is_empty() {
                        self.credit -= 1;
                        return writer.push_bytes(&frame);
                    }
                    None
                }
                What::Places => self.places(showing, pass),
                What::HeldBack => self.held_back(showing, now),
                What::Detail => self.detail(showing),
                What::Vitals => self.vitals(showing, pass),
                What::Links => self.links(showing),
            };
            if let Some(frame) = frame {
                writer.push(&frame)?;
                self.credit -= u16::from(what.has_a_price());
                return Ok(());
            }
        }
        Ok(())
    }

    /// Pushes the snapshot, or the changes since the last one. If it does not fit a frame, pushes it with fewer waiting
    /// messages.
    fn push_snapshot(
        &mut self,
        showing: &Showing,
        pass: &mut Pass,
        writer: &mut FrameWriter<impl Write>,
    ) -> Result<(), FrameError> {
        let mut watching = self.watching.clone();
        loop {
            let snapshot = pass.snapshot(showing, &watching);
            let pushed = match &mut self.more {
                None => writer.push(&ServerFrame::Snapshot(Snapshot::clone(&snapshot))),
                Some(more) => more.push_change(snapshot, pass, writer),
            };
            match pushed {
                Err(FrameError::TooLong { .. }) if watching != Watching::default() => {
                    watching.queue_limit /= 2;
                    watching.ports.clear();
                }
                Ok(()) => {
                    if let Some(more) = &mut self.more {
                        more.detail = (!self.watching.ports.is_empty()).then_some(pass.now);
                    }
                    return Ok(());
                }
                other => return other,
            }
        }
    }

    fn detail(&mut self, showing: &Showing) -> Option<ServerFrame> {
        self.more.as_mut()?.detail.take()?;
        Some(ServerFrame::Detail(showing.node.detail(&self.watching.ports)))
    }

    /// The encoded frame; empty if there are no new events.
    fn events(&mut self, pass: &mut Pass) -> Result<Arc<Vec<u8>>, FrameError> {
        let Some(following) = &mut self.events else { return Ok(Arc::default()) };
        following.next = pass.next(EVENT_PERIOD);
        pass.events(&following.filter, &mut following.observations)
    }

    fn vitals(&mut self, showing: &Showing, pass: &Pass) -> Option<ServerFrame> {
        let more = self.more.as_mut()?;
        let (every, _) = more.vitals.filter(|(_, at)| *at <= pass.now)?;
        more.vitals = Some((every, pass.next(every)));
        more.links = more.hears_links.then_some(pass.now);
        let recording = showing.recording.as_ref().and_then(|watch| watch());
        Some(ServerFrame::Vitals(showing.node.vitals(&mut more.late, recording)))
    }

    fn links(&mut self, showing: &Showing) -> Option<ServerFrame> {
        self.more.as_mut()?.links.take()?;
        let reports = showing.node.link_reports();
        (!reports.links.is_empty()).then_some(ServerFrame::Links(reports))
    }

    fn places(&mut self, showing: &Showing, pass: &mut Pass) -> Option<ServerFrame> {
        let more = self.more.as_mut().filter(|more| more.places.1 <= pass.now)?;
        more.places.1 = pass.next(PLACES_PERIOD);
        let places = pass.places(showing);
        if *places == more.places.0 {
            return None;
        }
        more.places.0 = places.clone();
        Some(ServerFrame::Places(places.clone()))
    }

    /// The frame about held-back scripts. It is repeated while any script is held back, because a monitor that records
    /// may have missed the first frame. It is sent once more when no script is held back any more.
    fn held_back(&mut self, showing: &Showing, now: Instant) -> Option<ServerFrame> {
        let (told, at) = self.more.as_mut()?.held_back.as_mut().filter(|(_, at)| *at <= now)?;
        *at = now + HELD_BACK_PERIOD;
        let held: HeldBack = showing.node.held_back();
        let any = !held.tasks.is_empty();
        let tell = std::mem::replace(told, any) || any;
        tell.then_some(ServerFrame::HeldBack(held))
    }
}

impl More {
    fn push_change(
        &mut self,
        snapshot: Arc<Snapshot>,
        pass: &mut Pass,
        writer: &mut FrameWriter<impl Write>,
    ) -> Result<(), FrameError> {
        if let Some((every, _)) = self.whole.filter(|(_, at)| *at <= pass.now) {
            (self.told, self.whole) = (None, Some((every, pass.next(every))));
        }
        writer.push_bytes(&pass.change(self.told.as_ref(), &snapshot)?)?;
        self.told = Some(snapshot);
        Ok(())
    }
}

fn period(us: u32) -> Duration {
    Duration::from_micros(us.into()).max(LEAST_PERIOD)
}

/// Begins to follow the wanted events, from now on or from the position of the previous subscription.
fn following(
    wanted: Option<EventFilter>,
    before: Option<Following>,
    showing: &Showing,
    now: Instant,
) -> Option<Following> {
    let filter = wanted?;
    let next = before.as_ref().map_or(now, |before| before.next.min(now));
    let observations = before.map_or_else(|| showing.node.observe(), |before| before.observations);
    Some(Following { next, observations, filter })
}

/// The node's clock, for a monitor that compares it with its own.
pub(super) fn mono_us() -> u64 {
    clock::now()
}
