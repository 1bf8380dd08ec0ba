//! Visits the fields of a server, for the checker's packed states.

use super::inbox::{Held, Inbox, RetryState};
use super::memory::{CommandStatus, DedupEntry, Memory, Source, Window};
use super::{Known, Server};
use crate::ids::{Incarnation, MessageId, PortId, Seq24, TaskId};
use crate::packet::{Class, Contents};
use crate::queue::Slot;
use crate::state::{Pass, Walk, mark, same_option};
use crate::table::{NodeTable, Port};
use crate::task::fragments::Parts;
use crate::task::own::Own;
use crate::ticks::Instant;
use alloc::vec::Vec;

/// Layout of an inbox's first byte: the number of waiting messages, and flags.
const WAITING: u8 = 0x3f;
const BYPASSED: u8 = 0x40;
const HANDLED: u8 = 0x80;

const STATUSES: [Option<CommandStatus>; 6] = [
    None,
    Some(CommandStatus::Held),
    Some(CommandStatus::Delivered(Instant::START)),
    Some(CommandStatus::Refused),
    Some(CommandStatus::Answered(Contents::EMPTY)),
    Some(CommandStatus::Lapsed),
];

/// Which fields the packed bytes contain, because the port's declaration needs them.
#[derive(Clone, Copy)]
struct Form {
    long: bool,
    long_answers: bool,
    ranks_arrivals: bool,
}

impl Form {
    fn of(table: &NodeTable, port: PortId) -> Self {
        table.port(port).map_or(Self { long: false, long_answers: false, ranks_arrivals: false }, |port| {
            Self {
                long: port.decl.fragments > 1,
                long_answers: port.decl.answer_fragments > 1,
                ranks_arrivals: arrival_matters(table, port),
            }
        })
    }
}

/// Whether the arrival order of one source's waiting messages can matter. It matters only if the deadline of a waiting
/// message can be extended and so become equal to another deadline: then the earlier arrival goes first. The literal
/// penalty extends deadlines (D4), and so do copies of commands. A copy extends a deadline only while the command's dedup
/// entry exists. If waiting is charged, such a command waits alone, because the next command of its source replaces it
/// (D12).
fn arrival_matters(table: &NodeTable, port: &Port) -> bool {
    port.decl.lengthens_ttls() || (port.decl.class == Class::Command && !table.rules().charge_residence)
}

/// Counters of which only the relative order is packed.
struct Counters<'a> {
    arrivals: &'a mut u64,
    rejections: &'a mut u64,
}

/// A waiting message as it is packed, with ranks in place of ever-growing numbers.
struct Waiting {
    slot: Slot,
    held: Held,
    retry: RetryState,
}

/// The waiting messages of an inbox in the order of service.
fn waiting(inboxes: &[Inbox], form: Form, at: usize) -> Vec<Waiting> {
    let queue = &inboxes[at].queue;
    if queue.len() == 0 {
        return Vec::new();
    }
    let ranked = |(slot, held): (Slot, &Held)| {
        let (mut held, mut retry) = (*held, queue.side(slot));
        if form.ranks_arrivals {
            // The rank of the message among the waiting messages of its source, by arrival.
            let before = |other: &Held| other.source == held.source && other.arrival < held.arrival;
            held.arrival = queue.iter().filter(|(_, other)| before(other)).count() as u64;
        }
        if retry.rejections > 0 {
            // The place of the message among the task's waiting messages that were rejected, in the order of their first
            // rejections.
            let queues = inboxes.iter().map(|inbox| &inbox.queue);
            let all = queues.flat_map(|queue| queue.iter().map(|(slot, _)| queue.side(slot)));
            let before =
                |other: &RetryState| other.rejections > 0 && other.rejected_first < retry.rejected_first;
            retry.rejected_first = all.filter(before).count() as u64;
        }
        Waiting { slot, held, retry }
    };
    queue.sorted().into_iter().map(ranked).collect()
}

