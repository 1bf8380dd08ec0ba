//! A rendezvous, assembled from the views of its members (§4.3): who has arrived, who is missing, who has confirmed,
//! and who waits for whom.

use super::health::held_back_words;
use super::{Left, Names, NodeIncarnation, Presence, Store, is_killed};
use crate::clock::Moment;
use crate::name::Name;
use imrs_protocol::{MeetingState, MeetingView, PortId, Round, TaskId, TaskState};
use imrs_wire::obs::Liveness;

/// The state of a member in the round that is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// The member waits in the shown round.
    Arrived,
    /// The member was released from the shown round, while other members still wait in it.
    Released,
    /// The member has not arrived.
    Missing,
    /// The state of the member is not known, because no attached node knows it.
    Unknown,
}

/// A member of a rendezvous.
#[derive(Clone, Debug)]
pub struct Member {
    /// The task that is the member.
    pub task: TaskId,
    /// The name of the task.
    pub name: Name,
    /// The name of the task's node.
    pub node: Name,
    /// The presence of the task's node; `None` if the monitor has never seen the node.
    pub presence: Option<Presence>,
    /// What the task does if it has not arrived, or that the task or its node is dead.
    pub doing: String,
    /// The state of the member in the shown round.
    pub standing: Standing,
    /// The remaining patience of the member, if it waits.
    pub left: Option<Left>,
    /// How long the member has waited, in microseconds.
    pub waited_us: Option<u64>,
    /// Whether the member has too little time left to be released by itself.
    pub within_margin: bool,
    /// For each member, whether this member knows of its arrival; `None` if that is unknown, or this member is not in
    /// the round.
    pub knows: Vec<Option<bool>>,
    /// From how many members this member has a confirmation.
    pub confirmed: usize,
    /// The members for which this member waits, as positions.
    pub waits_for: Vec<usize>,
}

/// A rendezvous.
#[derive(Clone, Debug)]
pub struct Meeting {
    /// The port of the rendezvous.
    pub port: PortId,
    /// The name of the port.
    pub name: Name,
    /// The round in which members wait or, if none waits, the next round.
    pub round: Round,
    /// The members, owner first.
    pub members: Vec<Member>,
    /// The shortest remaining patience of the waiting members.
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

    /// The members for which others wait, although the member's node or task is known to have ended.
    pub fn lost(&self) -> impl Iterator<Item = &Member> {
        let awaited = |at: usize| self.members.iter().any(|m| m.waits_for.contains(&at));
        let members = self.members.iter().enumerate();
        members.filter(move |(i, m)| m.is_gone() && awaited(*i)).map(|(_, m)| m)
    }
}

impl Member {
    /// Whether the member can never arrive, because its node or its task has ended.
    #[must_use]
    pub fn is_gone(&self) -> bool {
        self.presence.is_some_and(Presence::is_gone) || matches!(self.doing.as_str(), CRASHED | ENDED)
    }
}

impl Member {
    /// Why the member can never arrive, in one word.
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

/// The view that one attached member has of the rendezvous.
struct MemberReport<'a> {
    incarnation: &'a NodeIncarnation,
    age_us: u64,
    view: &'a MeetingView,
}

/// The rendezvous of a cell, in the order of their ports.
#[must_use]
pub fn meetings(store: &Store, cell: &Name, now: Moment) -> Vec<Meeting> {
    let Some(names) = store.names(cell) else { return Vec::new() };
    names.meetings.iter().filter_map(|port| meeting(store, cell, *port, now)).collect()
}

/// One rendezvous of a cell.
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

/// The newest round in which a member waits; if no member waits, the newest next round of any member.
fn round_shown(told: &[Option<MemberReport<'_>>], now: Moment) -> Round {
    let rounds = |waiting: bool| {
        let all = told.iter().flatten().filter(move |t| {
            !waiting || (t.view.state != MeetingState::Away && !t.incarnation.presence(now).is_gone())
        });
        all.map(|t| t.view.round).reduce(Round::fresher)
    };
    rounds(true).or_else(|| rounds(false)).unwrap_or_default()
}

/// Fills in a member from its own view.
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

/// Fills in the members whose nodes are not attached, from the views of the other members.
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

/// What a task does, or that the task or its node has ended.
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
