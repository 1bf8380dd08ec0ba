//! A script and what it needs, behind the lock of its communication task.

use super::actions::{Begun, HeldLease, OutsideEffect};
use super::knows::{Does, Outlet};
use super::{Knows, Note, Stands, Watch};
use crate::clock::{self, Micros};
use crate::node::comm::Comm;
use crate::node::effects::{Effects, Stamped};
use crate::node::failstop::guarded;
use crate::record::{Did, Log, OutputDigest, ScriptStep, Step};
use imrs_protocol::script::{
    Action, Address, End, HOST_LIMIT, MAX_THREADS, Program, Script, ScriptFault, ScriptInput,
};
use imrs_protocol::{Input, ReplyTo, Request, Signal, TaskId, Ticks};
use std::collections::VecDeque;
use std::sync::Arc;

/// How many signals or requests of one input fit without an allocation.
const ROOM: usize = 16;

pub(crate) struct ScriptRunner {
    program: Arc<Program>,
    script: Script,
    /// Answers of the communication task that the script has not taken yet. Empty between inputs.
    signals: VecDeque<Signal>,
    /// What the script asked in its last step. Empty between steps.
    requests: VecDeque<Request>,
    side: Side,
    /// How many steps the scripts of the node may take together before input must come from outside: two scripts that answer each
    /// other for ever would keep the thread that runs them from all its other work.
    together: u32,
    stopped: bool,
}

/// What a step of the script needs besides its communication task.
struct Side {
    place: usize,
    /// For each thread, the number of the action that it waits for.
    acting: [Option<u64>; MAX_THREADS],
    /// How many actions have begun.
    begun: u64,
    draws: fastrand::Rng,
    watch: Option<Arc<dyn Watch>>,
    /// The digest of everything that the script has done, if that is recorded.
    done: OutputDigest,
    ended: bool,
}

impl ScriptRunner {
    pub fn new(
        place: usize,
        program: Arc<Program>,
        watch: Option<Arc<dyn Watch>>,
        seed: u64,
        together: u32,
    ) -> Self {
        // By name, so that no two tasks draw the same choices.
        let salt = super::simulated::salt(&program.name);
        let side = Side {
            place,
            acting: [None; MAX_THREADS],
            begun: 0,
            draws: fastrand::Rng::with_seed(seed ^ salt),
            watch,
            done: OutputDigest::START,
            ended: false,
        };
        let (signals, requests) = (VecDeque::with_capacity(ROOM), VecDeque::with_capacity(ROOM));
        Self { script: Script::new(&program), program, signals, requests, side, together, stopped: false }
    }

    pub const fn program(&self) -> &Arc<Program> {
        &self.program
    }

    /// Starts the script.
    pub fn begin(&mut self, comm: &mut Comm, effects: &mut Effects) {
        let at = self.let_time_pass(comm, effects);
        self.side.record(comm, ScriptStep::Begin { at });
        self.go_on(comm, ScriptInput::Begin, effects);
        self.show(comm);
    }

    /// Input comes to the communication task.
    pub fn take(&mut self, comm: &mut Comm, stamped: Stamped, effects: &mut Effects) {
        let mut input = stamped.input;
        let only_time = matches!(input, Input::Time);
        let turn = time(comm, effects);
        // One step for the time and the input, if nothing is due by then and no watch wants to see the state in between.
        let elapsed = if !only_time && self.side.watch.is_none() && comm.is_idle_until(turn) {
            comm.elapsed(turn)
        } else {
            self.let_time_pass(comm, effects);
            Ticks::ZERO
        };
        if only_time {
            return;
        }
        if let Input::Packet(packet) = &mut input {
            // The packet is charged for its wait for this step.
            packet.remaining = packet.remaining - Ticks((comm.now() + elapsed.0).saturating_sub(stamped.at));
        }
        self.step(comm, Step { elapsed, input }, effects);
        self.hear(comm, effects);
        self.show(comm);
    }

    /// Whether the script waits for the end of this action.
    pub fn is_acting(&self, level: u8, number: u64) -> bool {
        self.side.acting.get(usize::from(level)) == Some(&Some(number))
    }

