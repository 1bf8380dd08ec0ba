//! Validation of programs: every position that a program names exists, operands balance, and code ends where it must.

use super::program::{Address, MAX_MESSAGE, Op, Program, Trigger};
use super::value::{Binary, Slot, Term};
use super::{MAX_OPERANDS, Variable};
use crate::request::PUBLISHED_BYTES;
use alloc::vec;
use alloc::vec::Vec;
use core::fmt;

/// Why a program is malformed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProgramError {
    /// The program has more operations, handlers or timers than their numbers can name.
    TooLarge,
    /// The initial value of a variable is not of its type.
    Initial,
    /// A format is longer than 16 packets.
    Format(u16),
    /// Two handlers have the same trigger.
    SameTrigger(Trigger),
    /// The program names a position in the code that does not exist, or the end of the code without an [`Op::End`].
    NoSuchAddress(Address),
    /// The operation names a variable, format, place, action, reason, order or timer that does not exist, or one that
    /// does not fit it.
    NoSuchEntry(Address),
    /// The operation starts a timer without a handler for its end.
    Unhandled(Address),
    /// The operation takes more operands than there are, leaves operands on the stack while it waits, or is reached with
    /// different numbers of operands.
    Operands(Address),
    /// An atomic section is open at the end of a handler, is closed without being open, or is open on only one of two paths
    /// that meet.
    Atomic(Address),
    /// The operation is for checks or for handlers only, or makes no sense: a choice among none, or an action whose shortest
    /// duration exceeds its longest.
    Misplaced(Address),
}

impl fmt::Display for ProgramError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLarge => f.write_str("the program is too large"),
            Self::Initial => f.write_str("a variable begins with a value that is not of its type"),
            Self::Format(format) => write!(f, "format {format} takes more than 16 packets"),
            Self::SameTrigger(trigger) => write!(f, "two handlers for {trigger:?}"),
            Self::NoSuchAddress(at) => write!(f, "there is no operation {at}"),
            Self::NoSuchEntry(at) => write!(f, "operation {at} names what does not exist or does not fit"),
            Self::Unhandled(at) => write!(f, "operation {at} starts a timer without a handler"),
            Self::Operands(at) => write!(f, "the operands of operation {at} do not balance"),
            Self::Atomic(at) => write!(f, "the atomic sections at operation {at} do not balance"),
            Self::Misplaced(at) => write!(f, "operation {at} is out of place"),
        }
    }
}

impl core::error::Error for ProgramError {}

/// What is known before an operation: the operands held, and the open atomic sections.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Known {
    held: usize,
    atomic: u8,
}

impl Program {
    /// Checks the program. Returns the greatest number of operands that it holds at once.
    ///
    /// # Errors
    /// The first fault found.
    pub fn check(&self) -> Result<usize, ProgramError> {
        let fits = self.code.len() <= usize::from(Address::MAX)
            && self.handlers.len() <= 64
            && self.timers.len() <= 200;
        if !fits {
            return Err(ProgramError::TooLarge);
        }
        let locals = self.handlers.iter().flat_map(|handler| &handler.locals);
        if self.variables.iter().chain(locals).any(|Variable { of, initial, .. }| !of.holds(*initial)) {
            return Err(ProgramError::Initial);
        }
        if let Some(long) = self.formats.iter().position(|format| format.bytes() > MAX_MESSAGE) {
            return Err(ProgramError::Format(u16::try_from(long).unwrap_or(u16::MAX)));
        }
        for (i, handler) in self.handlers.iter().enumerate() {
            if self.handlers[..i].iter().any(|other| other.trigger == handler.trigger) {
                return Err(ProgramError::SameTrigger(handler.trigger));
            }
        }
        let mut most = self.walk(0, None)?;
        if let Some(entry) = self.takeover {
            most = most.max(self.walk(entry, None)?);
        }
        for (i, handler) in self.handlers.iter().enumerate() {
            most = most.max(self.walk(handler.entry, u8::try_from(i).ok())?);
        }
        Ok(most)
    }

