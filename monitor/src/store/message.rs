//! The life of one message: where it was, what it still had, and what each stage cost it.

use super::timeline::{Mark, timeline_of};
use super::trail::{KEPT, Seen};
use super::{LifeId, Store};
use crate::name::Name;
use imrs_protocol::{Event, PortId, TaskId};

/// Which message: its source's number for it on a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageKey {
    /// Who sent it.
    pub source: TaskId,
    /// On this port.
    pub port: PortId,
    /// Its sequence.
    pub number: u32,
}

/// One thing that happened to a message.
#[derive(Clone, Copy, Debug)]
pub struct Stage {
    /// What, where and when.
    pub mark: Mark,
    /// What was left of its life, in microseconds.
    pub left_us: u64,
    /// The stage that it follows from, among the stages.
    pub after: Option<usize>,
    /// What the protocol charged since then, in microseconds.
    pub charged_us: Option<u64>,
    /// What the clocks saw pass since then.
    pub passed: Option<Passed>,
}

/// A time between two stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Passed {
    /// In microseconds.
    pub us: u64,
    /// Whether the clocks of two nodes took part in it.
    pub estimated: bool,
}

/// What is known of the life of a message, causes first. Empty: nothing any more, or not yet.
#[must_use]
pub fn life_of(store: &Store, cell: &Name, key: MessageKey) -> Vec<Stage> {
    let marks = timeline_of(store, cell, KEPT, |seen| concerns(seen, key)).marks;
    let tick_us = |life: LifeId| store.life(life).map_or(1, |life| life.tick_us);
    let mut stages: Vec<Stage> = Vec::new();
    for mark in marks {
        let left_us = mark.seen.what.remaining.0.saturating_mul(tick_us(mark.life));
        let after = before(&stages, &mark, key);
        let from = after.and_then(|at| stages.get(at));
        let charged_us = from.and_then(|from| from.left_us.checked_sub(left_us));
        let passed = from.and_then(|from| passed(&from.mark, &mark));
        stages.push(Stage { mark, left_us, after, charged_us, passed });
    }
    stages
}

/// The stage that `mark` follows from: what happened to the message at the same place before, or else what brought it
/// there. An answer ends the life of the request that waited for it, so that the way back is charged too.
fn before(stages: &[Stage], mark: &Mark, key: MessageKey) -> Option<usize> {
    let same = |s: &Stage| (s.mark.life, s.mark.task, s.mark.in_transit) == place(mark);
    let event = |wanted: Event| move |s: &Stage| s.mark.seen.what.event == wanted;
    let replied = stages.iter().rposition(event(Event::Replied));
    let sent = stages.iter().rposition(event(Event::Sent));
    match mark.seen.what.event {
        Event::Answered => replied.or(sent),
        _ if mark.task == key.source && !mark.in_transit => stages.iter().rposition(same),
        _ => stages.iter().rposition(same).or(sent),
    }
}

const fn place(mark: &Mark) -> (LifeId, TaskId, bool) {
    (mark.life, mark.task, mark.in_transit)
}

fn passed(from: &Mark, to: &Mark) -> Option<Passed> {
    if from.life == to.life {
        let us = to.seen.mono_us.checked_sub(from.seen.mono_us)?;
        return Some(Passed { us, estimated: false });
    }
    let us = to.at.saturating_sub(from.at).as_micros();
    Some(Passed { us: u64::try_from(us).unwrap_or(u64::MAX), estimated: true })
}

/// The message that an observation is of, if it is of one.
#[must_use]
pub fn key_of(seen: &Seen) -> Option<MessageKey> {
    let what = seen.what;
    let source = match what.event {
        Event::Sent
        | Event::Resent
        | Event::Answered
        | Event::RefusedByPeer
        | Event::TimedOut
        | Event::TimedOutUnsent
        | Event::PeerRestarted => seen.task?,
        Event::Enqueued | Event::Delivered | Event::Replied | Event::Discarded(_) | Event::Rejected => {
            what.peer
        }
        Event::Reached
        | Event::Rejoined
        | Event::PartnerArrived
        | Event::PartnerAborted
        | Event::Confirmed
        | Event::ReleasedComplete
        | Event::ReleasedByConfirm
        | Event::WithinMargin
        | Event::GaveUp
        | Event::Interrupted
        | Event::Resumed
        | Event::Granted
        | Event::TookOver
        | Event::Fenced => return None,
    };
    Some(MessageKey { source, port: what.port, number: what.number })
}

fn concerns(seen: &Seen, key: MessageKey) -> bool {
    key_of(seen) == Some(key)
}
