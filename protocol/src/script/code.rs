//! The compiled form of a program, made when the program is loaded: operations whose operands are resolved (D188).
//!
//! For each operation of a [`Program`] there is a [`Shortcut`]: it does the work of this operation and of those after it,
//! without the stack of operands. A shortcut is carried out wholly or not at all. In unusual cases (a fault, a missing or
//! long message, the last operations of a step) the interpreter carries out the operation itself, and looks for the
//! shortcut of the next operation. So a shortcut needs no rule for faults, positions stay those of the program, and a
//! script may continue at any operation: no state shows whether shortcuts were used.

use super::program::{Address, Fusing, Op, Program, StatementOutcome};
use super::value::{Binary, Slot, Term, Type};
use crate::packet::CONTENTS_BYTES;
use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

/// The most operations that a shortcut replaces by one branch on an outcome.
const MOST_BRANCHES: u8 = 16;

/// The shortcuts of a program's operations.
#[derive(Clone, Debug, Default)]
pub struct Code {
    pub shortcuts: Box<[Shortcut]>,
    /// For each outcome of a statement: where the script continues. [`Act::On`] holds the position of its first entry.
    pub branches: Box<[Landing]>,
    pub sent: Box<[Sent]>,
    pub read: Box<[Read]>,
}

/// What an operation and those after it do together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shortcut {
    /// Whether the operation begins a statement. If so, `act` stands for the operations after it.
    pub statement: bool,
    pub act: Act,
    /// The greatest number of operations that `act` stands for.
    pub count: u8,
    /// Where the script continues, unless `act` itself determines it: after `act` and a jump that follows. For an [`Op::Reply`]
    /// that sends its operands: the [`Op::Get`] that the script reaches once the reply is accepted, if no other request comes
    /// before (D200).
    pub next: Landing,
}

/// Where a script continues, and how many operations lead there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Landing {
    pub to: Address,
    pub count: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Act {
    /// The operation has no shortcut, and is carried out by itself.
    Plain,
    Jump,
    /// Branches on the outcome of the last statement, as long as the operations do nothing else. The branches begin at this
    /// position of [`Code::branches`].
    On(u16),
    Compute(Compute),
    Send(Send),
    Unpack(Unpack),
    /// [`Op::Get`].
    Get,
}

/// A function of two values, `pops` of which come from the stack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Compute {
    pub function: Function,
    pub a: Operand,
    pub b: Operand,
    pub pops: u8,
    pub then: Then,
}

/// A message of `len` bytes in one packet: its last fields are pushed by operations, and the next operation is
/// [`Op::Send`], [`Op::Reply`] or [`Op::Arrive`]. The first fields come from the stack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Send {
    /// The fields that are sent, in [`Code::sent`].
    pub fields: Fields,
    pub len: u8,
    /// How many pushes of fields the shortcut replaces.
    pub pushed: u8,
    /// How many fields come from the stack.
    pub pops: u8,
}

/// A message of `len` bytes in one packet, to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unpack {
    /// The fields that are read, in [`Code::read`].
    pub fields: Fields,
    pub len: u8,
}

/// A range of fields in a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fields {
    pub first: u16,
    pub count: u8,
}

impl Fields {
    #[inline]
    pub fn range(self) -> core::ops::Range<usize> {
        let first = usize::from(self.first);
        first..first + usize::from(self.count)
    }
}

/// A value that the program names, or one on the stack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Operand {
    Constant(i64),
    /// A variable of the task.
    Task(u16),
    /// A variable of the handler.
    Local(u16),
    /// The value this many places below the top of the stack, from 1.
    Stack(u8),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Function {
    /// The result is the first value.
    Same,
    /// The result is `not` of the first value.
    Not,
    Int(Binary),
    Real(Binary),
}

/// What is done with a computed value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Then {
    Push,
    /// The value goes into a variable of this type.
    Store(Slot, Type),
    /// The script jumps if the value is false.
    Unless(Address),
}

/// A field that is sent: its value, its type and its position in the contents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sent {
    pub value: Operand,
    pub of: Type,
    pub at: u8,
}

/// A field that is read: its type, its position in the contents, and the variable that takes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Read {
    pub of: Type,
    pub at: u8,
    pub place: Slot,
    /// The type of the variable.
    pub holds: Type,
}

impl Shortcut {
    const PLAIN: Self =
        Self { statement: false, act: Act::Plain, count: 1, next: Landing { to: 0, count: 1 } };
}

impl Code {
    /// Compiles a program. A program that fails its check has no shortcuts, because the number of its operands is unknown.
    #[must_use]
    pub fn new(program: &Program) -> Self {
        if program.check().is_err() {
            return Self::plain();
        }
        let owners = owners(program);
        let mut tables = Tables::default();
        let mut shortcuts = vec![Shortcut::PLAIN; program.code.len()];
        // The loop goes backwards, because a statement uses the shortcut of the operation after it.
        for at in (0..program.code.len()).rev() {
            if program.code[at] == Op::Statement {
                let after = shortcuts.get(at + 1).filter(|after| !after.statement);
                shortcuts[at] = Shortcut { statement: true, ..after.copied().unwrap_or(Shortcut::PLAIN) };
            } else if let Some(owner) = owners[at] {
                let mut compiler = Compiler { program, owner, tables: &mut tables };
                shortcuts[at] = compiler.shortcut(at).unwrap_or(Shortcut::PLAIN);
            }
        }
        let Tables { branches, sent, read } = tables;
        Self { shortcuts: shortcuts.into(), branches: branches.into(), sent: sent.into(), read: read.into() }
    }

