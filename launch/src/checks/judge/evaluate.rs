//! Evaluates the checks of a run at one instant, from the values that are known at that instant.

use super::{Judge, READING};
use crate::cells::Loaded;
use crate::checks::vouch::Doubt;
use crate::checks::{Ask, of, terms};
use imrs_language::lower::CheckKind;
use imrs_protocol::script::{Predicate, Term, Type, eval};
use imrs_protocol::{PortId, Round, TaskId};

/// A check with at most this many unknown truth values is evaluated nevertheless, once for each combination of true and
/// false.
const MOST_OPEN: usize = 6;

impl Judge<'_> {
    /// Evaluates all checks at this instant, and notes those that are broken.
    pub(super) fn look(&mut self, now: u64) {
        let loaded = self.loaded;
        for (at, check) in loaded.checks.iter().enumerate() {
            if self.states[at].elsewhere.is_some() {
                continue;
            }
            match &check.kind {
                CheckKind::Always(terms) => {
                    let holds = self.is(terms);
                    let doubt = if holds.is_none() { self.doubts(terms).min() } else { None };
                    let starts = holds == Some(false) && self.states[at].since.is_none();
                    let values = starts.then(|| self.values(at));
                    let state = &mut self.states[at];
                    state.judged |= holds.is_some();
                    state.doubt = doubt.filter(|_| state.judged);
                    if let Some(values) = values {
                        state.since = Some((now, values));
                    } else if holds != Some(false) {
                        (state.since, state.is_told) = (None, false);
                    }
                }
                CheckKind::Leads { when, then, within } => {
                    let doubts = || self.doubts(when).chain(self.doubts(then)).filter(|doubt| doubt.lasts());
                    let (when, then) = (self.is(when), self.is(then));
                    let lasting = if when.and(then).is_none() { doubts().min() } else { None };
                    // A node may notice a deadline one tick late (D42).
                    let late = now.saturating_add(within.0 + loaded.table.cell().tick.0 + READING);
                    let state = &mut self.states[at];
                    state.judged |= when.is_some() && then.is_some();
                    state.mattered += u64::from(when == Some(true) && !state.matters);
                    state.matters = when == Some(true);
                    let is_open = match (when, then) {
                        (_, Some(true)) | (Some(_), Some(false)) => false,
                        (Some(false), None) => state.due.is_some(),
                        (None, _) | (Some(true), None) => true,
                    };
                    state.doubt = lasting.filter(|_| is_open && state.judged);
                    match (when, then) {
                        (_, None) => state.due = None,
                        (_, Some(true)) => (state.due, state.is_told) = (None, false),
                        (Some(true), Some(false)) if state.due.is_none() && !state.is_told => {
                            state.due = Some((now, late));
                        }
                        (Some(true) | None, Some(false)) => {}
                        (Some(false), Some(false)) => state.is_told = false,
                    }
                }
            }
        }
    }

    /// Whether an expression is true; `None` if that is not known.
    fn is(&self, terms: &[Term]) -> Option<bool> {
        // `open` has each truth value that is not known. Bit `i` of `case` is the value that is assumed for the `i`-th
        // of them.
        let (mut open, mut case, mut found) = (Vec::new(), 0_u64, None);
        loop {
            let mut known = true;
            let value = eval(terms, |term| {
                let value = self.value(term);
                if value.is_none() && !open.contains(&term) && self.is_in_doubt(term) {
                    open.push(term);
                }
                let bit = open.iter().position(|of| *of == term);
                known &= value.is_some() || bit.is_some_and(|bit| bit < MOST_OPEN);
                value.or_else(|| bit.map(|bit| i64::from(case >> bit.min(MOST_OPEN) & 1 == 1)))
            });
            // As in the checker, an expression that cannot be computed counts as false.
            let value = value.is_ok_and(|value| value != 0);
            if !known || found.replace(value).is_some_and(|before| before != value) {
                return None;
            }
            case += 1;
            if case >> open.len() != 0 {
                return found;
            }
        }
    }

    /// Whether a term is a truth value that is not known. The check may still have the same result for true and false.
    fn is_in_doubt(&self, term: Term) -> bool {
        if let Term::Of { task, variable } = term {
            let program = self.loaded.program(task);
            let of = program.and_then(|program| Some(program.variables.get(usize::from(variable))?.of));
            if of != Some(Type::Bool) {
                return false;
            }
        }
        of(&self.loaded.table, term).into_iter().any(|(task, _)| self.doubt_of(task).is_some())
    }

    /// The reasons for which values that an expression reads are not known.
    fn doubts(&self, terms: &[Term]) -> impl Iterator<Item = Doubt> {
        let unknown = terms.iter().filter(|term| self.value(**term).is_none());
        let tasks = unknown.flat_map(|term| of(&self.loaded.table, *term)).map(|(task, _)| task);
        tasks.filter_map(|task| self.doubt_of(task))
    }

    /// Why the values of a task may be unknown.
    fn doubt_of(&self, task: TaskId) -> Option<Doubt> {
        if self.vouched.has_orphan(task) {
            return Some(Doubt::Command(task));
        }
        *self.unknown.get(task.index())?
    }

    fn value(&self, term: Term) -> Option<i64> {
        if let Term::Is(Predicate::Arrived { port, task }) = term {
            return self.has_arrived(port, task).map(i64::from);
        }
        let (task, ask) = of(&self.loaded.table, term).pop()?;
        self.seen(task, ask)
    }

    fn seen(&self, task: TaskId, ask: Ask) -> Option<i64> {
        // A command that no task controls may still move the robot, even if the node has reported an end or is dead.
        if self.vouched.has_orphan(task) {
            return None;
        }
        let at = self.asks[task.index()].iter().position(|one| *one == ask)?;
        *self.stand[task.index()].get(at)?
    }

    /// Whether the task has arrived at the waitfor of this port, and no party has begun a later round there since (D85).
    fn has_arrived(&self, port: PortId, task: TaskId) -> Option<bool> {
        let (mut newest, mut own) = (None, None);
        for party in &self.loaded.table.port(port)?.parties {
            let seen = self.seen(party.task, Ask::Arrived(port))?;
            let Ok(seen) = u32::try_from(seen) else { continue };
            let round = u16::try_from(seen.wrapping_sub(1)).ok().map(Round);
            newest = round.into_iter().chain(newest).reduce(Round::fresher);
            if party.task == task {
                own = Some(round);
            }
        }
        Some(own.is_some_and(|round| round.is_none() || round == newest))
    }

    /// The current values that a check reads, as text.
    pub(super) fn values(&self, check: usize) -> Vec<String> {
        let mut words = Vec::new();
        for term in terms(&self.loaded.checks[check]) {
            let Some(name) = self.loaded.term(*term) else { continue };
            let value =
                self.value(*term).map_or_else(|| "unknown".into(), |value| self.loaded.shown(*term, value));
            let word = format!("{name} = {value}");
            if !words.contains(&word) {
                words.push(word);
            }
        }
        words
    }
}

/// The values of a task on a dead node, as in the checker: initial variables, no activity. It is unknown whether the
/// task still counts as arrived, because the other members may have gone on to a later round.
pub(super) fn dead(loaded: &Loaded, (task, asks): (TaskId, &[Ask])) -> Vec<Option<i64>> {
    let program = loaded.program(task);
    let value = |ask: &Ask| match ask {
        Ask::Variable(at) => Some(program?.variables.get(usize::from(*at))?.initial),
        Ask::Active | Ask::Asked(_) | Ask::Answered(_) => Some(0),
        Ask::Arrived(_) => None,
    };
    asks.iter().map(value).collect()
}
