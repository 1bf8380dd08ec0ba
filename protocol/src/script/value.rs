//! The values of a script, and expressions over them.
//!
//! Every value is one `i64`: a truth value is 0 or 1, an integer is itself, a `real` is the bits of its `f32`. To store a
//! value outside the range of the variable's type is a fault, never a wrap, and a checker reports it.

use super::ScriptFault;
use crate::ids::{PortId, TaskId};
use serde::{Deserialize, Serialize};

/// The type of a variable or of a field of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Type {
    /// True or false.
    Bool,
    /// -128 ..= 127.
    Int8,
    /// -32,768 ..= 32,767.
    Int16,
    /// 32 bits, signed.
    Int32,
    /// 32 bits, unsigned.
    Word,
    /// A finite 32-bit floating point number; zero has no sign.
    Real,
}

impl Type {
    /// How many bytes a field of this type takes in a message.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::Bool | Self::Int8 => 1,
            Self::Int16 => 2,
            Self::Int32 | Self::Word | Self::Real => 4,
        }
    }

    /// Whether `value` is in the range of this type.
    #[must_use]
    #[inline]
    pub fn holds(self, value: i64) -> bool {
        match self {
            Self::Bool => value == 0 || value == 1,
            Self::Int8 => i8::try_from(value).is_ok(),
            Self::Int16 => i16::try_from(value).is_ok(),
            Self::Int32 => i32::try_from(value).is_ok(),
            Self::Word => u32::try_from(value).is_ok(),
            Self::Real => number(value).is_some_and(|x| x.is_finite() && (x != 0.0 || value == 0)),
        }
    }

    /// Writes the low bytes of `value`, little endian; `None` where `out` is too short.
    #[inline]
    pub(super) fn write(self, value: i64, out: &mut [u8]) -> Option<()> {
        let [a, b, c, d, ..] = value.to_le_bytes();
        match self {
            Self::Bool | Self::Int8 => *out.first_mut()? = a,
            Self::Int16 => *out.first_chunk_mut()? = [a, b],
            Self::Int32 | Self::Word | Self::Real => *out.first_chunk_mut()? = [a, b, c, d],
        }
        Some(())
    }

    /// Reads a value; `None` if `bytes` are too few or hold no value of this type.
    #[inline]
    pub(super) fn read(self, bytes: &[u8]) -> Option<i64> {
        match self {
            Self::Int8 => Some(i64::from(bytes.first()?.cast_signed())),
            Self::Int16 => Some(i64::from(i16::from_le_bytes(*bytes.first_chunk()?))),
            Self::Int32 => Some(i64::from(i32::from_le_bytes(*bytes.first_chunk()?))),
            Self::Word => Some(i64::from(u32::from_le_bytes(*bytes.first_chunk()?))),
            Self::Bool => Some(i64::from(*bytes.first()?)).filter(|&value| self.holds(value)),
            Self::Real => {
                Some(i64::from(u32::from_le_bytes(*bytes.first_chunk()?))).filter(|&value| self.holds(value))
            }
        }
    }
}

/// The value that stands for a `real`; `None` for one that is not finite.
#[must_use]
pub fn real(x: f32) -> Option<i64> {
    let x = if x == 0.0 { 0.0 } else { x };
    x.is_finite().then(|| i64::from(x.to_bits()))
}

/// The `real` that a value stands for.
#[inline]
pub(super) fn number(value: i64) -> Option<f32> {
    u32::try_from(value).ok().map(f32::from_bits)
}

/// Where a script keeps a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Slot {
    /// A variable of the task, by position.
    Task(u16),
    /// A variable of the handler that runs, by position.
    Local(u16),
}

/// An operator with two operands. Comparisons and connectives give 0 or 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Binary {
    Add,
    Subtract,
    Multiply,
    Divide,
    /// The remainder of a division, with the sign of the dividend; not for reals.
    Remainder,
    Equal,
    NotEqual,
    Less,
    LessOrEqual,
    Greater,
    GreaterOrEqual,
    /// Logical "and". Anything but 0 is true.
    And,
    /// Logical "or". Anything but 0 is true.
    Or,
}