    /// Code without shortcuts: each operation is carried out by itself.
    #[must_use]
    pub fn plain() -> Self {
        Self::default()
    }

    #[inline]
    pub fn shortcut(&self, at: Address) -> &Shortcut {
        self.shortcuts.get(usize::from(at)).unwrap_or(&Shortcut::PLAIN)
    }
}

/// For each operation the handler to which it belongs, or `Some(None)` if it belongs to the task's own thread. `None`: the
/// operation is not reached, or belongs to several handlers, so that its local variables are not known.
fn owners(program: &Program) -> Vec<Option<Option<u8>>> {
    let mut owners = vec![None; program.code.len()];
    let mut shared = vec![false; program.code.len()];
    let own = [Some(0), program.takeover].into_iter().flatten().map(|entry| (entry, None));
    let handlers = (0..).zip(&program.handlers).map(|(at, handler)| (handler.entry, Some(at)));
    for (entry, owner) in own.chain(handlers) {
        for (at, _) in program.reached(entry).into_iter().enumerate().filter(|&(_, reached)| reached) {
            shared[at] |= owners[at].is_some_and(|other| other != owner);
            owners[at] = Some(owner);
        }
    }
    owners.into_iter().zip(shared).map(|(owner, shared)| owner.filter(|_| !shared)).collect()
}

/// Follows the code from `to` after a statement with the outcome `Done`: through jumps, branches and beginnings of statements,
/// which `begins` gets. Returns the first other operation, such as a GET. These operations are not counted, because each wait
/// begins with a full limit of operations.
pub fn get_after(program: &Program, mut to: Address, mut begins: impl FnMut(Address)) -> Address {
    // No message can have come since the acceptance, so the next statement need not ask whether a handler runs first.
    let is_plain = program.fusing == Fusing::Fused || !program.is_interruptible();
    for _ in 0..MOST_BRANCHES {
        to = match program.code.get(usize::from(to)) {
            Some(&Op::Jump(to)) => to,
            Some(Op::Statement) if is_plain => {
                begins(to);
                to.saturating_add(1)
            }
            Some(&Op::On { outcomes, to }) if outcomes.has(StatementOutcome::Done) => to,
            Some(Op::On { .. }) => to.saturating_add(1),
            _ => break,
        };
    }
    to
}

/// Compiles one operation at a time.
struct Compiler<'a> {
    program: &'a Program,
    /// The handler to which the operation belongs.
    owner: Option<u8>,
    tables: &'a mut Tables,
}

/// The tables that grow while a program is compiled.
#[derive(Default)]
struct Tables {
    branches: Vec<Landing>,
    sent: Vec<Sent>,
    read: Vec<Read>,
}

