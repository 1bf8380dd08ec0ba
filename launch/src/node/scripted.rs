//! Collects the events of a node's scripts for the launcher, and never waits for the launcher.

use crate::cells::Loaded;
use crate::checks::ValueSampler;
use crate::pipe::{EndSort, Event, Outcomes, What, Word};
use crate::script_event::{Did, ScriptEvent, Unanswered};
use imrs_protocol::script::{Address, End};
use imrs_protocol::{Outcome, PortId, Request, Signal, TaskId, Usage};
use imrs_runtime::script::{Note, Stands, Watch};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::sync::{Arc, Mutex, PoisonError};

/// The greatest number of events that are queued until they can be sent.
const KEPT: usize = 65_536;

/// Watches the scripts, and queues the events that the launcher shows or judges.
pub struct Narrator {
    loaded: Arc<Loaded>,
    told: mpsc::Sender<Word>,
    /// The receiving end of `told`. Only the node's own thread uses it.
    kept: Mutex<Receiver<Word>>,
    /// How many messages are queued.
    waiting: AtomicUsize,
    /// How many messages were dropped.
    lost: AtomicU64,
    /// When the first event after the last [`Self::take`] was dropped, in microseconds; `u64::MAX` if no event was
    /// dropped since.
    lost_since: AtomicU64,
    state: Mutex<State>,
}

struct State {
    outcomes: Outcomes,
    tasks: Vec<Progress>,
    sampler: ValueSampler,
}

/// The progress of one script.
#[derive(Clone, Debug, Default)]
struct Progress {
    statement: Option<Address>,
    /// For each port, the time and the statement of the script's last request on that port, until its outcome. There
    /// may be several, because a handler may run in between.
    asked: BTreeMap<PortId, (u64, Option<Address>)>,
    /// The script's last message: its port, and the statement that sent it.
    sends: Option<(PortId, Option<Address>)>,
    /// The action that runs on each activation of the task.
    acts: Vec<Acts>,
}

/// A running action.
#[derive(Clone, Copy, Debug)]
struct Acts {
    level: u8,
    action: u16,
    statement: Option<Address>,
    /// Whether the action takes no time, because it only reads a value or gives an order. Such actions are too frequent
    /// to report.
    at_once: bool,
}

impl Narrator {
    /// Starts to watch the scripts of this cell.
    pub fn new(loaded: Arc<Loaded>) -> Self {
        let (told, kept) = mpsc::channel();
        let tasks = vec![Progress::default(); loaded.scripts.len()];
        let sampler = ValueSampler::new(&loaded);
        let state = Mutex::new(State { outcomes: Outcomes::default(), tasks, sampler });
        Self {
            loaded,
            told,
            kept: Mutex::new(kept),
            waiting: AtomicUsize::new(0),
            lost: AtomicU64::new(0),
            lost_since: AtomicU64::new(u64::MAX),
            state,
        }
    }

    /// Takes the events since the last call, and the time of the first event that was dropped since then.
    pub fn take(&self) -> (Vec<Word>, Option<u64>) {
        let lost = self.lost_since.swap(u64::MAX, Ordering::AcqRel);
        let words: Vec<Word> = self.kept.lock().unwrap_or_else(PoisonError::into_inner).try_iter().collect();
        self.waiting.fetch_sub(words.len(), Ordering::AcqRel);
        (words, Some(lost).filter(|&lost| lost < u64::MAX))
    }