    /// Follows every path from an entry, in the body or in a handler. Returns the greatest number of operands held.
    fn walk(&self, entry: Address, handler: Option<u8>) -> Result<usize, ProgramError> {
        let mut known: Vec<Option<Known>> = vec![None; self.code.len()];
        let mut open = vec![(entry, Known { held: 0, atomic: 0 })];
        let mut most = 0;
        while let Some((at, before)) = open.pop() {
            let cell = known.get_mut(usize::from(at)).ok_or(ProgramError::NoSuchAddress(at))?;
            match *cell {
                Some(seen) if seen.held != before.held => return Err(ProgramError::Operands(at)),
                Some(seen) if seen != before => return Err(ProgramError::Atomic(at)),
                Some(_) => continue,
                None => *cell = Some(before),
            }
            let op = self.code[usize::from(at)];
            self.check_entries(op, handler).map_err(|fault| fault(at))?;
            let (pops, pushes) = self.effect(op);
            let held = before.held.checked_sub(pops).ok_or(ProgramError::Operands(at))?;
            if waits(op) && held != 0 {
                return Err(ProgramError::Operands(at));
            }
            let held = held + pushes;
            most = most.max(held).max(before.held);
            if held > MAX_OPERANDS {
                return Err(ProgramError::Operands(at));
            }
            let atomic = match op {
                Op::Atomic(true) => before.atomic.checked_add(1),
                Op::Atomic(false) => before.atomic.checked_sub(1),
                Op::HandlerEnd if before.atomic > 0 => None,
                _ => Some(before.atomic),
            };
            let after = Known { held, atomic: atomic.ok_or(ProgramError::Atomic(at))? };
            open.extend(follow(at, op).into_iter().flatten().map(|to| (to, after)));
        }
        Ok(most)
    }

    /// The handlers that may begin an action, one bit for each handler.
    pub(super) fn acting_handlers(&self) -> u64 {
        let mut acting = 0;
        for (i, handler) in self.handlers.iter().enumerate().take(64) {
            let mut reached = self.code.iter().zip(self.reached(handler.entry));
            acting |= u64::from(reached.any(|(op, reached)| reached && matches!(op, Op::Run { .. }))) << i;
        }
        acting
    }

    /// The operations that may run after this one, itself included.
    pub(super) fn reached(&self, from: Address) -> Vec<bool> {
        let mut seen = vec![false; self.code.len()];
        let mut open = vec![from];
        while let Some(at) = open.pop() {
            let Some(op) = self.code.get(usize::from(at)).copied() else { continue };
            if !core::mem::replace(&mut seen[usize::from(at)], true) {
                open.extend(follow(at, op).into_iter().flatten());
            }
        }
        seen
    }

    /// How many operands an operation takes and leaves.
    fn effect(&self, op: Op) -> (usize, usize) {
        let fields = |format: u16| self.formats.get(usize::from(format)).map_or(0, |f| f.fields.len());
        match op {
            Op::Term(term) => match term {
                Term::Push(_) | Term::Load(_) | Term::Of { .. } | Term::Is(_) => (0, 1),
                Term::Int(_) | Term::Real(_) => (2, 1),
                Term::Negate | Term::NegateReal | Term::Not | Term::ToReal | Term::ToInt => (1, 1),
            },
            Op::Store(_) | Op::Pop | Op::Unless(_) | Op::Assert => (1, 0),
            Op::Outcome
            | Op::Value
            | Op::Mark(_)
            | Op::Answer { .. }
            | Op::ReceivedPort
            | Op::ReceivedSource
            | Op::ReceivedId
            | Op::Published
            | Op::Arrival { .. } => (0, 1),
            Op::Choose(_) => (0, 1),
            Op::Send { format, .. }
            | Op::Reply { format }
            | Op::ReplyOwed { format, .. }
            | Op::Arrive { format, .. }
            | Op::Publish { format } => (fields(format), 0),
            Op::ReplyFor { format, .. } => (fields(format) + 2, 0),
            Op::Run { arguments, .. } => (usize::from(arguments), 0),
            Op::Statement
            | Op::Jump(_)
            | Op::On { .. }
            | Op::Unpack { .. }
            | Op::Get { .. }
            | Op::Order(_)
            | Op::Delay(_)
            | Op::Start { .. }
            | Op::Stop(_)
            | Op::Atomic(_)
            | Op::Lease
            | Op::Abort(_)
            | Op::HandlerEnd
            | Op::End => (0, 0),
        }
    }

