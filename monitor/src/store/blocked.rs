//! What blocks a cell: the tasks for which others wait, the wait-for cycles and the dead nodes, most severe first. Also
//! says which findings are only consequences of a block.

use super::cuts::cuts;
use super::health::{Finding, Place, codes};
use super::journal::Severity;
use super::meeting::doing;
use super::rounds::history;
use super::waits::{Awaited, awaited, cycles};
use super::{Names, Presence, Store, unseen};
use crate::clock::{Moment, micros};
use crate::name::Name;
use imrs_protocol::{NodeId, PortId, TaskId};
use imrs_wire::obs::Liveness;
use std::time::Duration;

/// A wait that is shorter than this is not reported as a block. Without this bound the banner would flicker with
/// every message.
const SETTLED: Duration = Duration::from_millis(500);
/// If a rendezvous has fewer complete rounds than this, it has no usual time.
const A_RULE: usize = 5;
/// The codes of findings that follow from a block, if they concern a task that waits.
const CONSEQUENCES: &[&str] =
    &["rendezvous-lost-member", "rendezvous-stuck", "within-margin", "time-outs", "deadline-risk", "expired"];

/// The kind of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Other tasks wait for the tasks of this block.
    Awaited,
    /// The tasks of this block wait for each other.
    Cycle,
    /// A node or a task has ended, and no task waits for it at present.
    Lost,
    /// What a node sends does not arrive at another one.
    Cut,
}

/// A block: the tasks that cause it, and the tasks that it holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Blocker {
    /// The kind of the block.
    pub kind: Kind,
    /// The code of the page that explains the cause of the block.
    pub code: &'static str,
    /// The severity of the block. [`Severity::Note`] means that the wait is not longer than usual.
    pub level: Severity,
    /// The tasks that cause the block. There are several if the same tasks wait for each of them.
    pub tasks: Vec<TaskId>,
    /// The place of the first of the tasks that cause the block.
    pub place: Place,
    /// The names of the tasks that cause the block and do the same: `belt@nd`; for a dead node its name: `nd`.
    pub name: String,
    /// What these tasks do: `DEAD 9s`, `receive halt`.
    pub state: String,
    /// How many of the tasks that cause the block do something else, and so have no part in `name` and `state`.
    pub others: usize,
    /// The tasks that wait for the cause, directly or indirectly, ascending.
    pub by: Vec<TaskId>,
    /// The kind of the longest wait: `waitfor lift`.
    pub why: String,
    /// The length of the longest wait, in microseconds.
    pub waited_us: Option<u64>,
    /// The 99th percentile of the time that a wait of this kind takes, in microseconds.
    pub usual_us: Option<u64>,
}

impl Blocker {
    /// Whether the block is worse than a usual wait.
    #[must_use]
    pub fn is_alarming(&self) -> bool {
        self.level >= Severity::Warn
    }

    /// Whether the cause of the block is within this place.
    #[must_use]
    pub fn is_within(&self, place: &Place) -> bool {
        place.holds(&self.place)
    }

    /// The tasks that are no cause of the block, but wait because of it.
    #[must_use]
    pub fn held(&self) -> &[TaskId] {
        if matches!(self.kind, Kind::Awaited | Kind::Cut) { &self.by } else { &[] }
    }

    /// Whether the block holds the task of this place.
    #[must_use]
    pub fn holds(&self, place: &Place) -> bool {
        place.task.is_some_and(|task| self.held().contains(&task))
    }

    /// Whether a finding is only a consequence of this block.
    #[must_use]
    pub fn explains(&self, finding: &Finding) -> bool {
        let follows =
            CONSEQUENCES.contains(&finding.code) || (self.kind == Kind::Cut && finding.code == "wait-cycle");
        self.is_alarming() && self.holds(&finding.place) && follows
    }
}