impl Server {
    pub(in crate::task) fn walk<W: Walk>(&mut self, table: &NodeTable, own: &Own, w: &mut W) {
        let Self {
            inboxes,
            // This field is rebuilt from the inboxes below.
            ready,
            served,
            arrivals,
            rejections,
            // The functions `walk_incarnations` and `walk_guards` visit these fields.
            incarnations: _,
            guards: _,
            // This field is not packed, because the task has read the message before the state is packed.
            taken,
            // This field is not packed, because it is empty between two inputs.
            turned: _,
        } = self;
        if W::READS {
            taken.0 = None;
            taken.1.clear();
            // After decoding, new numbers count from here, because only the order of the waiting messages' numbers matters.
            (*arrivals, *rejections) = (0, 1);
            // After decoding, this count is at least as great as any packed count of bypasses.
            *served = u64::from(u8::MAX);
        }
        for at in 0..inboxes.len() {
            let form = Form::of(table, inboxes[at].port);
            let waiting = match W::PASS {
                Pass::Encode | Pass::Look => waiting(inboxes, form, at),
                Pass::Decode | Pass::Change => Vec::new(),
            };
            let counters = &mut Counters { arrivals, rejections };
            inboxes[at].walk(form, (own.now, *served), waiting, counters, w);
        }
        if W::READS && inboxes.iter().any(|inbox| inbox.handled) {
            ready.watch(inboxes);
        }
        if matches!(W::PASS, Pass::Decode | Pass::Change) {
            self.touch_all(own);
        }
    }

    pub(in crate::task) fn walk_incarnations<W: Walk>(&mut self, w: &mut W) {
        self.incarnations
            .iter_mut()
            .for_each(|Known { task: _, incarnation }| w.known_incarnation(incarnation));
    }

    pub(in crate::task) fn walk_guards<W: Walk>(&mut self, w: &mut W) {
        self.guards.iter_mut().for_each(|guard| guard.walk(w));
    }
}

impl Inbox {
    /// Visits an inbox: the receiver's state of one port. For a walk that encodes or looks, `waiting` holds the messages
    /// that wait at the port. For a walk that decodes or changes, `waiting` is empty.
    fn walk<W: Walk>(
        &mut self,
        form: Form,
        (now, served): (Instant, u64),
        waiting: Vec<Waiting>,
        counters: &mut Counters<'_>,
        w: &mut W,
    ) {
        self.walk_waiting(form, (now, served), waiting, counters, w);
        let Self { port: _, endpoint: _, queue: _, handled: _, latest: _, since: _, sources, long } = self;
        for (at, source) in sources.iter_mut().enumerate() {
            let (assembly, answer) = match long {
                Some(long) => (long.assemblies.get_mut(at), long.answers.get_mut(at)),
                None => (None, None),
            };
            let answer = answer.filter(|_| form.long_answers);
            source.walk(answer, w);
            if let Some(assembly) = assembly.filter(|_| form.long) {
                assembly.walk_message(source.task, w);
            }
        }
    }

    fn walk_waiting<W: Walk>(
        &mut self,
        form: Form,
        (now, served): (Instant, u64),
        waiting: Vec<Waiting>,
        counters: &mut Counters<'_>,
        w: &mut W,
    ) {
        if W::PASS == Pass::Change {
            self.queue.change_all(|held, retry| held.walk(retry, now, form, w));
            return;
        }
        let bypassed = if W::READS { 0 } else { self.bypassed(served) };
        let len = u8::try_from(waiting.len()).unwrap_or(u8::MAX);
        if len > WAITING {
            w.overflows();
        }
        let head = len & WAITING | mark(bypassed > 0, BYPASSED) | mark(self.handled, HANDLED);
        let head = w.put(head);
        let bypassed = if head & BYPASSED != 0 { w.count(usize::from(bypassed)) } else { 0 };
        if W::READS {
            let bypassed = bypassed as u64;
            self.handled = head & HANDLED != 0;
            self.since = if self.handled { bypassed } else { served - bypassed };
            self.queue.clear();
            if self.handled {
                self.queue.watch();
            }
            return (0..head & WAITING).for_each(|_| self.take_in(form, counters, w));
        }
        for Waiting { slot, mut held, mut retry } in waiting {
            held.walk(&mut retry, now, form, w);
            if let Some(body) = self.body_mut(slot).filter(|_| held.fragments > 1) {
                body.walk(w);
            }
        }
    }

    /// Decodes a waiting message.
    fn take_in<W: Walk>(&mut self, form: Form, counters: &mut Counters<'_>, w: &mut W) {
        let (mut held, mut retry) = (Held::BLANK, RetryState::default());
        held.walk(&mut retry, Instant::START, form, w);
        if !form.ranks_arrivals {
            held.arrival = *counters.arrivals;
        }
        *counters.arrivals += 1;
        if retry.rejections > 0 {
            retry.rejected_first += 1;
            *counters.rejections = (*counters.rejections).max(retry.rejected_first + 1);
        }
        if retry != RetryState::default() {
            self.queue.watch();
        }
        if let Ok(slot) = self.queue.push_with(held, retry)
            && let Some(body) = self.body_mut(slot)
        {
            body.clear();
            if held.fragments > 1 {
                body.walk(w);
            }
        }
    }
}

