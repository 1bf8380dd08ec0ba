//! Lowers actions: their types, and the results that a checker should try.

use super::{Action, Behaviour};
use crate::hir::{CheckKind, Destination, Expr, Hir};
use imrs_protocol::TaskId;
use imrs_protocol::script::{Binary, Op, Program, ProgramBuilder, Slot, Term, Type, real};

/// One statement that runs an action.
struct Use {
    name: String,
    action: u16,
    arguments: Vec<Type>,
    into: Option<Destination>,
    range: Option<(i64, i64)>,
}

/// All statements of a task that run actions.
#[derive(Default)]
pub(super) struct Uses(Vec<Use>);

impl Action {
    /// Whether every possible result has the same effect as one of [`values`](Self::values).
    #[must_use]
    pub fn is_covered(&self) -> bool {
        let all = || {
            let (low, high) = self.range.filter(|_| self.result != Some(Type::Real))?;
            Some(i64::try_from(self.values.len()) == Ok(high.checked_sub(low)?.checked_add(1)?))
        };
        matches!(self.result, None | Some(Type::Bool)) || !self.travels || all() == Some(true)
    }
}

impl Uses {
    /// Records a statement and returns the number of its action. If another statement runs the action with another result
    /// type or range, the same name gets another number, because a result may be allowed in one of the statements and
    /// forbidden in the other.
    pub fn add(
        &mut self,
        builder: &mut ProgramBuilder,
        name: &str,
        arguments: &[Expr],
        into: Option<Destination>,
        range: Option<(i64, i64)>,
    ) -> u16 {
        let of = into.map(|to| to.of);
        let known = self
            .0
            .iter()
            .find(|one| one.name == name && (one.into.map(|to| to.of), one.range) == (of, range));
        let action = known.map_or_else(|| builder.another_action(name), |one| one.action);
        let arguments = arguments.iter().map(|argument| argument.of).collect();
        self.0.push(Use { name: name.into(), action, arguments, into, range });
        action
    }

    /// The actions of the program, in the order of their numbers.
    pub fn actions(&self, hir: &Hir, task: TaskId, program: &Program) -> Vec<Action> {
        let named = (0..).zip(&program.actions);
        named.map(|(at, name): (u16, _)| self.action(at, name, hir, task, program)).collect()
    }

    fn action(&self, at: u16, name: &str, hir: &Hir, task: TaskId, program: &Program) -> Action {
        let mut action = Action {
            name: name.into(),
            arguments: Vec::new(),
            result: None,
            range: None,
            travels: false,
            values: Vec::new(),
        };
        let mut compared = Vec::new();
        for one in self.0.iter().filter(|one| one.action == at) {
            action.arguments.clone_from(&one.arguments);
            let Some(to) = one.into else { continue };
            (action.result, action.range) = (Some(to.of), one.range);
            let terms: Vec<Option<Term>> = program.code.iter().map(term).collect();
            both_sides(&terms, |term| term == Term::Load(to.slot), to.of == Type::Real, &mut compared);
            action.travels |= goes_elsewhere(&terms, |term| term == Term::Load(to.slot));
            for check in exprs(hir) {
                let terms: Vec<Option<Term>> = check.ops.iter().map(term).collect();
                let is = |term| matches!((term, to.slot), (Term::Of { task: t, variable }, Slot::Task(at)) if t == task && variable == at);
                both_sides(&terms, is, to.of == Type::Real, &mut compared);
                action.travels |= goes_elsewhere(&terms, is);
            }
        }
        action.values = compared;
        action.values = values(&action);
        action
    }
}

const fn term(op: &Op) -> Option<Term> {
    match op {
        Op::Term(term) => Some(*term),
        _ => None,
    }
}

/// All expressions of checks.
fn exprs(hir: &Hir) -> impl Iterator<Item = &Expr> {
    hir.checks.iter().flat_map(|check| match &check.kind {
        CheckKind::Always(expr) | CheckKind::Never(expr) => vec![expr],
        CheckKind::Leads { when, then, .. } => vec![when, then],
    })
}