/// The blocks of a cell that have lasted half a second or longer, most severe first.
#[must_use]
pub fn blockers(store: &Store, cell: &Name, now: Moment) -> Vec<Blocker> {
    let Some(names) = store.names(cell) else { return Vec::new() };
    let look = Look { store, cell, names, now };
    let mut found: Vec<Blocker> =
        cycles(store, cell, now).into_iter().filter_map(|cycle| look.cycle(&cycle.tasks)).collect();
    let mut all = awaited(store, cell, now);
    // The same tasks may wait for several tasks. A task among the latter that has ended is the cause.
    all.sort_by_key(|one| (std::cmp::Reverse(look.is_gone(one.task)), std::cmp::Reverse(one.by.len())));
    while !all.is_empty() {
        let first = all.remove(0);
        let gone = look.is_gone(first.task);
        let (same, rest): (Vec<_>, Vec<_>) = all.into_iter().partition(|one| one.by == first.by);
        let tasks = same.iter().map(|one| one.task).filter(|task| look.is_gone(*task) == gone);
        let tasks = std::iter::once(first.task).chain(tasks).collect();
        found.extend(look.awaited(&first, tasks));
        all = rest;
    }
    let lost = look.lost(&found);
    found.extend(lost);
    let cuts = look.cuts();
    // Tasks that wait for each other over a cut link form no cycle, because each has sent the message for which the
    // other one waits.
    found.retain(|one| {
        one.kind != Kind::Cycle || !cuts.iter().any(|cut| one.by.iter().all(|task| cut.by.contains(task)))
    });
    found.extend(cuts);
    found.sort_by_key(|one| std::cmp::Reverse((one.level, one.kind == Kind::Cut, one.by.len())));
    found
}

struct Look<'a> {
    store: &'a Store,
    cell: &'a Name,
    names: &'a Names,
    now: Moment,
}

