//! Runs the scripts of a recording again, beside their communication tasks, and compares what they do.

use super::OutputDigest;
use crate::script::{Does, Knows, Note, Outlet, Stands, Watch};
use imrs_protocol::script::{Action, Address, End, HOST_LIMIT, Program, Script, ScriptFault, ScriptInput};
use imrs_protocol::{CommTask, Input, ReplyTo, Request, Signal, TaskId, Ticks};
use imrs_wire::recording::{Happened, ScriptStep, Turn};
use serde::Serialize;
use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;

/// An act of a script, as it enters the digest; statements that a script begins enter by themselves. What a script asks is
/// compared as the input that it becomes. The order of the variants is part of the recordings' format.
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

/// The watch that is told what a replayed script does.
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

/// A script that is replayed.
#[derive(Clone, Debug)]
pub(super) struct Again {
    program: Arc<Program>,
    script: Script,
    done: OutputDigest,
    /// What the script asked and the recording has not shown yet.
    requests: VecDeque<Request>,
    signals: VecDeque<Signal>,
    /// Steps since input last came from outside.
    steps: u32,
    pub stopped: bool,
    ended: Vec<End>,
    passed: Vec<Address>,
    pub watched: Option<Watched>,
}

impl Again {
    pub fn new(program: &Arc<Program>) -> Self {
        Self {
            script: Script::new(program),
            program: Arc::clone(program),
            done: OutputDigest::START,
            requests: VecDeque::new(),
            signals: VecDeque::new(),
            steps: 0,
            stopped: false,
            ended: Vec::new(),
            passed: Vec::new(),
            watched: None,
        }
    }

    fn note(&self, at: u64, note: &Note) {
        if let Some(Watched { task, watch }) = &self.watched {
            watch.note(*task, at, note);
        }
    }

    /// Shows the state of the task, unless its script is in the midst of a step or its node stops.
    pub fn show(&self, at: u64, machine: &CommTask) {
        if let Some(Watched { task, watch }) = &self.watched
            && self.requests.is_empty()
            && !self.stopped
        {
            watch.stands(*task, at, &Stands { script: &self.script, machine });
        }
    }

    /// Whether this input of the communication task may come now: while a request of the script is open, only that request may.
    pub fn expects(&mut self, at: u64, input: &Input) -> bool {
        match (input, self.requests.pop_front()) {
            (Input::Request(asked), Some(request)) => {
                self.note(at, &Note::Asked(request));
                *asked == request
            }
            (Input::Request(asked), None) => self.stopped && *asked == Request::Cancel,
            (_, None) => {
                self.steps = 0;
                true
            }
            (_, Some(_)) => false,
        }
    }

    pub fn said(&mut self, signal: Signal) {
        if !self.stopped {
            self.signals.push_back(signal);
        }
    }

    /// Replays a recorded step. `None` if the script's acts so far differ, or a request to its communication task is still open.
    pub fn take(&mut self, knows: Knows<'_>, step: ScriptStep, done: OutputDigest) -> Option<Vec<Happened>> {
        if self.done != done || (!self.requests.is_empty() && !matches!(step, ScriptStep::Chosen(_))) {
            return None;
        }
        let (input, what) = match step {
            ScriptStep::Begin { .. } => (ScriptInput::Begin, Happened::Begun),
            ScriptStep::Acted { level, ok, value } => {
                (ScriptInput::Acted { level, ok, value }, Happened::Acted(level, ok, value))
            }
            ScriptStep::Chosen(choice) => (ScriptInput::Chosen(choice), Happened::Chosen(choice)),
            ScriptStep::Stopped => {
                self.stopped = true;
                self.signals.clear();
                return Some(vec![Happened::Stopped]);
            }
        };
        if !matches!(step, ScriptStep::Chosen(_)) {
            self.steps = 0;
        }
        Some(vec![what, self.run(knows, input)])
    }

    /// The script's next step, with an answer of its communication task; `None` without one, or while a request is open.
    pub fn go_on(&mut self, at: u64, knows: Knows<'_>) -> Option<Happened> {
        if !self.requests.is_empty() {
            return None;
        }
        let signal = self.signals.pop_front()?;
        self.note(at, &Note::Answered(signal));
        Some(self.run(knows, ScriptInput::Signal(signal)))
    }

    fn run(&mut self, knows: Knows<'_>, input: ScriptInput) -> Happened {
        let at = self.script.position();
        self.steps += 1;
        let does = Out {
            knows,
            done: &mut self.done,
            requests: &mut self.requests,
            ended: &mut self.ended,
            passed: &mut self.passed,
        };
        let mut out = Outlet { knows, does };
        if self.steps > HOST_LIMIT {
            self.script.stop(&self.program, ScriptFault::Runaway, &mut out);
        } else {
            self.script.step(&self.program, input, &mut out);
        }
        let end = self.ended.last().copied();
        self.ended.clear();
        Happened::Turn(Turn { at, input, passed: std::mem::take(&mut self.passed), end })
    }
}

struct Out<'a> {
    knows: Knows<'a>,
    done: &'a mut OutputDigest,
    requests: &'a mut VecDeque<Request>,
    ended: &'a mut Vec<End>,
    passed: &'a mut Vec<Address>,
}

impl Does for Out<'_> {
    fn request(&mut self, request: Request) {
        self.requests.push_back(request);
    }

    fn run(&mut self, action: Action<'_>) {
        self.done.add(&Did::of(action));
    }

    fn cut_short(&mut self, level: u8) {
        self.done.add(&Did::CutShort(level));
    }

    /// The recording has the choice next.
    fn choose(&mut self, _: u16) -> Option<u16> {
        None
    }

    fn ended(&mut self, end: End) {
        self.done.add(&Did::Ended(end));
        if self.knows.machine.epoch().is_some() {
            self.requests.push_back(Request::End);
        }
        self.ended.push(end);
    }

    fn statement(&mut self, at: Address) {
        self.done.passed(at);
        self.passed.push(at);
    }

    fn unanswered(&mut self, message: ReplyTo) {
        self.done.add(&Did::Unanswered(message));
    }
}