    /// How many events were dropped so far, because the launcher did not read its pipe fast enough.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    /// The outcomes of the scripts' class-2 messages so far.
    pub fn outcomes(&self) -> Outcomes {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).outcomes
    }

    /// Whether any check of the cell reads values of tasks.
    pub fn is_asked(&self) -> bool {
        !self.state.lock().unwrap_or_else(PoisonError::into_inner).sampler.is_blind()
    }

    /// Queues a message about the instant `at`. Messages about the end of a task are never dropped, because there is only
    /// one of them per task.
    fn tell(&self, at: u64, word: Word) {
        let is_end =
            matches!(&word, Word::TaskEnded { .. } | Word::Did(Did { what: ScriptEvent::Ended(_), .. }));
        if self.waiting.load(Ordering::Acquire) >= KEPT && !is_end {
            self.lost.fetch_add(1, Ordering::Relaxed);
            self.lost_since.fetch_min(at, Ordering::AcqRel);
            return;
        }
        self.waiting.fetch_add(1, Ordering::AcqRel);
        // This struct also holds the receiver, so sending cannot fail.
        let _ = self.told.send(word);
    }

    fn did(&self, task: TaskId, at: u64, statement: Option<Address>, what: ScriptEvent) {
        let line = statement.and_then(|statement| self.loaded.line(task, statement));
        self.tell(at, Word::Did(Did { at, task, line, what }));
    }

    fn missing(&self, port: PortId, missing: u64) -> Vec<TaskId> {
        let Some(port) = self.loaded.table.port(port) else { return Vec::new() };
        let away = port.parties.iter().enumerate().filter(|(i, _)| missing >> i.min(&63) & 1 == 1);
        away.map(|(_, party)| party.task).collect()
    }

    fn answered(&self, task: TaskId, at: u64, progress: &Progress, signal: &Signal, outcomes: &mut Outcomes) {
        let asked = |port| progress.asked.get(&port).copied().unwrap_or((at, progress.statement));
        match *signal {
            Signal::Released { port, round, .. } => {
                self.tell(at, Word::Event(Event { at, task, port, round, what: What::Released }));
                self.did(task, at, asked(port).1, ScriptEvent::Met(port));
            }
            Signal::GaveUp { port, round, missing } => {
                let (since, statement) = asked(port);
                let waited = at.saturating_sub(since);
                let what = What::GaveUp { waited, missing };
                self.tell(at, Word::Event(Event { at, task, port, round, what }));
                let missing = self.missing(port, missing);
                self.did(task, at, statement, ScriptEvent::GaveUp { port, missing });
            }
            Signal::Outcome(outcome) => {
                let (count, how) = match outcome {
                    Outcome::Reply(_) => (&mut outcomes.replies, None),
                    Outcome::Refused => (&mut outcomes.refused, Some(Unanswered::Refused)),
                    Outcome::TimedOutUnsent => (&mut outcomes.timed_out_unsent, Some(Unanswered::NeverLeft)),
                    Outcome::TimedOutUnknown => (&mut outcomes.timed_out_unknown, Some(Unanswered::Unknown)),
                    Outcome::PeerRestarted => (&mut outcomes.peer_restarted, Some(Unanswered::PeerRestarted)),
                };
                *count += 1;
                if let (Some(how), Some((port, statement))) = (how, progress.sends) {
                    self.did(task, at, statement, ScriptEvent::Unanswered { port, how });
                }
            }
            _ => {}
        }
    }

    fn ended(&self, task: TaskId, at: u64, statement: Option<Address>, end: End) {
        let script = self.loaded.script(task);
        let at_line = |address: Option<Address>| {
            let line = address.and_then(|address| self.loaded.line(task, address));
            line.map(|line| format!("line {line}"))
        };
        let (words, sort, place) = match end {
            End::Finished => ("finished".to_owned(), EndSort::Well, statement),
            End::Fenced => ("lost its lease and does nothing more".to_owned(), EndSort::Well, statement),
            End::Aborted(reason) => {
                let reason = script.and_then(|script| script.program.reasons.get(usize::from(reason)));
                let reason = reason.map(String::as_str).unwrap_or_default();
                (format!("aborted: {reason}"), EndSort::Aborted, statement)
            }
            End::Assertion(at) => {
                ("failed: an assertion does not hold".to_owned(), EndSort::Failed, Some(at))
            }
            End::Fault { fault, at } => (format!("failed: {fault}"), EndSort::Failed, Some(at)),
        };
        // The text about an abort may already name the line of the statement.
        let how = match at_line(place).filter(|line| sort != EndSort::Well && !words.ends_with(line)) {
            Some(line) => format!("{words} ({line})"),
            None => words.clone(),
        };
        let line = place.and_then(|place| self.loaded.line(task, place));
        self.tell(at, Word::Did(Did { at, task, line, what: ScriptEvent::Ended(words) }));
        self.tell(at, Word::TaskEnded { task, how, sort });
    }
}