/// Adds the values on both sides of each constant with which the variable is compared. If the constant is a real, the
/// values are the bits of the next smaller and the next greater real, as a driver returns them.
fn both_sides(terms: &[Option<Term>], is: impl Fn(Term) -> bool, reals: bool, into: &mut Vec<i64>) {
    for window in terms.windows(3) {
        let &[Some(a), Some(b), Some(operator)] = window else { continue };
        let (constant, swapped) = match (a, b) {
            (variable, Term::Push(constant)) if is(variable) => (constant, false),
            (Term::Push(constant), variable) if is(variable) => (constant, true),
            _ => continue,
        };
        let comparison = match operator {
            Term::Int(comparison) if !reals => comparison,
            Term::Real(comparison) if reals => comparison,
            _ => continue,
        };
        // `x > c` and `x <= c` change between c and c + 1, `x < c` and `x >= c` between c - 1 and c, `x = c` changes at
        // both.
        let (below, above) = match comparison {
            Binary::Greater | Binary::LessOrEqual => (swapped, !swapped),
            Binary::Less | Binary::GreaterOrEqual => (!swapped, swapped),
            Binary::Equal | Binary::NotEqual => (true, true),
            Binary::Add
            | Binary::Subtract
            | Binary::Multiply
            | Binary::Divide
            | Binary::Remainder
            | Binary::And
            | Binary::Or => continue,
        };
        if reals {
            let constant = f32::from_bits(u32::try_from(constant).unwrap_or(0));
            into.push(bits(constant));
            into.extend(below.then(|| bits(constant.next_down())));
            into.extend(above.then(|| bits(constant.next_up())));
            continue;
        }
        into.push(constant);
        into.extend(below.then(|| constant.saturating_sub(1)));
        into.extend(above.then(|| constant.saturating_add(1)));
    }
}

/// The value that a driver returns for a real: its bits, as a signed number. Scripts have a single zero, and no infinity.
fn bits(x: f32) -> i64 {
    let bits = real(x).and_then(|bits| u32::try_from(bits).ok()).unwrap_or(0);
    i64::from(bits.cast_signed())
}

/// The real for which a driver returns this value.
fn given(value: i64) -> Option<f32> {
    let x = f32::from_bits(i32::try_from(value).ok()?.cast_unsigned());
    x.is_finite().then_some(x)
}

/// Whether a variable is read outside of comparisons with constants.
fn goes_elsewhere(terms: &[Option<Term>], is: impl Fn(Term) -> bool) -> bool {
    let compares = |window: &[Option<Term>]| {
        let mut into = Vec::new();
        [false, true].into_iter().for_each(|reals| both_sides(window, &is, reals, &mut into));
        !into.is_empty()
    };
    let read = (0..terms.len()).filter(|&at| terms[at].is_some_and(&is));
    read.into_iter().any(|at| {
        let (ahead, behind) =
            (terms.get(at..at + 3), at.checked_sub(1).and_then(|from| terms.get(from..from + 3)));
        !ahead.is_some_and(compares) && !behind.is_some_and(compares)
    })
}

/// The greatest number of values from comparisons of other tasks and checks that are added.
const MOST: usize = 16;

/// If an action's result is read outside of comparisons with constants, adds more values for the checker to try: every
/// constant with which any task or check of the cell compares something.
pub(super) fn try_what_others_compare(hir: &Hir, tasks: &mut [Behaviour]) {
    let any = |term| matches!(term, Term::Load(_) | Term::Of { .. });
    let [wholes, reals] = [false, true].map(|reals| {
        let mut all = Vec::new();
        for task in &*tasks {
            let Behaviour::Script(script) = task else { continue };
            both_sides(&script.program.code.iter().map(term).collect::<Vec<_>>(), any, reals, &mut all);
        }
        for check in exprs(hir) {
            both_sides(&check.ops.iter().map(term).collect::<Vec<_>>(), any, reals, &mut all);
        }
        all.sort_unstable();
        all.dedup();
        all.truncate(MOST);
        all
    });
    for task in tasks {
        let Behaviour::Script(script) = task else { continue };
        let travel =
            script.actions.iter_mut().filter(|action| action.travels && action.result != Some(Type::Bool));
        for action in travel {
            action.values.extend(if action.result == Some(Type::Real) { &reals } else { &wholes });
            action.values = values(action);
        }
    }
}

/// The values that the result's type and range allow, sorted.
fn values(action: &Action) -> Vec<i64> {
    let Some(of) = action.result else { return Vec::new() };
    let mut values = action.values.clone();
    if of == Type::Real {
        #[expect(clippy::cast_precision_loss, reason = "the nearest real is meant")]
        let range = action.range.map(|(low, high)| (low as f32, high as f32));
        values.extend(range.map_or_else(|| vec![bits(0.0)], |(low, high)| vec![bits(low), bits(high)]));
        values.retain(|&value| {
            given(value).is_some_and(|x| range.is_none_or(|(low, high)| (low..=high).contains(&x)))
        });
    } else {
        match (of, action.range) {
            (Type::Bool, _) => values = vec![0, 1],
            (_, Some((low, high))) => values.extend([low, high]),
            (_, None) if values.is_empty() => values.push(0),
            (_, None) => {}
        }
        values.retain(|&value| {
            // A driver returns only values of signed 32 bits.
            let comes = i32::try_from(value).is_ok();
            of.holds(value) && comes && action.range.is_none_or(|(low, high)| (low..=high).contains(&value))
        });
    }
    values.sort_unstable();
    values.dedup();
    values
}
