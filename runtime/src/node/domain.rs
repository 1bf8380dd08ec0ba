//! A domain: the communication tasks that one lock protects, because one thread at a time works for all of them (D186).
//!
//! All futures of a node are one domain: one thread runs them. All scripts of a node are another domain; scripts have
//! no thread, so the thread that brings input to one script works for all scripts. Every task with a thread is a domain
//! of its own.
//!
//! A packet that a member of a domain sends to another member stays inside the domain: it goes to the queue `inside` of
//! the working thread's [`Effects`], without a lock, a wake-up or an inbox. Often the two members take the packet in
//! one fused step (D176).
//!
//! A *turn* is the time from taking the lock to releasing it. The clock is read once in a turn, and a turn takes at most
//! [`TURN`] inputs from `inside`. Then the lock is released, all other effects are carried out, and the same thread begins
//! the next turn. Actions of scripts begin between turns, without the lock. A future is polled without the lock, too; each
//! call of the future is a turn, with a reading of the clock of its own (D187). A script that is answered at once goes on
//! within the turn, as far as the limit of its steps allows. Other threads wait for at most one turn:
//!
//! - an input for any member is left in the domain's inbox while the lock is held. The lock's holder takes this input
//!   before it ends its turn, or right after. A thread that finds the inbox full waits for the lock;
//! - the Timer thread advances a member that expires, and observers look at members, under the lock.

mod fused;
mod gather;

pub(crate) use fused::FusedSignals;

use crate::clock::Micros;
use crate::node::comm::{Comm, Completion};
use crate::node::effects::{Addressed, Effects, Stamped};
use crate::node::failstop::guarded;
use crate::node::home::{Homes, RunBy};
use crate::script::ScriptRunner;
use crate::sync::handoff::{Protected, Rest};
use imrs_protocol::{Class, Input, Kind, NodeTable, Request, Signal};
use imrs_wire::envelope::MAX_PACKETS;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

/// How many inputs that members send each other are taken in one turn, before the lock is released: as many as a
/// datagram has packets (D112).
const TURN: usize = MAX_PACKETS;

/// The communication tasks of a domain.
pub(crate) struct Domain {
    id: usize,
    members: Vec<Comm>,
    table: NodeTable,
    homes: Arc<Homes>,
    /// Whether any member of the domain is recorded.
    records: bool,
    /// The members whose state was changed in this turn, each listed once.
    changed: Vec<usize>,
}

impl Domain {
    pub fn new(id: usize, members: Vec<Comm>, table: NodeTable, homes: Arc<Homes>) -> Self {
        let changed = Vec::with_capacity(members.len());
        let records = members.iter().any(Comm::is_recorded);
        Self { id, members, table, homes, records, changed }
    }

    pub fn member(&mut self, member: usize) -> &mut Comm {
        &mut self.members[member]
    }

    /// Calls `work` with the script of a member, if it has one, and with the member's communication task.
    pub fn with_runner(
        &mut self,
        member: usize,
        effects: &mut Effects,
        work: impl FnOnce(&mut ScriptRunner, &mut Turn<'_>, &mut Effects),
    ) {
        let Some(mut runner) = self.members[member].runner.take() else { return };
        work(&mut runner, &mut self.turn_of(member), effects);
        self.members[member].runner = Some(runner);
    }

    /// Gives an input to a member. Returns the answer for the member's thread.
    fn take(&mut self, member: usize, stamped: &mut Stamped, effects: &mut Effects) -> Option<Completion> {
        match self.members[member].home.run_by {
            RunBy::AnyThread => {
                self.with_runner(member, effects, |runner, turn, effects| {
                    runner.take(turn, *stamped, effects);
                });
                None
            }
            RunBy::TheThreadOfFutures => {
                let mut turn = self.turn_of(member);
                if let Some(answer) = turn.take(stamped, effects) {
                    turn.answer = Some(answer);
                    effects.called.push(turn.home.place());
                }
                None
            }
            RunBy::ItsThread => self.members[member].take(stamped, effects),
        }
    }

    /// Takes the answer that waits for a member's future. If no answer waits, makes the future's requests. Their
    /// answer, and answers that other futures get by it, go to `answers`: the calling thread runs all futures.
    pub fn ask(&mut self, member: usize, asked: Asked<'_>, answers: &mut Answers, effects: &mut Effects) {
        if let Some(answer) = self.members[member].answer.take() {
            return answers.put(member, answer);
        }
        let before = effects.called.len();
        let fused = self.unchanged(member).ask(asked, answers, effects);
        if !effects.inside.is_empty() {
            self.work_inside(effects);
        } else if fused {
            return;
        }
        for &place in &effects.called[before..] {
            let there = self.homes.at(place).member();
            if let Some(answer) = self.members[there].answer.take() {
                answers.put(there, answer);
            }
        }
    }

    /// Makes a request as [`ask`](Self::ask) does, for a member whose program takes no answers any more.
    pub fn tell(
        &mut self,
        member: usize,
        (at, request): (Micros, &Request),
        answers: &mut Answers,
        effects: &mut Effects,
    ) {
        self.members[member].answer = None;
        self.ask(member, Asked { at, request: Some(request), then: None }, answers, effects);
        answers.take(member);
    }

    fn turn_of(&mut self, member: usize) -> Turn<'_> {
        let mut turn = self.unchanged(member);
        turn.change(member);
        turn
    }

    /// As [`turn_of`](Self::turn_of), but the caller must call `change` if the member's next expiry may change.
    fn unchanged(&mut self, member: usize) -> Turn<'_> {
        let Self { members, table, homes, changed, records, .. } = self;
        Turn { members, member, table, homes, records: *records, changed }
    }
}