impl Compiler<'_> {
    fn shortcut(&mut self, at: usize) -> Option<Shortcut> {
        let (act, count) = match *self.program.code.get(at)? {
            Op::Jump(_) => (Act::Jump, 0),
            Op::On { .. } => (self.branches(at)?, MOST_BRANCHES),
            Op::Get { .. } => (Act::Get, 1),
            Op::Unpack { format, into } => (self.unpack(format, into)?, 1),
            _ => self.send(at).or_else(|| self.compute(at))?,
        };
        let after = Address::try_from(at + usize::from(count)).ok()?;
        let next = match self.program.code.get(usize::from(after)) {
            _ if matches!(self.program.code[at], Op::Reply { .. }) => {
                Landing { to: get_after(self.program, after, |_| ()), count: 0 }
            }
            Some(&Op::Jump(to)) => Landing { to, count: count + 1 },
            _ => Landing { to: after, count },
        };
        Some(Shortcut { statement: false, act, count, next })
    }

    /// Where the outcomes of a statement lead.
    fn branches(&mut self, at: usize) -> Option<Act> {
        let first = u16::try_from(self.tables.branches.len()).ok()?;
        for outcome in 0..=StatementOutcome::Fenced as u16 {
            let (mut to, mut count) = (Address::try_from(at).ok()?, 0);
            while count < MOST_BRANCHES {
                to = match *self.program.code.get(usize::from(to))? {
                    Op::On { outcomes, to } if outcomes.0 >> outcome & 1 == 1 => to,
                    Op::On { .. } => to.checked_add(1)?,
                    Op::Jump(to) => to,
                    _ => break,
                };
                count += 1;
            }
            self.tables.branches.push(Landing { to, count });
        }
        Some(Act::On(first))
    }

    /// The type of a variable.
    fn of(&self, slot: Slot) -> Option<Type> {
        let variable = match slot {
            Slot::Task(at) => self.program.variables.get(usize::from(at)),
            Slot::Local(at) => self.program.local(self.owner, at),
        };
        variable.map(|variable| variable.of)
    }

    /// The value that an operation pushes, if the program alone determines it.
    fn operand(&self, at: usize) -> Option<Operand> {
        match *self.program.code.get(at)? {
            Op::Term(Term::Push(value)) => Some(Operand::Constant(value)),
            Op::Term(Term::Load(slot)) => self.of(slot).map(|_| match slot {
                Slot::Task(at) => Operand::Task(at),
                Slot::Local(at) => Operand::Local(at),
            }),
            _ => None,
        }
    }

    /// Joins the operations from `at` on that compute one value: up to two operands, a function, and a store or conditional
    /// jump if one follows. Without such a store or jump the value is pushed. Returns the act and how many operations it
    /// replaces; `None` if there is nothing to join.
    fn compute(&self, at: usize) -> Option<(Act, u8)> {
        use Operand::Stack;
        let function = |at: usize| match *self.program.code.get(at)? {
            Op::Term(Term::Int(operator)) => Some((Function::Int(operator), 2)),
            Op::Term(Term::Real(operator)) => Some((Function::Real(operator), 2)),
            Op::Term(Term::Not) => Some((Function::Not, 1)),
            _ => None,
        };
        let first = self.operand(at);
        let second = first.and_then(|_| self.operand(at + 1));
        let both = first.zip(second).and_then(|(a, b)| match function(at + 2)? {
            (function, 2) => Some((function, a, b, 0, 3)),
            _ => None,
        });
        let with_first = || match (first?, function(at + 1)?) {
            (b, (function, 2)) => Some((function, Stack(1), b, 1, 2)),
            (a, (function, _)) => Some((function, a, a, 0, 2)),
        };
        let stacked = || match (first, function(at)) {
            (Some(a), _) => (Function::Same, a, a, 0, 1),
            (None, Some((function, 2))) => (function, Stack(2), Stack(1), 2, 1),
            (None, Some((function, _))) => (function, Stack(1), Stack(1), 1, 1),
            (None, None) => (Function::Same, Stack(1), Stack(1), 1, 0),
        };
        let (function, a, b, pops, used) = both.or_else(with_first).unwrap_or_else(stacked);
        let (then, count) = match self.program.code.get(at + usize::from(used)) {
            Some(&Op::Store(slot)) => (Then::Store(slot, self.of(slot)?), used + 1),
            Some(&Op::Unless(to)) => (Then::Unless(to), used + 1),
            _ if used == 0 => return None,
            _ => (Then::Push, used),
        };
        Some((Act::Compute(Compute { function, a, b, pops, then }), count))
    }

    /// A message of one packet, whose last fields the operations from `at` on push.
    fn send(&mut self, at: usize) -> Option<(Act, u8)> {
        let pushed: Vec<Operand> = (at..).map_while(|at| self.operand(at)).take(CONTENTS_BYTES + 1).collect();
        let (format, most) = match *self.program.code.get(at + pushed.len())? {
            Op::Send { format, .. } | Op::Reply { format } => (format, CONTENTS_BYTES),
            Op::Arrive { format, .. } => (format, 8),
            _ => return None,
        };
        let format = self.program.formats.get(usize::from(format))?;
        let len = Some(format.bytes()).filter(|&len| len <= most)?;
        let pops = format.fields.len().checked_sub(pushed.len())?;
        let first = u16::try_from(self.tables.sent.len()).ok()?;
        let stacked = (1..=u8::try_from(pops).ok()?).rev().map(Operand::Stack);
        let mut end = 0;
        for (&of, value) in format.fields.iter().zip(stacked.chain(pushed.iter().copied())) {
            self.tables.sent.push(Sent { value, of, at: end });
            end += u8::try_from(of.bytes()).ok()?;
        }
        let fields = Fields { first, count: u8::try_from(format.fields.len()).ok()? };
        let [len, pops, pushed] = [len, pops, pushed.len()].map(u8::try_from);
        let (len, pops, pushed) = (len.ok()?, pops.ok()?, pushed.ok()?);
        Some((Act::Send(Send { fields, len, pushed, pops }), pushed + 1))
    }

    /// Reads a message of one packet into variables.
    fn unpack(&mut self, format: u16, into: u16) -> Option<Act> {
        let format = self.program.formats.get(usize::from(format))?;
        let len = Some(format.bytes()).filter(|&len| len <= CONTENTS_BYTES)?;
        let places = self.program.places.get(usize::from(into)..)?.get(..format.fields.len())?;
        let first = u16::try_from(self.tables.read.len()).ok()?;
        let mut at = 0;
        for (&of, &place) in format.fields.iter().zip(places) {
            let holds = self.of(place)?;
            self.tables.read.push(Read { of, at, place, holds });
            at += u8::try_from(of.bytes()).ok()?;
        }
        let fields = Fields { first, count: u8::try_from(format.fields.len()).ok()? };
        Some(Act::Unpack(Unpack { fields, len: u8::try_from(len).ok()? }))
    }
}