/// What a `check` asks about a cell as a whole (D45).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Predicate {
    /// `port.arrived(task)`: the task reached the waitfor, and no member has begun a later meeting there since. It stays
    /// true if the task then gives up, but not if the task restarts (D85).
    Arrived {
        /// The port of the waitfor.
        port: PortId,
        /// The task whose arrival is asked about.
        task: TaskId,
    },
    /// `task.asked(port)`: the task has sent a class-2 message or a query on the port and waits.
    Asked {
        /// The task that sent the message.
        task: TaskId,
        /// The port of the message.
        port: PortId,
    },
    /// `task.answered(port)`: the task's last request on the port has been answered, by every task that was asked. Neither
    /// a refusal nor a time_out is an answer.
    Answered {
        /// The task that made the request.
        task: TaskId,
        /// The port of the request.
        port: PortId,
    },
    /// `task.active`: the task may act. It has begun and not ended, its node is up, and it holds its lease if it needs one
    /// (D61).
    Active(TaskId),
}

/// One step of an expression in postfix order: takes its operands from a stack and leaves its value there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Term {
    /// A constant.
    Push(i64),
    /// A variable of the same task or handler.
    Load(Slot),
    /// A variable of some task, in a `check`.
    Of {
        /// The task that has the variable.
        task: TaskId,
        /// The position of the variable in the task's program.
        variable: u16,
    },
    /// A built-in predicate, in a `check`.
    Is(Predicate),
    /// An operator on integers and truth values.
    Int(Binary),
    /// An operator on reals.
    Real(Binary),
    /// Negates an integer.
    Negate,
    /// Negates a real.
    NegateReal,
    /// `not` of a truth value.
    Not,
    /// The real nearest to an integer.
    ToReal,
    /// The whole part of a real.
    ToInt,
}

/// What a `check` reads of the cell: see [`Term::reads`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// A variable of a task, by position.
    Variable(TaskId, u16),
    /// A built-in predicate.
    Predicate(Predicate),
}

impl Term {
    /// What the term reads of the cell; `None` for constants, operators and a script's own variables.
    #[must_use]
    pub const fn reads(self) -> Option<Reading> {
        match self {
            Self::Of { task, variable } => Some(Reading::Variable(task, variable)),
            Self::Is(predicate) => Some(Reading::Predicate(predicate)),
            Self::Push(_)
            | Self::Load(_)
            | Self::Int(_)
            | Self::Real(_)
            | Self::Negate
            | Self::NegateReal
            | Self::Not
            | Self::ToReal
            | Self::ToInt => None,
        }
    }
}

/// How many operands a `check` may hold at once.
pub const CHECK_DEPTH: usize = 32;

/// Evaluates an expression. `look` gives the values of [`Term::Load`], [`Term::Of`] and [`Term::Is`], or `None` if there
/// is no such variable or predicate. The model checker and the cell language share this function (D45).
///
/// # Errors
/// [`ScriptFault::Malformed`] if the terms are not an expression, and the faults of arithmetic.
pub fn eval(terms: &[Term], mut look: impl FnMut(Term) -> Option<i64>) -> Result<i64, ScriptFault> {
    let (mut cells, mut len) = ([0; CHECK_DEPTH], 0);
    let mut operands = Operands { cells: &mut cells, len: &mut len };
    for &term in terms {
        operands.apply(term, &mut look)?;
    }
    let value = operands.pop()?;
    if len == 0 { Ok(value) } else { Err(ScriptFault::Malformed) }
}

/// A stack of operands in a fixed array. The cells above its top are zero, so that equal stacks have equal bytes.
pub(super) struct Operands<'a> {
    pub cells: &'a mut [i64],
    pub len: &'a mut usize,
}

