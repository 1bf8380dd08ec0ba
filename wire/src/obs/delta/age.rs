//! Ages the parts of a snapshot: subtracts the time that passed from every remaining time.

use super::{COUNTERS, NodeFacts};
use crate::obs::snapshot::{LinkView, Snapshot, TimerEntry};
use imrs_protocol::{MeetingView, PortCounters, QueueEntry, TaskState, TaskView, Ticks, TransitView};

/// By how much the own time of a state machine advanced between two snapshots, given its age at both.
pub(super) const fn own_time(passed: u64, old_age: u64, new_age: u64) -> u64 {
    passed.wrapping_sub(new_age).wrapping_add(old_age)
}

pub(super) const fn aged(age: u64, passed: u64, own: u64) -> u64 {
    age.wrapping_add(passed).wrapping_sub(own)
}

pub(super) const fn facts(of: &Snapshot) -> NodeFacts {
    NodeFacts { uptime_us: of.uptime_us, insecure: of.insecure, real_time: of.real_time }
}

pub(super) const fn aged_facts(of: &Snapshot, passed: u64) -> NodeFacts {
    NodeFacts { uptime_us: of.uptime_us.wrapping_add(passed), ..facts(of) }
}

pub(super) fn age_parts(view: &mut TaskView, own: u64) {
    if own == 0 {
        return;
    }
    for port in &mut view.ports {
        port.min_slack = port.min_slack.map(|left| left - Ticks(own));
        port.queue.iter_mut().for_each(|entry| *entry = aged_entry(*entry, own));
    }
    view.meetings.iter_mut().for_each(|meeting| age_meeting(meeting, own));
}

pub(super) fn aged_entry(entry: QueueEntry, own: u64) -> QueueEntry {
    QueueEntry { remaining: entry.remaining - Ticks(own), ..entry }
}

pub(super) fn aged_state(state: TaskState, own: u64) -> TaskState {
    let own = Ticks(own);
    match state {
        TaskState::Running | TaskState::Delaying => state,
        TaskState::Receiving { port, remaining } => {
            TaskState::Receiving { port, remaining: remaining.map(|left| left - own) }
        }
        TaskState::AwaitingReply { port, from, remaining } => {
            TaskState::AwaitingReply { port, from, remaining: remaining - own }
        }
        TaskState::Waiting { port, round, remaining } => {
            TaskState::Waiting { port, round, remaining: remaining - own }
        }
    }
}

pub(super) fn age_meeting(meeting: &mut MeetingView, own: u64) {
    let older = |left: Option<Ticks>| left.map(|left| left - Ticks(own));
    meeting.remaining = older(meeting.remaining);
    meeting.members.iter_mut().for_each(|member| member.remaining = older(member.remaining));
}

pub(super) fn age_transit(transit: &mut TransitView, own: u64) {
    transit.min_slack = transit.min_slack.map(|left| left - Ticks(own));
}

pub(super) fn age_timers(timers: &mut [TimerEntry], passed: u64) {
    timers.iter_mut().for_each(|timer| timer.remaining = timer.remaining - Ticks(passed));
}

pub(super) fn aged_link(link: LinkView, passed: u64) -> LinkView {
    LinkView { heard_us: link.heard_us.map(|ago| ago.wrapping_add(passed)), ..link }
}

pub(super) const fn counters(of: &PortCounters) -> [u64; COUNTERS] {
    [
        of.sent,
        of.resent,
        of.enqueued,
        of.delivered,
        of.expired,
        of.refused,
        of.rejected,
        of.evicted,
        of.duplicates,
        of.timed_out,
        of.dropped,
    ]
}

pub(super) const fn counters_of(all: [u64; COUNTERS]) -> PortCounters {
    let [
        sent,
        resent,
        enqueued,
        delivered,
        expired,
        refused,
        rejected,
        evicted,
        duplicates,
        timed_out,
        dropped,
    ] = all;
    PortCounters {
        sent,
        resent,
        enqueued,
        delivered,
        expired,
        refused,
        rejected,
        evicted,
        duplicates,
        timed_out,
        dropped,
    }
}
