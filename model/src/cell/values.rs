//! Chooses the values to try in messages from tasks outside the cell.

use super::plan::{CellPlan, Conduct, Holds};
use imrs_protocol::script::{Binary, Op, Term, Type, real};
use serde::{Deserialize, Serialize};

/// The greatest number of values to try in a field.
const MOST: usize = 12;

/// The values to try in messages from outside the cell. Message number `n` has the `n`-th value in every field.
///
/// Scripts and checks compare with constants, so values between these constants lead to no other behaviour. The values are
/// zero, one, all constants, and the two neighbours of each constant that is compared by order.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tried {
    /// Values for fields that are not reals.
    pub whole: Vec<i64>,
    /// Values for fields that are reals; empty if there are no such fields.
    pub real: Vec<f32>,
    /// Values that are not tried, because there are too many.
    pub left_out: Vec<i64>,
    /// Values of reals that are not tried, because there are too many.
    pub real_left_out: Vec<f32>,
}

impl Tried {
    /// Collects the values from the scripts and checks of a cell. `has_real`: whether a message from outside has a real
    /// field.
    pub(super) fn of(plan: &CellPlan, has_real: bool) -> Self {
        let mut whole = Candidates { all: vec![0, 1], near: vec![] };
        let mut real = Candidates { all: vec![0.0, 1.0], near: vec![] };
        for terms in expressions(plan) {
            for (at, term) in terms.iter().enumerate() {
                let Some(Term::Push(value)) = *term else { continue };
                match operator(&terms[at + 1..]) {
                    Some(Term::Real(operator)) => {
                        let Some(value) = as_real(value) else { continue };
                        real.all.push(value);
                        if is_by_order(operator) {
                            real.near.extend([value.next_down(), value.next_up()]);
                            // Scripts may compare a whole number with this real.
                            whole.near.extend([value.floor(), value.ceil()].map(nearest));
                        }
                    }
                    Some(Term::Int(operator)) => {
                        whole.all.push(value);
                        if is_by_order(operator) {
                            let (less, more) = (value.saturating_sub(1), value.saturating_add(1));
                            whole.near.extend([less, more]);
                            // Scripts may compare the constant with the whole part of a real, so the reals around it are
                            // tried, too.
                            real.near.extend([less, value, more].map(nearest_real));
                        }
                    }
                    // The script does not say the type of this constant. A number as large as this is taken for the bits of
                    // a real.
                    _ if (LEAST_BITS..=i64::from(u32::MAX)).contains(&value) => {
                        real.all.extend(as_real(value));
                    }
                    _ => whole.all.push(value),
                }
            }
        }
        let (whole, left_out) = whole.cut(|value| (value.unsigned_abs(), *value < 0));
        let mut tried = Self { whole, left_out, ..Self::default() };
        if has_real {
            // The bits of finite numbers, without the sign bit, sort like the numbers themselves.
            (tried.real, tried.real_left_out) = real.cut(|value| (value.abs().to_bits(), *value < 0.0));
        }
        tried
    }

    /// Whether no task outside the cell sends values.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.whole.is_empty()
    }

    /// The number of different messages to try: one if a message has no fields.
    pub(super) fn len(&self) -> usize {
        self.whole.len().max(self.real.len()).max(1)
    }

    /// The value of a field in the message with this number: the nearest value that the field's type has.
    pub(super) fn value(&self, of: Type, number: usize) -> i64 {
        let whole = self.whole.get(number).or(self.whole.last()).copied().unwrap_or(0);
        match of {
            Type::Bool => whole.clamp(0, 1),
            Type::Int8 => whole.clamp(i8::MIN.into(), i8::MAX.into()),
            Type::Int16 => whole.clamp(i16::MIN.into(), i16::MAX.into()),
            Type::Int32 => whole.clamp(i32::MIN.into(), i32::MAX.into()),
            Type::Word => whole.clamp(0, u32::MAX.into()),
            Type::Real => self.real.get(number).or(self.real.last()).copied().and_then(real).unwrap_or(0),
        }
    }
}

/// Collected constants, and the neighbours of the constants that are compared by order.
struct Candidates<T> {
    all: Vec<T>,
    near: Vec<T>,
}

impl<T: PartialEq + Copy> Candidates<T> {
    /// The values to try: first the constants, then their neighbours, both sorted by `order`. The second list has the
    /// values beyond the limit `MOST`.
    fn cut<K: Ord>(self, order: impl Fn(&T) -> K) -> (Vec<T>, Vec<T>) {
        let mut kept: Vec<T> = Vec::new();
        for mut some in [self.all, self.near] {
            some.sort_by_key(&order);
            for value in some {
                if !kept.contains(&value) {
                    kept.push(value);
                }
            }
        }
        let left_out = kept.split_off(MOST.min(kept.len()));
        (kept, left_out)
    }
}

/// The expressions of scripts and checks. `None` in an expression stands for an operation of a script that is not a
/// term.
fn expressions(plan: &CellPlan) -> impl Iterator<Item = Vec<Option<Term>>> {
    let term = |op: &Op| if let Op::Term(term) = op { Some(*term) } else { None };
    let bodies = plan.tasks.iter().filter_map(move |task| match task {
        Conduct::Program { program, .. } => Some(program.code.iter().map(term).collect()),
        Conduct::Extern(_) => None,
    });
    let checks = plan.checks.iter().flat_map(|check| match &check.holds {
        Holds::Always(terms) => vec![terms],
        Holds::Leads { when, then, .. } => vec![when, then],
    });
    bodies.chain(checks.map(|terms| terms.iter().copied().map(Some).collect()))
}

/// The bits of the least real that is not subnormal.
const LEAST_BITS: i64 = 1 << 23;

/// The finite real with these bits.
fn as_real(bits: i64) -> Option<f32> {
    u32::try_from(bits).ok().map(f32::from_bits).filter(|value| value.is_finite())
}

#[expect(clippy::cast_possible_truncation, reason = "a whole number, or one beyond all types")]
const fn nearest(value: f32) -> i64 {
    value as i64
}

#[expect(clippy::cast_precision_loss, reason = "the nearest real is meant")]
const fn nearest_real(value: i64) -> f32 {
    value as f32
}

/// The operator that takes a constant as an operand. In postfix order it is one of the next two terms after the
/// constant.
fn operator(behind: &[Option<Term>]) -> Option<Term> {
    let near = behind.iter().take(2).map_while(|term| *term);
    near.into_iter().find(|term| matches!(term, Term::Int(_) | Term::Real(_)))
}

const fn is_by_order(operator: Binary) -> bool {
    matches!(operator, Binary::Less | Binary::LessOrEqual | Binary::Greater | Binary::GreaterOrEqual)
}
