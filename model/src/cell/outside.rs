//! Programs for tasks whose body is outside the cell: any legal use of their ports, at most at the declared rate.

use super::plan::{CellPlan, Conduct};
use super::values::Tried;
use imrs_protocol::script::{
    Address, Binary, Format, Op, Outcomes, Program, Slot, StatementOutcome, Term, Trigger, Type, Variable,
};
use imrs_protocol::{Class, PortId, Rate, Target, TaskId, Ticks, Usage};
use std::sync::Arc;

/// The plan, with a program added for each task whose body is outside the cell.
pub(super) fn with_programs(plan: &Arc<CellPlan>) -> Arc<CellPlan> {
    if !plan.has_extern() {
        return Arc::clone(plan);
    }
    let (mut whole, values) = ((**plan).clone(), tried(plan));
    for (task, conduct) in whole.tasks.iter_mut().enumerate() {
        if let Conduct::Extern(rate) = *conduct {
            let program = Arc::new(any_use(plan, TaskId::from_index(task), rate, &values));
            whole.outside.push(task);
            *conduct = Conduct::Program { program, values: Vec::new(), open: false };
        }
    }
    Arc::new(whole)
}

/// A program that again and again chooses one use of its ports, or none.
///
/// A task of a work couple uses its ports with and without its lease. After a take-over it starts over. When it loses its
/// lease, it gives up its present use and does nothing until the lease comes back.
fn any_use(plan: &CellPlan, task: TaskId, rate: Option<Rate>, values: &Tried) -> Program {
    let table = &plan.table;
    let pause = Ticks(rate.map_or(1, |rate| rate.per.0.div_ceil(u64::from(rate.count).max(1))).max(1));
    let mut program = Program {
        name: table.cell().tasks[task.index()].name.clone(),
        variables: vec![Variable { name: "does".into(), of: Type::Int16, initial: 0 }],
        ..Program::default()
    };
    let mut uses: Vec<Vec<Op>> = Vec::new();
    let couples: Vec<_> = table
        .cell()
        .couples
        .iter()
        .filter(|couple| [couple.primary, couple.standby].contains(&task))
        .collect();
    // The protocol itself sends heartbeats: no task uses their port.
    let carries_heartbeats = |port: PortId| couples.iter().any(|couple| couple.via == port);
    for &port in table.ports_of(task).iter().filter(|&&port| !carries_heartbeats(port)) {
        for to in targets(plan, task, port) {
            for number in 0..values.len() {
                let value = |of: Type| values.value(of, number);
                let Some(once) = once(plan, task, (port, to), &value, pause, &mut program) else { break };
                // If the messages of a port have no fields, its uses are equal for all values, and are added once.
                if !uses.contains(&once) {
                    uses.push(once);
                }
            }
        }
    }
    program.takeover = (!couples.is_empty()).then_some(0);
    let count = u16::try_from(uses.len() + 1).unwrap_or(u16::MAX);
    program.code = vec![Op::Statement, Op::Choose(count), Op::Store(Slot::Task(0))];
    for (number, body) in (0_i64..).zip(uses) {
        let load = Op::Term(Term::Load(Slot::Task(0)));
        program.code.extend([load, Op::Term(Term::Push(number)), Op::Term(Term::Int(Binary::Equal))]);
        // The branch skips four things: itself, the two operations that reset the choice, the body, and the jump back.
        let beyond = address(program.code.len() + 1 + 2 + body.len() + 1);
        program.code.push(Op::Unless(beyond));
        forget(&mut program.code);
        let start = address(program.code.len());
        program.code.extend(body.into_iter().map(|op| moved(op, start)));
        program.code.push(Op::Jump(0));
    }
    forget(&mut program.code);
    program.code.extend([Op::Delay(pause), Op::Jump(0)]);
    program
}

fn address(at: usize) -> Address {
    Address::try_from(at).unwrap_or(Address::MAX)
}

/// Relocates a jump of a body, whose target is relative to the start of the body.
const fn moved(op: Op, start: Address) -> Op {
    match op {
        Op::On { outcomes, to } => Op::On { outcomes, to: to.saturating_add(start) },
        Op::Jump(to) => Op::Jump(to.saturating_add(start)),
        other => other,
    }
}

fn forget(code: &mut Vec<Op>) {
    code.extend([Op::Term(Term::Push(0)), Op::Store(Slot::Task(0))]);
}

/// The values for messages of tasks outside the cell; empty if these messages have no fields that a program reads.
pub(super) fn tried(plan: &CellPlan) -> Tried {
    let outside = |task: &usize| matches!(plan.tasks[*task], Conduct::Extern(_));
    let ports =
        (0..plan.tasks.len()).filter(outside).flat_map(|task| plan.table.ports_of(TaskId::from_index(task)));
    let fields: Vec<Type> = ports
        .flat_map(|&port| [message(plan, port), answer(plan, port)])
        .flat_map(|format| format.fields)
        .collect();
    if fields.is_empty() { Tried::default() } else { Tried::of(plan, fields.contains(&Type::Real)) }
}

