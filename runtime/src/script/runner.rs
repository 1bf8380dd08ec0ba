//! A script and its state, behind the lock of its communication task.

use super::actions::{Begun, OutsideEffect};
use super::{Note, Stands, Watch};
use crate::clock::{self, Micros};
use crate::node::comm::{Comm, Completion};
use crate::node::domain::{FusedSignals, Turn};
use crate::node::effects::{Effects, Stamped};
use crate::node::failstop::guarded;
use crate::record::{Did, OutputDigest, ScriptStep, Step};
use imrs_protocol::script::{
    Action, Address, End, MAX_THREADS, Program, ScriptFault, ScriptHost, ScriptInput, ScriptOutbox,
};
use imrs_protocol::{CommTask, Input, NodeTable, ReplyTo, Request, Signal, Ticks};
use std::sync::Arc;

pub(crate) struct ScriptRunner {
    host: ScriptHost,
    side: Side,
}

/// The data that a step of the script needs besides the communication task.
struct Side {
    place: usize,
    /// For each thread of the script, the number of the action for which it waits.
    acting: [Option<u64>; MAX_THREADS],
    /// How many actions of the script have begun.
    begun: u64,
    draws: fastrand::Rng,
    watch: Option<Arc<dyn Watch>>,
    /// The digest of everything that the script has done, if that is recorded.
    done: OutputDigest,
    ended: bool,
    /// How many steps the scripts of the node may take together before the next input from outside of the node.
    /// Without this limit, two scripts that answer each other for ever would occupy the thread that runs them.
    together: u32,
}

impl ScriptRunner {
    pub fn new(
        place: usize,
        program: Arc<Program>,
        watch: Option<Arc<dyn Watch>>,
        seed: u64,
        together: u32,
    ) -> Self {
        // The salt is made from the name, so that two tasks never draw the same choices.
        let salt = super::simulated::salt(&program.name);
        let side = Side {
            place,
            acting: [None; MAX_THREADS],
            begun: 0,
            draws: fastrand::Rng::with_seed(seed ^ salt),
            watch,
            done: OutputDigest::START,
            ended: false,
            together,
        };
        Self { host: ScriptHost::new(program), side }
    }

    pub const fn program(&self) -> &Arc<Program> {
        &self.host.program
    }

    /// Starts the script.
    pub fn begin(&mut self, comm: &mut Turn<'_>, effects: &mut Effects) {
        let at = self.let_time_pass(comm, effects);
        comm.record(ScriptStep::Begin { at }, self.side.done);
        self.tell(comm, ScriptInput::Begin, effects);
    }