impl Held {
    const BLANK: Self = Self {
        source: TaskId(0),
        incarnation: Incarnation(0),
        sequence: Seq24::new(0),
        class: Class::Command,
        expires: Instant::START,
        contents: Contents::EMPTY,
        fragments: 1,
        arrival: 0,
    };

    fn walk<W: Walk>(&mut self, retry: &mut RetryState, now: Instant, form: Form, w: &mut W) {
        let Self { source, incarnation, sequence, class, expires, contents, fragments, arrival } = self;
        let RetryState { rejections, rejected_first, not_before } = retry;
        w.small(&mut source.0);
        w.incarnation(incarnation);
        w.sequence(*source, sequence);
        let [status, rejected, later] =
            w.flags([*class == Class::Status, *rejections > 0, *not_before > now]);
        *class = if status { Class::Status } else { Class::Command };
        w.instant(expires);
        w.contents(contents);
        if rejected {
            w.byte(rejections);
            rank(rejected_first, w);
        }
        // An instant that has passed is packed like an absent one.
        if later || W::PASS == Pass::Change {
            w.instant(not_before);
        }
        if form.ranks_arrivals {
            rank(arrival, w);
        }
        if form.long {
            w.byte(fragments);
        }
    }
}

/// Visits a number that the packed state replaces by its rank among the numbers of its kind.
fn rank<W: Walk>(number: &mut u64, w: &mut W) {
    if W::PACKS {
        *number = w.count(usize::try_from(*number).unwrap_or(usize::MAX)) as u64;
    }
}

impl Source {
    fn walk<W: Walk>(&mut self, answer: Option<&mut Parts>, w: &mut W) {
        if W::READS {
            self.forget();
        }
        let Self { task, memory } = self;
        match memory {
            Memory::Command(command) => walk_command(command, *task, answer, w),
            Memory::Status(window) => {
                let Window { newest, seen, until } = window;
                let is = w.put(u8::from(newest.is_some())) != 0;
                if let Some(newest) = w.some(newest, is, Seq24::default()) {
                    w.sequence(*task, newest);
                    w.instant(until);
                    w.long(seen);
                }
            }
        }
    }
}

fn walk_command<W: Walk>(
    command: &mut Option<DedupEntry>,
    task: TaskId,
    mut answer: Option<&mut Parts>,
    w: &mut W,
) {
    if W::READS
        && let Some(answer) = &mut answer
    {
        answer.clear();
    }
    let mut known = command.map(|command| command.status);
    w.one_of(&STATUSES, &mut known, same_option);
    let blank = |status| DedupEntry {
        id: MessageId::default(),
        status,
        sender_until: Instant::START,
        until: Instant::START,
    };
    if W::READS {
        *command = known.map(blank);
    }
    let Some(DedupEntry { id, status, sender_until, until }) = command else { return };
    w.id(task, Incarnation(0), id);
    w.instant(sender_until);
    w.instant(until);
    match status {
        CommandStatus::Delivered(budget_ends) => w.instant(budget_ends),
        CommandStatus::Answered(contents) => {
            w.contents(contents);
            if let Some(answer) = answer {
                answer.walk(w);
            }
        }
        CommandStatus::Held | CommandStatus::Lapsed | CommandStatus::Refused => {}
    }
}

impl Server {
    /// Drops dead state: dedup entries that have ended by `now`.
    pub fn bury(&mut self, now: Instant) {
        for guard in &mut self.guards {
            guard.bury(now);
        }
        for inbox in &mut self.inboxes {
            for source in &mut inbox.sources {
                source.bury(now);
            }
        }
    }

    /// Clears dedup entries of messages of which no copy can arrive any more. `copies` gives the numbers of the copies that
    /// may still come from a source on a port.
    pub fn bury_seen<I: Iterator<Item = Seq24>>(&mut self, copies: impl Fn(PortId, TaskId) -> I) {
        for inbox in &mut self.inboxes {
            let port = inbox.port;
            for source in &mut inbox.sources {
                let task = source.task;
                source.bury_seen(|| copies(port, task));
            }
        }
    }
}