/// The possible receivers of a message: all peers of the port together, or each of them alone.
fn targets(plan: &CellPlan, task: TaskId, port: PortId) -> Vec<Target> {
    let peers: Vec<TaskId> = plan.table.port(port).map_or_else(Vec::new, |port| port.peers(task).collect());
    let alone = peers.iter().filter(|_| peers.len() > 1).map(|&peer| Target::One(peer));
    std::iter::once(Target::All).chain(alone).collect()
}

/// The operations of one statement that uses a port. `value` gives the value of each field by its type.
fn once(
    plan: &CellPlan,
    task: TaskId,
    (port, to): (PortId, Target),
    value: &dyn Fn(Type) -> i64,
    pause: Ticks,
    program: &mut Program,
) -> Option<Vec<Op>> {
    let declared = plan.table.port(port)?;
    let party = declared.party(task)?;
    let is_command = declared.decl.class == Class::Command;
    let mut format = |of: Format| {
        let known = program.formats.iter().position(|format| *format == of);
        let at = known.unwrap_or_else(|| {
            program.formats.push(of);
            program.formats.len() - 1
        });
        u16::try_from(at).unwrap_or(u16::MAX)
    };
    let values =
        |of: &Format| -> Vec<Op> { of.fields.iter().map(|&of| Op::Term(Term::Push(value(of)))).collect() };
    Some(match party.usage {
        Usage::Send | Usage::Query => {
            let message = message(plan, port);
            let mut body = values(&message);
            let format = format(message);
            body.extend([Op::Send { port, to, format, time_out: None }, Op::Delay(pause)]);
            body
        }
        Usage::Receive | Usage::Response => {
            let mut body = vec![Op::Get { port: Some(port), source: None, time_out: Some(pause) }];
            if is_command {
                let answer = answer(plan, port);
                let skip = Op::On {
                    outcomes: Outcomes::of(&[StatementOutcome::Nothing]),
                    to: address(body.len() + answer.fields.len() + 2),
                };
                body.push(skip);
                body.extend(values(&answer));
                body.push(Op::Reply { format: format(answer) });
            }
            body
        }
        Usage::Waitfor => {
            let message = message(plan, port);
            let mut body = values(&message);
            body.extend([Op::Arrive { port, format: format(message), time_out: None }, Op::Delay(pause)]);
            body
        }
        Usage::Reply => return None,
    })
}

fn programs(plan: &CellPlan) -> impl Iterator<Item = &Program> {
    plan.tasks.iter().filter_map(|task| match task {
        Conduct::Program { program, .. } => Some(&**program),
        Conduct::Extern(_) => None,
    })
}

/// The format of a port's messages, as some program sends or reads them.
fn message(plan: &CellPlan, port: PortId) -> Format {
    let find = |program: &Program| {
        let sent = program.code.iter().find_map(|op| match *op {
            Op::Send { port: at, format, .. } | Op::Arrive { port: at, format, .. } if at == port => {
                Some(format)
            }
            _ => None,
        });
        let handlers = program.handlers.iter().filter(|handler| handler.trigger == Trigger::Message(port));
        let got = positions(program, |op| matches!(op, Op::Get { port: Some(at), .. } if *at == port));
        let mut from = handlers.map(|handler| usize::from(handler.entry)).chain(got);
        let read = from.find_map(|from| next(program, from, unpacked));
        sent.or(read).and_then(|format| program.formats.get(usize::from(format)).cloned())
    };
    programs(plan).find_map(find).unwrap_or_default()
}

/// The format of a port's answers, as some program reads them.
fn answer(plan: &CellPlan, port: PortId) -> Format {
    let find = |program: &Program| {
        // Some statements that send do not read the answer, so all of them are examined.
        let mut asked = positions(program, |op| matches!(op, Op::Send { port: at, .. } if *at == port));
        let read = asked.find_map(|asked| next(program, asked, unpacked))?;
        program.formats.get(usize::from(read)).cloned()
    };
    programs(plan).find_map(find).unwrap_or_default()
}

/// The positions of all operations that satisfy `is`.
fn positions(program: &Program, is: impl Fn(&Op) -> bool) -> impl Iterator<Item = usize> {
    program.code.iter().enumerate().filter(move |(_, op)| is(op)).map(|(at, _)| at)
}

const fn unpacked(op: &Op) -> Option<u16> {
    match op {
        Op::Unpack { format, .. } => Some(*format),
        _ => None,
    }
}

/// The first value that `is` returns for an operation after `from`, before the next request.
fn next(program: &Program, from: usize, is: impl Fn(&Op) -> Option<u16>) -> Option<u16> {
    let after = program.code.iter().skip(from + 1);
    after.take_while(|op| !matches!(op, Op::Send { .. } | Op::Get { .. } | Op::Run { .. })).find_map(is)
}