    /// Lets the communication task take an input, and the script react.
    pub fn take(&mut self, comm: &mut Turn<'_>, stamped: Stamped, effects: &mut Effects) {
        self.take_signal(comm, effects);
        let mut input = stamped.input;
        let only_time = matches!(input, Input::Time);
        let turn = time(comm, effects);
        // Time and input are one step if no deadline passes before the input, and no watch wants to see the state
        // between the two.
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
            // The packet's remaining time is reduced by the time for which it waited for this step.
            packet.remaining = packet.remaining - Ticks((comm.now() + elapsed.0).saturating_sub(stamped.at));
        }
        self.step(comm, Step { elapsed, input }, effects);
        self.go_on(comm, effects);
    }

    /// Whether the script waits for the end of this action.
    pub fn is_acting(&self, level: u8, number: u64) -> bool {
        self.side.acting.get(usize::from(level)) == Some(&Some(number))
    }

    /// Ends the action of this number, unless it was cut short before.
    pub fn acted(
        &mut self,
        comm: &mut Turn<'_>,
        end: (u8, u64),
        ok: bool,
        value: i32,
        effects: &mut Effects,
    ) {
        let (level, number) = end;
        self.take_signal(comm, effects);
        // Time passes first, because a deadline that has passed may cut the action short.
        self.let_time_pass(comm, effects);
        let Some(acting) = self.side.acting.get_mut(usize::from(level)) else { return };
        if *acting != Some(number) || self.host.is_stopped() {
            return;
        }
        *acting = None;
        comm.record(ScriptStep::Acted { level, ok, value }, self.side.done);
        self.tell(comm, ScriptInput::Acted { level, ok, value }, effects);
    }

    /// Lets time pass without any input. Everything that is due by now, such as the end of a lease, then comes before
    /// the next input.
    pub fn catch_up(&mut self, comm: &mut Turn<'_>, effects: &mut Effects) {
        if !self.host.is_stopped() {
            self.take_signal(comm, effects);
            self.let_time_pass(comm, effects);
        }
    }

    /// Stops the script, because its node stops: it does nothing more, and cancels its requests.
    pub fn stop(&mut self, comm: &mut Turn<'_>, effects: &mut Effects) {
        if self.host.is_stopped() {
            return;
        }
        self.take_signal(comm, effects);
        self.host.stop();
        for level in 0..MAX_THREADS {
            self.side.cut_short(u8::try_from(level).unwrap_or(u8::MAX), effects);
        }
        comm.record(ScriptStep::Stopped, self.side.done);
        let elapsed = comm.elapsed(clock::next());
        self.step(comm, Step { elapsed, input: Input::Request(Request::Cancel) }, effects);
    }

    /// Lets time pass up to the next whole microsecond, as a step of its own. So no request of the next step has a
    /// time before its turn began.
    fn let_time_pass(&mut self, comm: &mut Turn<'_>, effects: &mut Effects) -> u64 {
        let elapsed = comm.elapsed(time(comm, effects));
        if !elapsed.is_zero() || comm.owes_time() {
            self.step(comm, Step { elapsed, input: Input::Time }, effects);
            self.go_on(comm, effects);
        }
        comm.now()
    }

    /// Shows the task's state to the watch, as checks see it: the script waits now.
    fn show(&self, comm: &Comm) {
        if let Some(watch) = &self.side.watch {
            let stands = Stands { script: &self.host.script, machine: comm.machine() };
            watch.stands(comm.machine().task(), comm.now(), &stands);
        }
    }

    /// Whether the script has not yet taken a signal of a fused step (one that replaces several small steps).
    pub const fn has_input(&self) -> bool {
        self.host.has_input()
    }

    /// Lets the script take the signal of an earlier fused step. This comes before the task's next input, as in small
    /// steps.
    #[inline]
    fn take_signal(&mut self, comm: &mut Turn<'_>, effects: &mut Effects) {
        if self.has_input() {
            self.go_on(comm, effects);
        }
    }

    /// Notes a signal that a fused step has given to the script. The script takes the signal when it next
    /// continues.
    #[inline]
    pub fn tell_later(&mut self, signal: Signal) {
        self.host.tell(ScriptInput::Signal(signal));
    }

    /// Makes a request of the script in one fused step instead of several small ones, if that is possible and no
    /// watch wants to see each small step. A REPLY is made together with the GET that the script makes next.
    fn fuse(&mut self, comm: &mut Turn<'_>, request: &Request, effects: &mut Effects) -> bool {
        if self.side.watch.is_some() {
            return false;
        }
        if let Request::Reply { .. } = request
            && effects.steps < self.side.together
            && let Some((at, get)) = self.host.get_after_reply()
            && comm.fuse((request, Some(&get)), &mut ToScripts(&mut self.host), effects)
        {
            if comm.is_recorded() {
                self.host.statements_before_get(|statement| self.side.done.passed(statement));
            }
            self.host.made(at);
            effects.steps += 1;
            return true;
        }
        comm.fuse((request, None), &mut ToScripts(&mut self.host), effects)
    }

    fn step(&mut self, comm: &mut Turn<'_>, step: Step, effects: &mut Effects) {
        let host = &mut self.host;
        let answers = &mut |signal| host.tell(ScriptInput::Signal(signal));
        comm.run(step.elapsed, &step.input, answers, effects);
    }

    fn tell(&mut self, comm: &mut Turn<'_>, input: ScriptInput, effects: &mut Effects) {
        self.host.tell(input);
        self.go_on(comm, effects);
    }

    /// Lets the script take its inputs and all answers of its communication task, until it waits.
    pub fn go_on(&mut self, comm: &mut Turn<'_>, effects: &mut Effects) {
        self.host.count_anew();
        guarded("a script", || {
            while let Some(request) = self.next_request(comm, effects) {
                if !self.fuse(comm, &request, effects) {
                    self.step(comm, Step { elapsed: Ticks::ZERO, input: Input::Request(request) }, effects);
                }
            }
        });
        self.show(comm);
    }

    fn next_request(&mut self, comm: &mut Turn<'_>, effects: &mut Effects) -> Option<Request> {
        self.host.next(&mut Out { comm, side: &mut self.side, effects })
    }
}