impl Protected for Domain {
    type Input = Addressed;
    type Completion = Completion;
    type Effects = Effects;

    /// Only a class-1 message may wait, because no answer goes to its sender. The receiving task takes the message at
    /// its next call, and the message's remaining time keeps running meanwhile.
    fn may_wait(input: &Addressed) -> bool {
        let Input::Packet(packet) = &input.stamped.input else { return false };
        packet.kind == Kind::Send && packet.class == Class::Status
    }

    fn feed(&mut self, input: &mut Addressed, effects: &mut Effects) -> Option<Completion> {
        guarded("a communication task", || self.take(input.member, &mut input.stamped, effects))
    }

    fn work_inside(&mut self, effects: &mut Effects) {
        for _ in 0..TURN {
            let Some((home, input)) = effects.inside.take(self.id) else { return };
            guarded("a communication task", || match input {
                Some(mut stamped) => {
                    self.take(home.member(), &mut stamped, effects);
                }
                None => {
                    self.with_runner(home.member(), effects, |runner, turn, effects| {
                        runner.go_on(turn, effects);
                    });
                }
            });
        }
    }

    fn settle(&mut self, rest: Rest, effects: &mut Effects) -> Micros {
        effects.turn = None;
        if self.members[0].home.run_by == RunBy::ItsThread {
            return self.members[0].settle(rest);
        }
        while let Some(member) = self.changed.pop() {
            let member = &mut self.members[member];
            member.changed = false;
            // No thread sleeps until the deadline of a script or a future, so the Timer thread must know it.
            member.settle_shared();
        }
        Micros::MAX
    }
}

/// What a future asks of its communication task. It lets time pass, makes one request, or makes two: a REPLY and a
/// GET (the request for the next message), which follows once the REPLY is accepted (D200).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asked<'a> {
    /// The instant at which the future makes the requests.
    pub at: Micros,
    /// The request; `None` if only time passes.
    pub request: Option<&'a Request>,
    /// The GET that follows a REPLY in `request`.
    pub then: Option<&'a Request>,
}

/// Answers that the thread of the futures itself caused. A future finds its answer here without taking the lock.
#[derive(Debug, Default)]
pub(crate) struct Answers {
    /// The answer for each member of the domain; `None` if there is none.
    of: Vec<Option<Completion>>,
}

impl Answers {
    #[inline]
    fn put(&mut self, member: usize, answer: Completion) {
        if let Some(of) = self.of.get_mut(member) {
            *of = Some(answer);
        } else {
            self.of.resize(member, None);
            self.of.push(Some(answer));
        }
    }

    /// The answer for a member, if there is one.
    pub fn take(&mut self, member: usize) -> Option<Completion> {
        let of = self.of.get_mut(member)?;
        // The check comes first, because `take` would write to the slot even if it is empty.
        if of.is_some() { of.take() } else { None }
    }
}

/// One communication task of the domain, for the thread that holds the lock. It can also reach the other members.
pub(crate) struct Turn<'a> {
    members: &'a mut [Comm],
    member: usize,
    table: &'a NodeTable,
    homes: &'a Homes,
    /// Whether any member of the domain is recorded.
    records: bool,
    changed: &'a mut Vec<usize>,
}

impl Deref for Turn<'_> {
    type Target = Comm;

    fn deref(&self) -> &Comm {
        &self.members[self.member]
    }
}

impl DerefMut for Turn<'_> {
    fn deref_mut(&mut self) -> &mut Comm {
        &mut self.members[self.member]
    }
}

impl Turn<'_> {
    fn change(&mut self, member: usize) {
        if !std::mem::replace(&mut self.members[member].changed, true) {
            self.changed.push(member);
        }
    }

    /// Makes the requests of the member's future, or lets time pass. Returns true if one fused step did everything,
    /// so that all answers are in `answers`.
    fn ask(
        &mut self,
        Asked { at, request, then }: Asked<'_>,
        answers: &mut Answers,
        effects: &mut Effects,
    ) -> bool {
        let own = self.home.member();
        if let Some(
            request @ (Request::Send { .. }
            | Request::Reply { .. }
            | Request::Arrive { .. }
            | Request::Get { .. }),
        ) = request
            && self.is_usual()
            && self.catch_up_with(at)
            && self.fuse((request, then), &mut ToFutures { own, answers }, effects)
        {
            // Two kinds of request set no new deadline for the task: a REPLY, and a GET without a time_out.
            let last = then.unwrap_or(request);
            if !matches!(last, Request::Reply { .. } | Request::Get { time_out: None, .. }) {
                self.change(own);
            }
            return true;
        }
        self.change(own);
        let input = request.map_or(Input::Time, |&request| Input::Request(request));
        let mut answer = self.take(&mut Stamped { at, input }, effects);
        if let (Some(&get), Some(Signal::Accepted(_))) = (then, answer.map(|answer| answer.signal)) {
            answer = self.take(&mut Stamped { at, input: Input::Request(get) }, effects);
        }
        if let Some(answer) = answer {
            answers.put(own, answer);
        }
        false
    }
}

/// Signals the futures of a node, on the futures' own thread.
struct ToFutures<'a> {
    own: usize,
    answers: &'a mut Answers,
}

impl FusedSignals for ToFutures<'_> {
    fn own(&mut self, answer: Completion) {
        self.answers.put(self.own, answer);
    }

    fn other(&mut self, member: usize, _: Option<&mut ScriptRunner>, answer: Completion) {
        self.answers.put(member, answer);
    }
}
