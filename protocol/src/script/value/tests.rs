//! Tests of values and expressions.

use super::*;
use Binary::{Add, And, Divide, Less, Multiply, Or, Remainder, Subtract};

fn value(terms: &[Term]) -> Result<i64, ScriptFault> {
    eval(terms, |_| None)
}

fn int(operator: Binary, a: i64, b: i64) -> Result<i64, ScriptFault> {
    value(&[Term::Push(a), Term::Push(b), Term::Int(operator)])
}

fn of_reals(operator: Binary, a: f32, b: f32) -> Result<i64, ScriptFault> {
    value(&[Term::Push(real(a).unwrap()), Term::Push(real(b).unwrap()), Term::Real(operator)])
}

#[test]
fn integers_never_wrap() {
    assert_eq!(int(Add, 2, 3), Ok(5));
    assert_eq!(int(Subtract, 2, 3), Ok(-1));
    assert_eq!(int(Multiply, -2, 3), Ok(-6));
    assert_eq!(int(Divide, -7, 2), Ok(-3));
    assert_eq!(int(Remainder, -7, 2), Ok(-1));
    for (operator, a, b) in
        [(Add, i64::MAX, 1), (Subtract, i64::MIN, 1), (Multiply, i64::MAX, 2), (Divide, i64::MIN, -1)]
    {
        assert_eq!(int(operator, a, b), Err(ScriptFault::Overflow));
    }
    assert_eq!(int(Divide, 1, 0), Err(ScriptFault::DivisionByZero));
    assert_eq!(int(Remainder, 1, 0), Err(ScriptFault::DivisionByZero));
    assert_eq!(value(&[Term::Push(i64::MIN), Term::Negate]), Err(ScriptFault::Overflow));
}

#[test]
fn comparisons_and_connectives_give_truth_values() {
    let table = [
        (Binary::Less, [1, 0, 0]),
        (Binary::LessOrEqual, [1, 1, 0]),
        (Binary::Equal, [0, 1, 0]),
        (Binary::NotEqual, [1, 0, 1]),
        (Binary::GreaterOrEqual, [0, 1, 1]),
        (Binary::Greater, [0, 0, 1]),
    ];
    for (operator, expected) in table {
        for (pair, expected) in [(1, 2), (2, 2), (3, 2)].into_iter().zip(expected) {
            assert_eq!(int(operator, pair.0, pair.1), Ok(expected), "{operator:?} {pair:?}");
            let (a, b) = if pair.0 < 2 {
                (1.0, 2.0)
            } else if pair.0 == 2 {
                (2.0, 2.0)
            } else {
                (3.0, 2.0)
            };
            assert_eq!(of_reals(operator, a, b), Ok(expected), "{operator:?} {a} {b}");
        }
    }
    assert_eq!([int(And, 1, 0), int(And, 1, 1), int(Or, 0, 0), int(Or, 1, 0)], [Ok(0), Ok(1), Ok(0), Ok(1)]);
    assert_eq!(value(&[Term::Push(0), Term::Not]), Ok(1));
}

#[test]
fn reals_stay_finite_and_zero_has_no_sign() {
    assert_eq!(of_reals(Add, 0.5, 0.25), Ok(real(0.75).unwrap()));
    assert_eq!(of_reals(Subtract, 1.0, 1.0), Ok(0));
    assert_eq!(of_reals(Multiply, -0.0, 3.0), Ok(0));
    assert_eq!(of_reals(Divide, 1.0, 0.0), Err(ScriptFault::DivisionByZero));
    assert_eq!(of_reals(Multiply, f32::MAX, 2.0), Err(ScriptFault::NotFinite));
    for operator in [Remainder, And, Or] {
        assert_eq!(of_reals(operator, 1.0, 1.0), Err(ScriptFault::Malformed));
    }
    assert_eq!(value(&[Term::Push(0), Term::NegateReal]), Ok(0));
    assert_eq!(value(&[Term::Push(7), Term::ToReal, Term::ToInt]), Ok(7));
    assert_eq!(value(&[Term::Push(real(-2.9).unwrap()), Term::ToInt]), Ok(-2));
    assert_eq!(value(&[Term::Push(-1), Term::ToInt]), Err(ScriptFault::Malformed), "no real");
    assert_eq!(real(f32::NAN), None);
}

#[test]
fn an_expression_leaves_one_value() {
    assert_eq!(value(&[]), Err(ScriptFault::Malformed));
    assert_eq!(value(&[Term::Push(1), Term::Push(2)]), Err(ScriptFault::Malformed));
    assert_eq!(value(&[Term::Push(1), Term::Int(Add)]), Err(ScriptFault::Malformed));
    assert_eq!(value(&[Term::Push(1); CHECK_DEPTH + 1]), Err(ScriptFault::Malformed));
}

#[test]
fn checks_look_at_other_tasks_and_at_predicates() {
    // The expression of the check `never armL.moving and not lift.arrived(armR)`.
    let lift = Predicate::Arrived { port: PortId(0), task: TaskId(1) };
    let terms =
        [Term::Of { task: TaskId(0), variable: 3 }, Term::Is(lift), Term::Not, Term::Int(And), Term::Not];
    let holds = |moving, arrived| {
        eval(&terms, |term| match term {
            Term::Of { task: TaskId(0), variable: 3 } => Some(moving),
            Term::Is(predicate) if predicate == lift => Some(arrived),
            _ => None,
        })
    };
    assert_eq!([holds(0, 0), holds(1, 0), holds(1, 1)], [Ok(1), Ok(0), Ok(1)]);
    assert_eq!(eval(&terms, |_| None), Err(ScriptFault::Malformed));
    assert_eq!(int(Less, 1, 2), Ok(1));
}

#[test]
fn a_type_reads_what_it_wrote_and_nothing_else() {
    let values = [
        (Type::Bool, &[0, 1][..], &[2, -1][..]),
        (Type::Int8, &[-128, -1, 127], &[128, -129]),
        (Type::Int16, &[-32768, 300, 32767], &[32768, -32769]),
        (Type::Int32, &[i64::from(i32::MIN), -1, i64::from(i32::MAX)], &[1 << 31]),
        (Type::Word, &[0, (1 << 32) - 1], &[-1, 1 << 32]),
        (Type::Real, &[0, 0x3f80_0000, 0xbf80_0000], &[0x8000_0000, 0x7f80_0000, 0x7fc0_0000, -1]),
    ];
    for (of, good, bad) in values {
        for &value in good {
            let mut bytes = [0xaa; 4];
            of.write(value, &mut bytes).unwrap();
            assert_eq!((of.holds(value), of.read(&bytes)), (true, Some(value)), "{of:?}");
            assert_eq!(of.read(&bytes[..of.bytes() - 1]), None);
            assert_eq!(of.write(value, &mut bytes[..of.bytes() - 1]), None);
        }
        assert!(bad.iter().all(|&value| !of.holds(value)), "{of:?}");
    }
    assert_eq!(Type::Bool.read(&[2]), None);
    assert_eq!(Type::Real.read(&f32::NAN.to_le_bytes()), None);
}