/// Receives the signals of a fused step (one that replaces several small steps) of two scripts.
struct ToScripts<'a>(&'a mut ScriptHost);

impl FusedSignals for ToScripts<'_> {
    #[inline(always)]
    fn own(&mut self, answer: Completion) {
        self.0.tell(ScriptInput::Signal(answer.signal));
    }

    #[inline(always)]
    fn other(&mut self, _: usize, script: Option<&mut ScriptRunner>, answer: Completion) {
        if let Some(script) = script {
            script.tell_later(answer.signal);
        }
    }
}

impl Side {
    fn cut_short(&mut self, level: u8, effects: &mut Effects) -> bool {
        let number = self.acting.get_mut(usize::from(level)).and_then(Option::take);
        let place = self.place;
        effects.outside.extend(number.map(|number| OutsideEffect::CutShort { place, level, number }));
        number.is_some()
    }
}

/// The time of a step: that of the thread's current turn for scripts. For a task of a couple the clock is read anew,
/// because the thread may have been stopped since its turn began (D153).
fn time(comm: &Comm, effects: &mut Effects) -> Micros {
    if comm.is_coupled() { clock::next_by_kernel() } else { effects.time_of_turn() }
}

/// The outbox of a script's steps.
struct Out<'a> {
    comm: &'a mut Comm,
    side: &'a mut Side,
    effects: &'a mut Effects,
}

impl Out<'_> {
    fn note(&self, note: impl FnOnce() -> Note) {
        if let Some(watch) = &self.side.watch {
            watch.note(self.comm.machine().task(), self.comm.now(), &note());
        }
    }

    fn did(&mut self, did: &Did<'_>) {
        if self.comm.is_recorded() {
            self.side.done.add(did);
        }
    }
}

impl ScriptOutbox for Out<'_> {
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
        let lease = self.comm.lease();
        let begun = Begun { place, level, number, action, arguments, least, most, lease };
        self.effects.outside.push_back(OutsideEffect::Begin(begun));
    }

    fn cut_short(&mut self, level: u8) {
        self.did(&Did::CutShort(level));
        if self.side.cut_short(level, self.effects) {
            self.note(|| Note::CutShort(level));
        }
    }

    fn choose(&mut self, alternatives: u16) -> Option<u16> {
        let choice = self.side.draws.u16(..alternatives.max(1));
        self.comm.record(ScriptStep::Chosen(choice), self.side.done);
        Some(choice)
    }

    fn ended(&mut self, end: End) {
        // Only this script has run away, so the other scripts of the node may take as many steps again.
        if matches!(end, End::Fault { fault: ScriptFault::Runaway, .. }) {
            self.effects.steps = 0;
        }
        self.did(&Did::Ended(end));
        self.note(|| Note::Ended(end));
        if !std::mem::replace(&mut self.side.ended, true) {
            self.effects.outside.push_back(OutsideEffect::Ended { place: self.side.place, end });
        }
    }

    fn communication(&self) -> Option<(&CommTask, &NodeTable)> {
        Some((self.comm.machine(), self.comm.table()))
    }

    fn takes(&mut self, _: Address, input: &ScriptInput) -> bool {
        match *input {
            ScriptInput::Signal(signal) => self.note(|| Note::Answered(signal)),
            ScriptInput::Acted { level, ok, value } => self.note(|| Note::Acted { level, ok, value }),
            ScriptInput::Begin | ScriptInput::Chosen(_) => {}
        }
        self.effects.steps = self.effects.steps.saturating_add(1);
        self.effects.steps <= self.side.together
    }

    fn asked(&mut self, request: &Request) {
        self.note(|| Note::Asked(*request));
    }

    fn statement(&mut self, at: Address) {
        if self.comm.is_recorded() {
            self.side.done.passed(at);
        }
        self.note(|| Note::Statement(at));
    }

    fn unanswered(&mut self, message: ReplyTo) {
        self.did(&Did::Unanswered(message));
        self.note(|| Note::Unanswered(message));
    }
}