impl Watch for Narrator {
    fn note(&self, task: TaskId, at: u64, note: &Note) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let State { outcomes, tasks, sampler } = &mut *state;
        sampler.note(task, note);
        let Some(progress) = tasks.get_mut(task.index()) else { return };
        match note {
            Note::Statement(statement) => progress.statement = Some(*statement),
            Note::Asked(Request::Arrive { port, .. }) => {
                progress.asked.insert(*port, (at, progress.statement));
                self.did(task, at, progress.statement, ScriptEvent::Waits(*port));
            }
            Note::Asked(Request::Send { port, .. }) => {
                progress.sends = Some((*port, progress.statement));
                // Queries are not reported: heartbeats and polls are queries, and too frequent.
                let usage = self.loaded.table.port(*port).and_then(|port| port.party(task)).map(|p| p.usage);
                if usage == Some(Usage::Send) {
                    self.did(task, at, progress.statement, ScriptEvent::Sends(*port));
                }
            }
            Note::Answered(signal) => self.answered(task, at, progress, signal, outcomes),
            Note::Acts { level, action, arguments, most } => {
                let (statement, at_once) = (progress.statement, most.is_zero());
                progress.acts.retain(|acts| acts.level != *level);
                progress.acts.push(Acts { level: *level, action: *action, statement, at_once });
                if !at_once {
                    let arguments = self.loaded.arguments(task, *action, arguments);
                    let action = self.loaded.action(task, *action).to_owned();
                    self.did(task, at, statement, ScriptEvent::Begins { action, arguments });
                }
            }
            Note::Acted { level, ok, value } => {
                if let Some(acts) = progress.take(*level).filter(|acts| !(acts.at_once && *ok)) {
                    let value = self.loaded.result(task, acts.action, *value);
                    let action = self.loaded.action(task, acts.action).to_owned();
                    let what =
                        if *ok { ScriptEvent::Ends { action, value } } else { ScriptEvent::Fails(action) };
                    self.did(task, at, acts.statement, what);
                }
            }
            Note::CutShort(level) => {
                if let Some(acts) = progress.take(*level) {
                    let name = self.loaded.action(task, acts.action).to_owned();
                    self.did(task, at, acts.statement, ScriptEvent::CutShort(name));
                }
            }
            Note::Ended(end) => self.ended(task, at, progress.statement, *end),
            Note::Asked(_) | Note::Unanswered(_) => {}
        }
    }

    fn stands(&self, task: TaskId, at: u64, stands: &Stands<'_>) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        for change in state.sampler.look(task, at, stands) {
            self.tell(change.at, Word::Stands(change));
        }
    }
}

impl Progress {
    fn take(&mut self, level: u8) -> Option<Acts> {
        let at = self.acts.iter().position(|acts| acts.level == level)?;
        Some(self.acts.remove(at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::{Source, load};

    const CELL: &str = "cell c; tick 1 msec; node n; task a on n begin loop run w takes 5 msec; end; end a;";

    #[test]
    fn what_nobody_takes_is_kept_up_to_a_bound_and_the_rest_is_counted() {
        let source = Source { name: "c.cell".into(), text: CELL.into(), paper: false };
        let narrator = Narrator::new(Arc::new(load(&source).expect("a sound cell")));
        let acts =
            Note::Acts { level: 0, action: 0, arguments: Vec::new(), most: imrs_protocol::Ticks(5_000) };
        let kept = KEPT as u64;
        for at in 0..kept + 10 {
            narrator.note(TaskId(0), at, &acts);
        }
        narrator.note(TaskId(0), kept + 10, &Note::Ended(End::Finished));
        let (words, lost) = narrator.take();
        assert_eq!((words.len(), lost, narrator.lost()), (KEPT + 2, Some(kept), 10));
        assert!(matches!(words.last(), Some(Word::TaskEnded { .. })));
        narrator.note(TaskId(0), kept + 11, &acts);
        let (words, lost) = narrator.take();
        assert_eq!((words.len(), lost, narrator.lost()), (1, None, 10));
    }
}
