//! What a node reports to its launcher: events and counters.

use super::Process;
use super::error::NodeError;
use super::recorder::NodeRecording;
use crate::pipe::{Event, Figures, RefusalFigures, What, Word};
use crate::script_event::{Did, Lease, ScriptEvent};
use imrs_protocol::Event as Observed;
use imrs_runtime::link::udp::{Refusal, UdpLink};
use imrs_wire::envelope::Refused;
use imrs_wire::obs::{Count, TimedEvent};
use std::collections::BTreeMap;

/// How many observations of each state machine are read at once: all that the machine keeps.
const ROOM: usize = usize::MAX;

impl Process {
    /// Reports all events since the last report.
    pub(super) fn tell(&mut self) -> Result<(), NodeError> {
        let until = self.narrator.is_asked().then(|| self.node.told_until());
        // Script events are taken before the observations and sent after them, so that the announcement of a round
        // always precedes a release in it.
        let (narrated, lost) = self.narrator.take();
        let mut observed = Vec::new();
        let missed = self.observations.drain(ROOM, &mut observed);
        self.untold += missed;
        // The counts of missing events are sent first, because the launcher must know them before it judges the events.
        if missed > 0 || lost.is_some() {
            self.count()?;
        }
        for event in observed.iter().filter_map(announcement) {
            self.out.say(Word::Event(event))?;
        }
        for did in observed.iter().filter_map(lease) {
            self.out.say(Word::Did(did))?;
        }
        for word in narrated {
            self.out.say(word)?;
        }
        if let Some(since) = lost {
            self.out.say(Word::Untold { since })?;
        }
        until.map_or(Ok(()), |until| Ok(self.out.say(Word::Told(until))?))
    }

    /// The neighbours whose datagrams this node refuses, because their cells differ.
    fn refusals(&self) -> Vec<RefusalFigures> {
        let Some(link) = self.link.inner().udp() else { return Vec::new() };
        let one = |refusal: Refusal| {
            let (ours, theirs) = match refusal.why {
                Refused::OtherCell => (link.digests().cell, refusal.theirs.cell),
                Refused::OtherStatements
                | Refused::Misdelivered
                | Refused::OtherKeys
                | Refused::OtherMode
                | Refused::OtherVersion => (link.digests().statements, refusal.theirs.statements),
            };
            RefusalFigures {
                neighbour: self.table.cell().nodes[refusal.node.index()].name.clone(),
                reason: refusal.why.name().to_owned(),
                ours: format!("{ours:08x}"),
                theirs: format!("{theirs:08x}"),
            }
        };
        link.refusals().into_iter().map(one).collect()
    }

    /// Reports the node's counters since its start.
    pub(super) fn count(&mut self) -> Result<(), NodeError> {
        let snapshot = self.node.snapshot(0);
        let injected = self.link.injected();
        let unrecorded =
            self.recording.as_ref().map_or_else(|| self.unrecorded.clone(), NodeRecording::missing);
        let ports = snapshot.tasks.iter().flat_map(|task| {
            let of = task.view.task;
            task.view.ports.iter().map(move |port| (of, port.port, port.counters))
        });
        let dropped = named(&snapshot.link_discards);
        let counted =
            self.link.inner().udp().into_iter().flat_map(UdpLink::counts).filter(|&(_, count)| count > 0);
        let figures = Figures {
            ports: ports.collect(),
            outcomes: self.narrator.outcomes(),
            discards: named(&snapshot.discards),
            link_discards: dropped,
            link: counted.map(|(name, count)| (name.to_owned(), count)).collect(),
            forwarded: snapshot.transit.forwarded,
            lost_on_purpose: injected.lost_packets,
            cut_off: injected.cut_packets,
            links: self.node.link_reports().links,
            refusals: self.refusals(),
            untold: self.untold + self.narrator.lost(),
            unrecorded: unrecorded.into_iter().collect(),
        };
        Ok(self.out.say(Word::Figures(Box::new(figures)))?)
    }
}

/// The counters that are not zero, by name.
fn named(counts: &[Count]) -> BTreeMap<String, u64> {
    counts.iter().filter(|c| c.count > 0).map(|c| (c.name.clone(), c.count)).collect()
}

/// Converts an observed announcement of a round; returns `None` for any other event.
fn announcement(event: &TimedEvent) -> Option<Event> {
    let task = event.task?;
    let announced = matches!(event.what.event, Observed::Reached | Observed::Rejoined);
    let round = imrs_protocol::Round(u16::try_from(event.what.number).ok()?);
    announced.then_some(Event {
        at: event.mono_us,
        task,
        port: event.what.port,
        round,
        what: What::Announced,
    })
}

/// Converts an observed change of a lease; returns `None` for any other event.
fn lease(event: &TimedEvent) -> Option<Did> {
    let lease = match event.what.event {
        Observed::Granted => Lease::Granted,
        Observed::TookOver => Lease::TookOver,
        Observed::Fenced => Lease::Fenced,
        _ => return None,
    };
    Some(Did { at: event.mono_us, task: event.task?, line: None, what: ScriptEvent::Lease(lease) })
}