    /// Whether everything that an operation names exists.
    fn check_entries(&self, op: Op, handler: Option<u8>) -> Result<(), fn(Address) -> ProgramError> {
        let slot = |slot: Slot| match slot {
            Slot::Task(at) => usize::from(at) < self.variables.len(),
            Slot::Local(at) => self.local(handler, at).is_some(),
        };
        let bytes = |format: u16| self.formats.get(usize::from(format)).map(super::Format::bytes);
        let handled = |timer| self.handler(Trigger::Timer(timer)).is_some();
        let exists = match op {
            Op::Term(
                Term::Of { .. } | Term::Is(_) | Term::Real(Binary::Remainder | Binary::And | Binary::Or),
            ) => {
                return Err(ProgramError::Misplaced);
            }
            Op::HandlerEnd if handler.is_none() => return Err(ProgramError::Misplaced),
            Op::Choose(0) => return Err(ProgramError::Misplaced),
            Op::Run { least, most, .. } if least > most => return Err(ProgramError::Misplaced),
            Op::Start { timer, .. } if !handled(timer) => return Err(ProgramError::Unhandled),
            Op::Term(Term::Load(at)) | Op::Store(at) => slot(at),
            Op::Unpack { format, into } => {
                let fields = self.formats.get(usize::from(format)).map_or(usize::MAX, |f| f.fields.len());
                let places = self.places.get(usize::from(into)..).and_then(|places| places.get(..fields));
                places.is_some_and(|places| places.iter().all(|&place| slot(place)))
            }
            Op::Send { format, .. }
            | Op::Reply { format }
            | Op::ReplyFor { format, .. }
            | Op::ReplyOwed { format, .. } => bytes(format).is_some(),
            Op::Arrive { format, .. } | Op::Arrival { format, .. } => {
                bytes(format).is_some_and(|bytes| bytes <= 8)
            }
            Op::Publish { format } => bytes(format).is_some_and(|bytes| bytes <= PUBLISHED_BYTES),
            Op::Order(order) => usize::from(order) < self.orders.len(),
            Op::Start { timer, .. } | Op::Stop(timer) => usize::from(timer.0) < self.timers.len(),
            Op::Run { action, .. } => usize::from(action) < self.actions.len(),
            Op::Abort(reason) => usize::from(reason) < self.reasons.len(),
            Op::Statement
            | Op::Term(_)
            | Op::Pop
            | Op::Jump(_)
            | Op::Unless(_)
            | Op::On { .. }
            | Op::Outcome
            | Op::Value
            | Op::Mark(_)
            | Op::Answer { .. }
            | Op::ReceivedPort
            | Op::ReceivedSource
            | Op::ReceivedId
            | Op::Published
            | Op::Get { .. }
            | Op::Delay(_)
            | Op::Atomic(_)
            | Op::Lease
            | Op::Assert
            | Op::Choose(_)
            | Op::HandlerEnd
            | Op::End => true,
        };
        if exists { Ok(()) } else { Err(ProgramError::NoSuchEntry) }
    }
}

/// Where an activation may go on after an operation.
fn follow(at: Address, op: Op) -> [Option<Address>; 2] {
    let next = Some(at.saturating_add(1));
    match op {
        Op::Jump(to) => [Some(to), None],
        Op::Unless(to) | Op::On { to, .. } => [Some(to), next],
        Op::Abort(_) | Op::End | Op::HandlerEnd => [None, None],
        _ => [next, None],
    }
}

/// Whether a handler may run, or the script may wait, in the operation: then the stack must hold only the operands of this
/// operation.
const fn waits(op: Op) -> bool {
    matches!(
        op,
        Op::Statement
            | Op::Send { .. }
            | Op::Get { .. }
            | Op::Reply { .. }
            | Op::ReplyFor { .. }
            | Op::ReplyOwed { .. }
            | Op::Arrive { .. }
            | Op::Order(_)
            | Op::Delay(_)
            | Op::Start { .. }
            | Op::Stop(_)
            | Op::Run { .. }
            | Op::Atomic(_)
            | Op::Publish { .. }
            | Op::Lease
            | Op::HandlerEnd
            | Op::End
    )
}
