//! Finds dead variables: those that a script does not read before it writes them again. States that differ only in dead
//! variables are equal.
//!
//! This is the usual backward data-flow analysis over a program's operations, one bit for each variable. A handler may
//! interrupt the task's thread anywhere, so whatever a handler reads is live everywhere. The same holds for what a check
//! reads, and for what the task reads when it starts over and keeps its variables: after a take-over, or when its lease
//! came back (D61).

use crate::cell::plan::{CellPlan, Conduct, Holds};
use imrs_protocol::TaskId;
use imrs_protocol::script::{Address, Op, Program, Slot, Term};

/// For each operation of a program, the variables that are dead while the task's own thread waits in it, as a bit set.
#[derive(Clone, Debug, Default)]
pub(in crate::cell) struct Dead {
    at: Vec<u64>,
    /// The dead variables of a script that has ended.
    ended: u64,
}

impl Dead {
    /// The dead variables while the task's own thread waits in this operation. `None` stands for a script that has ended.
    pub fn at(&self, position: Option<Address>) -> u64 {
        position.map_or(self.ended, |at| self.at.get(usize::from(at)).copied().unwrap_or(0))
    }
}

/// The dead variables of each task.
pub(in crate::cell) fn dead(plan: &CellPlan) -> Vec<Dead> {
    let of = |(task, conduct): (usize, &Conduct)| match conduct {
        Conduct::Program { program, .. } => of_program(plan, TaskId::from_index(task), program),
        Conduct::Extern(_) => Dead::default(),
    };
    plan.tasks.iter().enumerate().map(of).collect()
}

fn of_program(plan: &CellPlan, task: TaskId, program: &Program) -> Dead {
    // Variables past the first 64 are never dead.
    let known = u64::MAX.checked_shr(64_u32.saturating_sub(count(program.variables.len()))).unwrap_or(0);
    let live = flow(program);
    let at = |address: Address| live.get(usize::from(address)).copied().unwrap_or(u64::MAX);
    let mut always = checked(plan, task);
    // A handler may itself be interrupted anywhere, so whatever handlers can read stays live.
    always |= program.handlers.iter().fold(0, |all, handler| all | reads_from(program, handler.entry));
    always |= program.takeover.map_or(0, at);
    let couples = &plan.table.cell().couples;
    if couples.iter().any(|couple| couple.primary == task || couple.standby == task) {
        always |= at(0);
    }
    Dead {
        at: live.iter().map(|live| known & !(live | always)).collect(),
        ended: known & !checked(plan, task),
    }
}

fn count(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

fn bit(variable: u16) -> u64 {
    1_u64.checked_shl(u32::from(variable)).unwrap_or(0)
}

/// The variables of a task that checks read, as a bit set.
fn checked(plan: &CellPlan, of: TaskId) -> u64 {
    let terms = plan.checks.iter().flat_map(|check| match &check.holds {
        Holds::Always(terms) => vec![terms],
        Holds::Leads { when, then, .. } => vec![when, then],
    });
    terms.flatten().fold(0, |all, term| match *term {
        Term::Of { task, variable } if task == of => all | bit(variable),
        _ => all,
    })
}

/// The variables that an operation reads, and those that it writes.
fn uses(program: &Program, op: Op) -> (u64, u64) {
    let of = |slot: Slot| match slot {
        Slot::Task(variable) => bit(variable),
        Slot::Local(_) => 0,
    };
    match op {
        Op::Term(Term::Load(slot)) => (of(slot), 0),
        Op::Store(slot) => (0, of(slot)),
        Op::Unpack { format, into } => {
            let fields = program.formats.get(usize::from(format)).map_or(0, |format| format.fields.len());
            let places = program.places.iter().skip(usize::from(into)).take(fields);
            (0, places.fold(0, |all, &slot| all | of(slot)))
        }
        _ => (0, 0),
    }
}

/// The operations that may follow an operation.
fn next(program: &Program, at: usize) -> [Option<usize>; 2] {
    let after = Some(at + 1);
    match program.code[at] {
        Op::Jump(to) => [Some(to.into()), None],
        Op::Unless(to) | Op::On { to, .. } => [Some(to.into()), after],
        Op::Abort(_) | Op::End | Op::HandlerEnd => [None, None],
        _ => [after, None],
    }
}

/// For each operation, its live variables: those that may be read from there on before they are written.
fn flow(program: &Program) -> Vec<u64> {
    let mut live = vec![0_u64; program.code.len()];
    loop {
        let mut grown = false;
        for at in (0..program.code.len()).rev() {
            let (reads, writes) = uses(program, program.code[at]);
            let on = next(program, at).into_iter().flatten();
            let later = on.fold(0, |all, next| all | live.get(next).copied().unwrap_or(0));
            let here = reads | (later & !writes);
            grown |= here != live[at];
            live[at] = here;
        }
        if !grown {
            return live;
        }
    }
}

/// Every variable that the code from an entry on can read.
fn reads_from(program: &Program, entry: Address) -> u64 {
    let mut seen = vec![false; program.code.len()];
    let mut open = vec![usize::from(entry)];
    let mut reads = 0;
    while let Some(at) = open.pop() {
        let Some(seen) = seen.get_mut(at).filter(|seen| !**seen) else { continue };
        *seen = true;
        reads |= uses(program, program.code[at]).0;
        open.extend(next(program, at).into_iter().flatten());
    }
    reads
}
