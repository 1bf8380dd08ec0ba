//! A rendezvous, assembled from the views of its members (§4.3): who has arrived, who is missing, who has confirmed,
//! and who waits for whom.

use super::health::held_back_words;
use super::{Left, Names, NodeIncarnation, Presence, Store, is_killed};
use crate::clock::Moment;
use crate::name::Name;
use imrs_protocol::{MeetingState, MeetingView, PortId, Round, TaskId, TaskState};
use imrs_wire::obs::Liveness;

/// The state of a member in the shown round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// It waits in the shown round.
    Arrived,
    /// It was released from the shown round, while others still wait in it.
    Released,
    /// It has not arrived.
    Missing,
    /// Not known: no attached node knows it.
    Unknown,
}

/// A member of a rendezvous.
#[derive(Clone, Debug)]
pub struct Member {
    /// The task.
    pub task: TaskId,
    /// Its name.
    pub name: Name,
    /// The name of its node.
    pub node: Name,
    /// The presence of its node; `None` if never seen.
    pub presence: Option<Presence>,
    /// Its activity if it has not arrived, or that it or its node is dead.
    pub doing: String,
    /// Its state in the shown round.
    pub standing: Standing,
    /// Its remaining patience, if it waits.
    pub left: Option<Left>,
    /// How long it has waited, in microseconds.
    pub waited_us: Option<u64>,
    /// Whether too little time remains for it to release by itself.
    pub within_margin: bool,
    /// For each member, whether this one knows of its arrival; `None` if unknown or not in this round.
    pub knows: Vec<Option<bool>>,
    /// From how many members this one has a confirmation.
    pub confirmed: usize,
    /// The members that this one waits for.
    pub waits_for: Vec<usize>,
}

/// A rendezvous.
#[derive(Clone, Debug)]
pub struct Meeting {
    /// The port.
    pub port: PortId,
    /// Its name.
    pub name: Name,
    /// The round that its members wait in, or the next one.
    pub round: Round,
    /// The members, owner first.
    pub members: Vec<Member>,
    /// The shortest remaining patience among the waiting members.
    pub left: Option<Left>,
    /// The longest patience of any member, in microseconds: the scale of the bar.
    pub patience_us: u64,
}

impl Meeting {
    /// Whether any member waits.
    #[must_use]
    pub fn is_waiting(&self) -> bool {
        self.members.iter().any(|m| m.standing == Standing::Arrived)
    }

    /// How many members have arrived or were released.
    #[must_use]
    pub fn arrived(&self) -> usize {
        self.members.iter().filter(|m| matches!(m.standing, Standing::Arrived | Standing::Released)).count()
    }

    /// The members that others wait for, although their node or task is known to have ended.
    pub fn lost(&self) -> impl Iterator<Item = &Member> {
        let awaited = |at: usize| self.members.iter().any(|m| m.waits_for.contains(&at));
        let members = self.members.iter().enumerate();
        members.filter(move |(i, m)| m.is_gone() && awaited(*i)).map(|(_, m)| m)
    }
}

impl Member {
    /// Whether it can never arrive: its node is gone, or the task itself.
    #[must_use]
    pub fn is_gone(&self) -> bool {
        self.presence.is_some_and(Presence::is_gone) || matches!(self.doing.as_str(), CRASHED | ENDED)
    }
}

impl Member {
    /// Why it can never arrive, in one word.
    #[must_use]
    pub fn end(&self) -> &'static str {
        match self.presence {
            Some(Presence::Stopped(_)) => "STOPPED",
            Some(Presence::Up | Presence::Silent(_)) if self.doing == CRASHED => "CRASHED",
            Some(Presence::Up | Presence::Silent(_)) => "ENDED",
            Some(Presence::Dead(_)) | None => "DEAD",
        }
    }
}

const CRASHED: &str = "the task CRASHED";
const ENDED: &str = "the task ended";

/// The view of a meeting at one attached member.
struct MemberReport<'a> {
    incarnation: &'a NodeIncarnation,
    age_us: u64,
    view: &'a MeetingView,
}

/// The meetings of a cell, in the order of their ports.
#[must_use]
pub fn meetings(store: &Store, cell: &Name, now: Moment) -> Vec<Meeting> {
    let Some(names) = store.names(cell) else { return Vec::new() };
    names.meetings.iter().filter_map(|port| meeting(store, cell, *port, now)).collect()
}

