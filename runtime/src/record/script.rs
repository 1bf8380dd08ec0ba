//! Runs the scripts of a recording again, together with their communication tasks, and compares what the scripts do.

use super::OutputDigest;
use crate::script::{Note, Stands, Watch};
use imrs_protocol::script::{Action, Address, End, Program, ScriptHost, ScriptInput, ScriptOutbox};
use imrs_protocol::{CommTask, Input, NodeTable, ReplyTo, Request, Signal, TaskId, Ticks};
use imrs_wire::recording::{Happened, ScriptStep, Turn};
use serde::Serialize;
use std::fmt;
use std::sync::Arc;

/// An act of a script, in the form that enters the digest. The statements that a script begins enter the digest, too,
/// but not as acts. A script's request is not an act: it is compared with the recorded input of the communication
/// task. The order of the variants is part of the recordings' format.
#[derive(Serialize)]
pub(crate) enum Did<'a> {
    Acts { level: u8, action: u16, arguments: &'a [i64], least: Ticks, most: Ticks },
    CutShort(u8),
    Unanswered(ReplyTo),
    Ended(End),
}

impl<'a> Did<'a> {
    pub const fn of(action: Action<'a>) -> Self {
        let Action { level, action, arguments, least, most } = action;
        Self::Acts { level, action, arguments, least, most }
    }
}

/// The user's watch, which is called with the acts of a replayed script.
#[derive(Clone)]
pub(super) struct Watched {
    pub task: TaskId,
    pub watch: Arc<dyn Watch>,
}

impl fmt::Debug for Watched {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Watched").field("task", &self.task).finish_non_exhaustive()
    }
}

/// The state of a script that is replayed.
#[derive(Clone, Debug)]
pub(super) struct Again {
    host: ScriptHost,
    done: OutputDigest,
    /// The request that the script has made, and that has not been read from the recording yet.
    asked: Option<Request>,
    pub watched: Option<Watched>,
}

impl Again {
    pub fn new(program: &Arc<Program>) -> Self {
        Self {
            host: ScriptHost::new(Arc::clone(program)),
            done: OutputDigest::START,
            asked: None,
            watched: None,
        }
    }

    /// Shows the state of the task to the watch, unless the task's script is in the middle of a step or its node stops.
    pub fn show(&self, at: u64, machine: &CommTask) {
        if let Some(Watched { task, watch }) = &self.watched
            && self.asked.is_none()
            && !self.host.is_stopped()
        {
            watch.stands(*task, at, &Stands { script: &self.host.script, machine });
        }
    }

    /// Whether the communication task may get this input now: while a request of the script is open, it may get only
    /// that request.
    pub fn expects(&mut self, input: &Input) -> bool {
        match (input, self.asked.take()) {
            (Input::Request(asked), Some(request)) => *asked == request,
            (Input::Request(asked), None) => self.host.is_stopped() && *asked == Request::Cancel,
            (_, None) => {
                self.host.count_anew();
                true
            }
            (_, Some(_)) => false,
        }
    }

    pub fn said(&mut self, signal: Signal) {
        self.host.tell(ScriptInput::Signal(signal));
    }

    /// Gives the script the input of a recorded step. Returns `None` if the script's acts so far differ from the recorded
    /// ones, or if its request to the communication task is still open.
    pub fn take(&mut self, step: ScriptStep, done: OutputDigest) -> Option<Happened> {
        if self.done != done || self.asked.is_some() {
            return None;
        }
        let (input, what) = match step {
            ScriptStep::Begin { .. } => (ScriptInput::Begin, Happened::Begun),
            ScriptStep::Acted { level, ok, value } => {
                (ScriptInput::Acted { level, ok, value }, Happened::Acted(level, ok, value))
            }
            ScriptStep::Chosen(choice) => (ScriptInput::Chosen(choice), Happened::Chosen(choice)),
            ScriptStep::Stopped => {
                self.host.stop();
                return Some(Happened::Stopped);
            }
        };
        if !matches!(step, ScriptStep::Chosen(_)) {
            self.host.count_anew();
        }
        self.host.tell(input);
        Some(what)
    }

    /// Runs the script until it waits or makes a request. In a running node the request would go to the communication
    /// task. In a replay, it must be the communication task's next recorded input.
    pub fn go_on(
        &mut self,
        at: u64,
        communication: (&CommTask, &NodeTable),
        happened: Option<&mut Vec<(u64, Happened)>>,
    ) {
        if self.asked.is_none() {
            let (done, watched) = (&mut self.done, self.watched.as_ref());
            self.asked = self.host.next(&mut Out { at, communication, done, watched, happened });
        }
    }
}

struct Out<'a> {
    at: u64,
    communication: (&'a CommTask, &'a NodeTable),
    done: &'a mut OutputDigest,
    watched: Option<&'a Watched>,
    happened: Option<&'a mut Vec<(u64, Happened)>>,
}

impl Out<'_> {
    fn note(&self, note: &Note) {
        if let Some(Watched { task, watch }) = self.watched {
            watch.note(*task, self.at, note);
        }
    }

    /// The record of what the script does with its current input; `None` if there is no input.
    fn turn(&mut self) -> Option<&mut Turn> {
        match self.happened.as_mut()?.last_mut()? {
            (_, Happened::Turn(turn)) => Some(turn),
            _ => None,
        }
    }
}

impl ScriptOutbox for Out<'_> {
    fn run(&mut self, action: Action<'_>) {
        self.done.add(&Did::of(action));
    }

    fn cut_short(&mut self, level: u8) {
        self.done.add(&Did::CutShort(level));
    }

    /// Makes no choice, because the recording has the choice as its next record.
    fn choose(&mut self, _: u16) -> Option<u16> {
        None
    }

    fn ended(&mut self, end: End) {
        self.done.add(&Did::Ended(end));
        if let Some(turn) = self.turn() {
            turn.end = Some(end);
        }
    }

    fn communication(&self) -> Option<(&CommTask, &NodeTable)> {
        Some(self.communication)
    }

    fn takes(&mut self, at: Address, input: &ScriptInput) -> bool {
        if let ScriptInput::Signal(signal) = input {
            self.note(&Note::Answered(*signal));
        }
        if let Some(happened) = &mut self.happened {
            let turn = Turn { at, input: *input, passed: Vec::new(), end: None };
            happened.push((self.at, Happened::Turn(turn)));
        }
        true
    }

    fn asked(&mut self, request: &Request) {
        self.note(&Note::Asked(*request));
    }

    fn statement(&mut self, at: Address) {
        self.done.passed(at);
        if let Some(turn) = self.turn() {
            turn.passed.push(at);
        }
    }

    fn unanswered(&mut self, message: ReplyTo) {
        self.done.add(&Did::Unanswered(message));
    }
}