impl Operands<'_> {
    pub fn push(&mut self, value: i64) -> Result<(), ScriptFault> {
        *self.cells.get_mut(*self.len).ok_or(ScriptFault::Malformed)? = value;
        *self.len += 1;
        Ok(())
    }

    pub fn pop(&mut self) -> Result<i64, ScriptFault> {
        let top = self.len.checked_sub(1).ok_or(ScriptFault::Malformed)?;
        let cell = self.cells.get_mut(top).ok_or(ScriptFault::Malformed)?;
        *self.len = top;
        Ok(core::mem::take(cell))
    }

    pub fn apply(
        &mut self,
        term: Term,
        look: &mut impl FnMut(Term) -> Option<i64>,
    ) -> Result<(), ScriptFault> {
        let value = match term {
            Term::Push(value) => value,
            Term::Load(_) | Term::Of { .. } | Term::Is(_) => look(term).ok_or(ScriptFault::Malformed)?,
            Term::Int(operator) => {
                let (b, a) = (self.pop()?, self.pop()?);
                integers(operator, a, b)?
            }
            Term::Real(operator) => {
                let (b, a) = (self.pop_real()?, self.pop_real()?);
                reals(operator, a, b)?
            }
            Term::Negate => self.pop()?.checked_neg().ok_or(ScriptFault::Overflow)?,
            Term::NegateReal => real(-self.pop_real()?).ok_or(ScriptFault::NotFinite)?,
            Term::Not => i64::from(self.pop()? == 0),
            Term::ToReal => {
                #[expect(clippy::cast_precision_loss, reason = "the nearest real is meant")]
                let nearest = self.pop()? as f32;
                real(nearest).ok_or(ScriptFault::NotFinite)?
            }
            Term::ToInt => {
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "the whole part; saturates where out of range"
                )]
                let whole = self.pop_real()? as i64;
                whole
            }
        };
        self.push(value)
    }

    fn pop_real(&mut self) -> Result<f32, ScriptFault> {
        number(self.pop()?).ok_or(ScriptFault::Malformed)
    }
}

#[inline]
pub(super) fn integers(operator: Binary, a: i64, b: i64) -> Result<i64, ScriptFault> {
    let value = match operator {
        Binary::Add => a.checked_add(b),
        Binary::Subtract => a.checked_sub(b),
        Binary::Multiply => a.checked_mul(b),
        Binary::Divide | Binary::Remainder if b == 0 => return Err(ScriptFault::DivisionByZero),
        Binary::Divide => a.checked_div(b),
        Binary::Remainder => a.checked_rem(b),
        Binary::Equal => Some(i64::from(a == b)),
        Binary::NotEqual => Some(i64::from(a != b)),
        Binary::Less => Some(i64::from(a < b)),
        Binary::LessOrEqual => Some(i64::from(a <= b)),
        Binary::Greater => Some(i64::from(a > b)),
        Binary::GreaterOrEqual => Some(i64::from(a >= b)),
        Binary::And => Some(i64::from(a != 0 && b != 0)),
        Binary::Or => Some(i64::from(a != 0 || b != 0)),
    };
    value.ok_or(ScriptFault::Overflow)
}

#[expect(clippy::float_cmp, reason = "`=` of reals is what the program asked for")]
pub(super) fn reals(operator: Binary, a: f32, b: f32) -> Result<i64, ScriptFault> {
    let sum = match operator {
        Binary::Add => a + b,
        Binary::Subtract => a - b,
        Binary::Multiply => a * b,
        Binary::Divide if b == 0.0 => return Err(ScriptFault::DivisionByZero),
        Binary::Divide => a / b,
        Binary::Equal => return Ok(i64::from(a == b)),
        Binary::NotEqual => return Ok(i64::from(a != b)),
        Binary::Less => return Ok(i64::from(a < b)),
        Binary::LessOrEqual => return Ok(i64::from(a <= b)),
        Binary::Greater => return Ok(i64::from(a > b)),
        Binary::GreaterOrEqual => return Ok(i64::from(a >= b)),
        Binary::Remainder | Binary::And | Binary::Or => return Err(ScriptFault::Malformed),
    };
    real(sum).ok_or(ScriptFault::NotFinite)
}

#[cfg(test)]
mod tests;