/// One meeting of a cell.
#[must_use]
pub fn meeting(store: &Store, cell: &Name, port: PortId, now: Moment) -> Option<Meeting> {
    let names = store.names(cell)?;
    let info = names.port(port)?;
    let tasks: Vec<TaskId> = info.parties.iter().map(|p| p.task).collect();
    let incarnations: Vec<Option<&NodeIncarnation>> =
        tasks.iter().map(|t| names.home(*t).and_then(|node| store.latest(cell, node))).collect();
    let told: Vec<Option<MemberReport<'_>>> = (tasks.iter().zip(&incarnations))
        .map(|(task, incarnation)| tell(*incarnation, *task, port))
        .collect();
    let round = round_shown(&told, now);
    let mut members: Vec<Member> = Vec::new();
    for (i, &task) in tasks.iter().enumerate() {
        let presence = incarnations[i].map(|l| l.presence(now));
        let mut member = Member {
            task,
            name: names.task(task),
            node: names.home(task).map_or_else(|| Name::new("?"), |n| names.node(n)),
            presence,
            doing: incarnations[i].map_or_else(
                || of_unseen(store, cell, names, task),
                |incarnation| doing(incarnation, task, now),
            ),
            standing: Standing::Unknown,
            left: None,
            waited_us: None,
            within_margin: false,
            knows: vec![None; tasks.len()],
            confirmed: 0,
            waits_for: Vec::new(),
        };
        if let Some(told) = &told[i] {
            place(&mut member, told, &tasks, round, now);
            let time_out = info.parties[i].time_out.0.saturating_mul(told.incarnation.tick_us);
            member.waited_us = member.left.map(|left| time_out.saturating_sub(left.us));
        }
        members.push(member);
    }
    hear_of_the_silent(&mut members);
    let left = members.iter().filter(|m| m.standing == Standing::Arrived).filter_map(|m| m.left).min();
    let tick_us = incarnations.iter().flatten().map(|l| l.tick_us).next().unwrap_or(1);
    let patience = info.parties.iter().map(|p| p.time_out.0).max().unwrap_or(0);
    let patience_us = patience.saturating_mul(tick_us);
    Some(Meeting { port, name: info.name.clone(), round, members, left, patience_us })
}

fn tell(incarnation: Option<&NodeIncarnation>, task: TaskId, port: PortId) -> Option<MemberReport<'_>> {
    let incarnation = incarnation?;
    let snapshot = incarnation.task(task)?;
    let view = snapshot.view.meetings.iter().find(|m| m.port == port)?;
    Some(MemberReport { incarnation, age_us: snapshot.age_us, view })
}

/// The freshest round in which a member waits; if none waits, the freshest next round of any member.
fn round_shown(told: &[Option<MemberReport<'_>>], now: Moment) -> Round {
    let rounds = |waiting: bool| {
        let all = told.iter().flatten().filter(move |t| {
            !waiting || (t.view.state != MeetingState::Away && !t.incarnation.presence(now).is_gone())
        });
        all.map(|t| t.view.round).reduce(Round::fresher)
    };
    rounds(true).or_else(|| rounds(false)).unwrap_or_default()
}

/// Fills in a member's own view.
fn place(member: &mut Member, told: &MemberReport<'_>, tasks: &[TaskId], round: Round, now: Moment) {
    let view = told.view;
    let waits = view.state != MeetingState::Away && view.round == round;
    let gone = member.is_gone();
    member.standing = match (waits && !gone, view.released == round && view.round != round) {
        (true, _) => Standing::Arrived,
        (false, true) => Standing::Released,
        (false, false) => Standing::Missing,
    };
    if !waits {
        return;
    }
    member.left = view.remaining.map(|r| told.incarnation.left(r, told.age_us, now));
    member.within_margin = view.state == MeetingState::WithinMargin;
    for (j, task) in tasks.iter().enumerate() {
        let Some(known) = view.members.iter().find(|m| m.task == *task) else { continue };
        member.knows[j] = Some(known.arrived);
        member.confirmed += usize::from(known.confirmed && *task != member.task);
        if !known.arrived && *task != member.task && !gone {
            member.waits_for.push(j);
        }
    }
}

/// Takes the state of a member without an attached source from the views of the others.
fn hear_of_the_silent(members: &mut [Member]) {
    for i in 0..members.len() {
        if members[i].standing == Standing::Unknown {
            let heard =
                members.iter().filter(|m| !m.is_gone()).filter_map(|m| m.knows[i]).reduce(|a, b| a || b);
            members[i].standing = match heard {
                Some(true) => Standing::Arrived,
                Some(false) => Standing::Missing,
                None => Standing::Unknown,
            };
        }
    }
}

/// The description of a task whose node never reported.
fn of_unseen(store: &Store, cell: &Name, names: &Names, task: TaskId) -> String {
    let died = names.home(task).is_some_and(|home| is_killed(store, cell, &names.node(home)));
    let text = if died { "its node died, never seen" } else { "never seen" };
    text.to_owned()
}

/// What a task does, or that it or its node has ended.
pub(super) fn doing(incarnation: &NodeIncarnation, task: TaskId, now: Moment) -> String {
    let presence = incarnation.presence(now);
    if presence != Presence::Up {
        return format!("{} {presence}", incarnation.node);
    }
    if let Some((_, us)) = incarnation.held_back(now).find(|(held, _)| *held == task) {
        return held_back_words(us);
    }
    let Some(snapshot) = incarnation.task(task) else { return String::new() };
    match snapshot.liveness {
        Liveness::Crashed => CRASHED.to_owned(),
        Liveness::Ended => ENDED.to_owned(),
        Liveness::Alive => state(incarnation, &snapshot.view.state),
    }
}

/// The activity of a task, in words.
#[must_use]
pub fn state(incarnation: &NodeIncarnation, state: &TaskState) -> String {
    let names = &incarnation.names;
    match state {
        TaskState::Running => "run".to_owned(),
        TaskState::Receiving { port: Some(port), .. } => format!("receive {}", names.port_name(*port)),
        TaskState::Receiving { port: None, .. } => "receive any".to_owned(),
        TaskState::AwaitingReply { port, from, .. } => {
            format!("reply {} <- {}", names.port_name(*port), names.task(*from))
        }
        TaskState::Waiting { port, round, .. } => format!("waitfor {} {round}", names.port_name(*port)),
        TaskState::Delaying => "delay".to_owned(),
    }
}