    /// Ends the action of this number, unless it was cut short before.
    pub fn acted(&mut self, comm: &mut Comm, end: (u8, u64), ok: bool, value: i32, effects: &mut Effects) {
        let (level, number) = end;
        // First, because what is due by now may cut the action short.
        self.let_time_pass(comm, effects);
        let Some(acting) = self.side.acting.get_mut(usize::from(level)) else { return };
        if *acting != Some(number) || self.stopped {
            return;
        }
        *acting = None;
        self.side.record(comm, ScriptStep::Acted { level, ok, value });
        self.side.note(comm, || Note::Acted { level, ok, value });
        self.go_on(comm, ScriptInput::Acted { level, ok, value }, effects);
        self.show(comm);
    }

    /// Only time passes: what is due by now, such as the end of a lease, happens before anything else.
    pub fn catch_up(&mut self, comm: &mut Comm, effects: &mut Effects) {
        if !self.stopped {
            self.let_time_pass(comm, effects);
        }
    }

    /// The node stops: the script acts no more, and cancels what it asked.
    pub fn stop(&mut self, comm: &mut Comm, effects: &mut Effects) {
        if std::mem::replace(&mut self.stopped, true) {
            return;
        }
        for level in 0..MAX_THREADS {
            self.side.cut_short(u8::try_from(level).unwrap_or(u8::MAX), effects);
        }
        self.side.record(comm, ScriptStep::Stopped);
        let elapsed = comm.elapsed(clock::next());
        self.step(comm, Step { elapsed, input: Input::Request(Request::Cancel) }, effects);
        self.signals.clear();
    }

    /// The time passes first, as a step of its own, to the next whole microsecond: so what is asked in this step is never stamped
    /// before its turn began.
    fn let_time_pass(&mut self, comm: &mut Comm, effects: &mut Effects) -> u64 {
        let elapsed = comm.elapsed(time(comm, effects));
        if !elapsed.is_zero() {
            self.step(comm, Step { elapsed, input: Input::Time }, effects);
            self.hear(comm, effects);
            self.show(comm);
        }
        comm.now()
    }

    /// The script waits: shows this state of the cell to the watch, as checks see it.
    fn show(&self, comm: &Comm) {
        if let Some(watch) = &self.side.watch {
            let stands = Stands { script: &self.script, machine: comm.machine() };
            watch.stands(comm.machine().task(), comm.now(), &stands);
        }
    }

    fn step(&mut self, comm: &mut Comm, step: Step, effects: &mut Effects) {
        let signals = &mut self.signals;
        comm.run(&step, &mut |signal| signals.push_back(signal), effects);
    }

    /// The script takes all answers of its communication task.
    fn hear(&mut self, comm: &mut Comm, effects: &mut Effects) {
        if let Some(signal) = self.next_signal(comm) {
            self.go_on(comm, ScriptInput::Signal(signal), effects);
        }
    }

    fn next_signal(&mut self, comm: &Comm) -> Option<Signal> {
        let signal = self.signals.pop_front()?;
        self.side.note(comm, || Note::Answered(signal));
        Some(signal)
    }

    /// Runs the script until it waits.
    fn go_on(&mut self, comm: &mut Comm, input: ScriptInput, effects: &mut Effects) {
        guarded("a script", || self.run(comm, input, effects));
    }

    fn run(&mut self, comm: &mut Comm, input: ScriptInput, effects: &mut Effects) {
        let (mut next, mut steps) = (Some(input), 0);
        while let Some(input) = next {
            if self.stopped {
                self.signals.clear();
                return;
            }
            steps += 1;
            effects.steps = effects.steps.saturating_add(1);
            let runs_away = steps > HOST_LIMIT || effects.steps > self.together;
            let (now, lease) = (comm.now(), comm.lease());
            let (knows, log) = comm.recorded();
            let does =
                Out { knows, log, now, lease, requests: &mut self.requests, side: &mut self.side, effects };
            let mut out = Outlet { knows, does };
            if runs_away {
                self.script.stop(&self.program, ScriptFault::Runaway, &mut out);
                effects.steps = 0;
            } else {
                self.script.step(&self.program, input, &mut out);
            }
            while let Some(request) = self.requests.pop_front() {
                self.side.note(comm, || Note::Asked(request));
                self.step(comm, Step { elapsed: Ticks::ZERO, input: Input::Request(request) }, effects);
            }
            next = self.next_signal(comm).map(ScriptInput::Signal);
        }
    }
}