impl Look<'_> {
    fn place(&self, node: NodeId, task: Option<TaskId>) -> Place {
        let incarnation = self.store.latest(self.cell, node);
        Place {
            node: incarnation.map(|l| l.id).ok_or(node),
            task: task.filter(|_| incarnation.is_some()),
            port: None,
        }
    }

    fn presence(&self, task: TaskId) -> Option<Presence> {
        let node = self.names.home(task)?;
        Some(self.store.latest(self.cell, node)?.presence(self.now))
    }

    /// Whether a task or its node has ended.
    fn is_gone(&self, task: TaskId) -> bool {
        let Some(node) = self.names.home(task) else { return false };
        let Some(incarnation) = self.store.latest(self.cell, node) else { return self.is_killed(node) };
        incarnation.presence(self.now).is_gone()
            || incarnation.task(task).is_some_and(|task| task.liveness != Liveness::Alive)
    }

    /// Whether a node that the monitor has never seen left its socket behind.
    fn is_killed(&self, node: NodeId) -> bool {
        super::is_killed(self.store, self.cell, &self.names.node(node))
    }

    fn title(&self, task: TaskId) -> String {
        let node =
            self.names.home(task).map_or_else(String::new, |node| format!("@{}", self.names.node(node)));
        format!("{}{node}", self.names.task(task))
    }

    fn state(&self, task: TaskId) -> String {
        let node = self.names.home(task);
        let incarnation = node.and_then(|node| self.store.latest(self.cell, node));
        match (self.presence(task), incarnation) {
            (Some(Presence::Up), Some(incarnation)) => doing(incarnation, task, self.now),
            (Some(presence), _) => presence.brief(),
            _ if node.is_some_and(|node| self.is_killed(node)) => "DEAD".to_owned(),
            _ => "never seen".to_owned(),
        }
    }

    /// Whether what the banner says of one task holds for another one, too, also a moment later: on different nodes, times
    /// end and change at different moments.
    fn is_alike(&self, one: TaskId, other: TaskId) -> bool {
        let is_timed = |task: TaskId| {
            let incarnation = self.names.home(task).and_then(|node| self.store.latest(self.cell, node));
            incarnation.is_some_and(|incarnation| {
                incarnation.presence(self.now) != Presence::Up
                    || incarnation.task_held_back(task, self.now).is_some()
            })
        };
        let is_same_node = self.names.home(one) == self.names.home(other);
        self.state(one) == self.state(other) && (is_same_node || !is_timed(one))
    }

    fn awaited(&self, awaited: &Awaited, tasks: Vec<TaskId>) -> Option<Blocker> {
        let wait = &awaited.wait;
        let usual_us = self.usual(wait.port);
        let gone = self.is_gone(awaited.task);
        let has_settled = match self.presence(awaited.task) {
            Some(Presence::Dead(since) | Presence::Stopped(since)) => since >= SETTLED,
            _ if gone => true,
            _ => wait.waited_us.is_some_and(|us| us >= micros(SETTLED)),
        };
        let is_long = match (wait.waited_us, usual_us, wait.time_out_us) {
            (Some(waited), Some(usual), _) => waited > usual,
            (Some(waited), None, Some(whole)) => waited > whole / 4 * 3,
            _ => false,
        };
        let is_silent = matches!(self.presence(awaited.task), Some(Presence::Silent(_)));
        let level = match (gone, is_long || is_silent) {
            (true, _) => Severity::Bad,
            (false, true) => Severity::Warn,
            (false, false) => Severity::Note,
        };
        let alike: Vec<_> = tasks.iter().copied().filter(|task| self.is_alike(awaited.task, *task)).collect();
        let few: Vec<String> = alike.iter().take(2).map(|task| self.title(*task)).collect();
        let more = if alike.len() > 2 { format!(" +{}", alike.len() - 2) } else { String::new() };
        has_settled.then(|| Blocker {
            kind: Kind::Awaited,
            code: self.code_of_wait(awaited),
            level,
            place: self.task_place(awaited.task),
            name: few.join(", ") + &more,
            state: self.state(awaited.task),
            others: tasks.len() - alike.len(),
            tasks,
            by: awaited.by.clone(),
            why: wait.why.clone(),
            waited_us: wait.waited_us,
            usual_us,
        })
    }

    /// The page about a wait: about the end of the awaited task or its node, otherwise about this kind of wait.
    fn code_of_wait(&self, awaited: &Awaited) -> &'static str {
        let node = self.names.home(awaited.task);
        let incarnation = node.and_then(|node| self.store.latest(self.cell, node));
        let Some(incarnation) = incarnation else {
            let is_killed = node.is_some_and(|node| self.is_killed(node));
            return if is_killed { codes::NODE_DEAD.code } else { codes::NODE_MISSING.code };
        };
        let is_rendezvous = self.names.port(awaited.wait.port).is_some_and(|port| port.is_waitfor());
        let liveness = incarnation.task(awaited.task).map(|task| task.liveness);
        match (incarnation.presence(self.now), liveness) {
            (Presence::Dead(_), _) => codes::NODE_DEAD.code,
            (Presence::Silent(_), _) => codes::NODE_SILENT.code,
            (_, Some(Liveness::Crashed)) => codes::TASK_CRASHED.code,
            (Presence::Stopped(_), _) | (_, Some(Liveness::Ended)) if is_rendezvous => {
                codes::LOST_MEMBER.code
            }
            _ if is_rendezvous => codes::RENDEZVOUS_STUCK.code,
            _ => codes::TIME_OUTS.code,
        }
    }

    /// The cut links, one for both directions.
    fn cuts(&self) -> Vec<Blocker> {
        let mut found: Vec<Blocker> = Vec::new();
        for cut in cuts(self.store, self.cell, self.now) {
            let ends = [cut.from.node_id, cut.to.node_id];
            let all = (0..self.names.tasks.len()).map(TaskId::from_index);
            let by: Vec<_> =
                all.filter(|task| self.names.home(*task).is_some_and(|home| ends.contains(&home))).collect();
            if found.iter().any(|other| other.by == by) {
                continue;
            }
            found.push(Blocker {
                kind: Kind::Cut,
                code: codes::LINK_CUT.code,
                level: Severity::Bad,
                tasks: Vec::new(),
                place: self.place(cut.to.node_id, None),
                name: format!("{}-{}", cut.from.node, cut.to.node),
                state: format!("nothing passes for {}s", cut.silent.as_secs()),
                others: 0,
                by,
                why: "link".to_owned(),
                waited_us: Some(micros(cut.silent)),
                usual_us: None,
            });
        }
        found
    }

    fn task_place(&self, task: TaskId) -> Place {
        self.place(self.names.home(task).unwrap_or_default(), Some(task))
    }

    /// The 99th percentile of the time that a rendezvous takes to gather all members.
    fn usual(&self, port: PortId) -> Option<u64> {
        let members = self.names.port(port)?.parties.len();
        let told = history(self.store, self.cell, port)?.summary(members);
        told.gather_p99_us.filter(|_| told.done >= A_RULE)
    }

    fn cycle(&self, tasks: &[TaskId]) -> Option<Blocker> {
        let first = *tasks.first()?;
        let few: Vec<String> = tasks.iter().take(3).map(|task| self.title(*task)).collect();
        Some(Blocker {
            kind: Kind::Cycle,
            code: codes::WAIT_CYCLE.code,
            level: Severity::Bad,
            tasks: tasks.to_vec(),
            place: self.task_place(first),
            name: few.join(", "),
            state: "only a time_out ends it".to_owned(),
            others: 0,
            by: tasks.to_vec(),
            why: "wait-for cycle".to_owned(),
            waited_us: None,
            usual_us: None,
        })
    }

    /// The dead nodes and crashed tasks that are not among the blocks in `found`.
    fn lost(&self, found: &[Blocker]) -> Vec<Blocker> {
        let mut lost = Vec::new();
        let is_named = |place: &Place| {
            found.iter().any(|one| one.tasks.iter().any(|task| place.holds(&self.task_place(*task))))
        };
        for incarnation in self.store.present(self.cell) {
            let node = self.place(incarnation.node_id, None);
            match incarnation.presence(self.now) {
                Presence::Dead(since) if since >= SETTLED && !is_named(&node) => {
                    lost.push(self.loss(node, incarnation.node.to_string(), Presence::Dead(since).brief()));
                }
                Presence::Dead(_) | Presence::Stopped(_) => {}
                Presence::Up | Presence::Silent(_) => {
                    let crashed =
                        incarnation.tasks().iter().filter(|task| task.liveness == Liveness::Crashed);
                    for task in crashed.map(|task| task.view.task) {
                        let place = self.task_place(task);
                        if !is_named(&place) {
                            lost.push(self.loss(place, self.title(task), "CRASHED".to_owned()));
                        }
                    }
                }
            }
        }
        for one in unseen(self.store, self.cell).into_iter().filter(|one| one.is_killed) {
            let place = self.place(one.node, None);
            if !is_named(&place) {
                lost.push(self.loss(place, one.name.to_string(), "DEAD".to_owned()));
            }
        }
        lost
    }

    fn loss(&self, place: Place, name: String, state: String) -> Blocker {
        let node = place.node.map_or_else(Some, |id| self.store.incarnation(id).map(|l| l.node_id));
        let all = (0..self.names.tasks.len()).map(TaskId::from_index);
        let here = all.filter(|task| place.task.map_or(self.names.home(*task) == node, |one| one == *task));
        Blocker {
            kind: Kind::Lost,
            code: if place.task.is_some() { codes::TASK_CRASHED.code } else { codes::NODE_DEAD.code },
            level: Severity::Bad,
            tasks: here.collect(),
            place,
            name,
            state,
            others: 0,
            by: Vec::new(),
            why: String::new(),
            waited_us: None,
            usual_us: None,
        }
    }
}