impl Side {
    fn record(&self, comm: &mut Comm, step: ScriptStep) {
        if let (_, Some(log)) = comm.recorded() {
            log.script(step, self.done);
        }
    }

    fn note(&self, comm: &Comm, note: impl FnOnce() -> Note) {
        self.note_at(comm.machine().task(), comm.now(), note);
    }

    fn note_at(&self, task: TaskId, at: u64, note: impl FnOnce() -> Note) {
        if let Some(watch) = &self.watch {
            watch.note(task, at, &note());
        }
    }

    fn cut_short(&mut self, level: u8, effects: &mut Effects) -> bool {
        let number = self.acting.get_mut(usize::from(level)).and_then(Option::take);
        let place = self.place;
        effects.outside.extend(number.map(|number| OutsideEffect::CutShort { place, level, number }));
        number.is_some()
    }
}

/// The time of a step: that of the thread's turn at the script. For a task of a couple the clock is read each time, because the
/// thread may have been stopped since its turn began (D153).
fn time(comm: &Comm, effects: &mut Effects) -> Micros {
    if comm.is_coupled() { clock::next() } else { effects.time_of_turn() }
}

/// The outbox of one step of a script.
struct Out<'a> {
    knows: Knows<'a>,
    log: Option<&'a mut (dyn Log + 'static)>,
    now: u64,
    lease: Option<HeldLease>,
    requests: &'a mut VecDeque<Request>,
    side: &'a mut Side,
    effects: &'a mut Effects,
}

impl Out<'_> {
    fn note(&self, note: impl FnOnce() -> Note) {
        self.side.note_at(self.knows.machine.task(), self.now, note);
    }

    fn did(&mut self, did: &Did<'_>) {
        if self.log.is_some() {
            self.side.done.add(did);
        }
    }
}

impl Does for Out<'_> {
    fn request(&mut self, request: Request) {
        self.requests.push_back(request);
    }

    fn run(&mut self, action: Action<'_>) {
        self.did(&Did::of(action));
        let Action { level, action, arguments, least, most } = action;
        self.side.cut_short(level, self.effects);
        let (place, number) = (self.side.place, self.side.begun);
        self.side.begun += 1;
        if let Some(acting) = self.side.acting.get_mut(usize::from(level)) {
            *acting = Some(number);
        }
        let arguments = arguments.to_vec();
        self.note(|| Note::Acts { level, action, arguments: arguments.clone(), most });
        self.effects.outside.push_back(OutsideEffect::Begin(Begun {
            place,
            level,
            number,
            action,
            arguments,
            least,
            most,
            lease: self.lease,
        }));
    }

    fn cut_short(&mut self, level: u8) {
        self.did(&Did::CutShort(level));
        if self.side.cut_short(level, self.effects) {
            self.note(|| Note::CutShort(level));
        }
    }

    fn choose(&mut self, alternatives: u16) -> Option<u16> {
        let choice = self.side.draws.u16(..alternatives.max(1));
        if let Some(log) = &mut self.log {
            log.script(ScriptStep::Chosen(choice), self.side.done);
        }
        Some(choice)
    }

    fn ended(&mut self, end: End) {
        self.did(&Did::Ended(end));
        // Heartbeats stop when the task has ended (D61).
        if self.knows.machine.epoch().is_some() {
            self.requests.push_back(Request::End);
        }
        self.note(|| Note::Ended(end));
        if !std::mem::replace(&mut self.side.ended, true) {
            self.effects.outside.push_back(OutsideEffect::Ended { place: self.side.place, end });
        }
    }

    fn statement(&mut self, at: Address) {
        if self.log.is_some() {
            self.side.done.passed(at);
        }
        self.note(|| Note::Statement(at));
    }

    fn unanswered(&mut self, message: ReplyTo) {
        self.did(&Did::Unanswered(message));
        self.note(|| Note::Unanswered(message));
    }
}
