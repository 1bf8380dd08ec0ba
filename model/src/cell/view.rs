//! Describes in words what a task does at a point of a path.

use super::judge::{name, position, statement};
use super::plan::Conduct;
use super::run_state::RunState;
use super::verdict::TaskView;
use imrs_protocol::script::Activity;
use imrs_protocol::{TaskId, Ticks};

/// The view of a task in the present state.
pub(super) fn view(run_state: &RunState, task: usize) -> TaskView {
    let plan = &run_state.plan;
    let outside = !plan.has_task(task);
    let up = run_state.is_up(task) || outside;
    let at = position(run_state, task);
    let node_state = &run_state.cell.nodes[run_state.cell.node_state_of(task)];
    let machine = node_state.node.task(TaskId::from_index(task)).filter(|_| up);
    let queues = machine.map_or_else(Vec::new, |machine| {
        let ports = machine.view(&node_state.table, 0).ports;
        ports.iter().map(|port| (port.port, port.len)).collect()
    });
    let actor = run_state.cell.bodies[task].actor.as_ref();
    let what = |at| match &plan.tasks[task] {
        Conduct::Program { program, .. } => statement(&plan.table, program, at),
        Conduct::Extern(_) => name(&plan.table, task).into(),
    };
    let does = match run_state.activity(task) {
        _ if outside => "is not looked at: it is in another part of the cell".into(),
        _ if !up => "is down".into(),
        _ if run_state.is_asleep(run_state.cell.node_state_of(task)) => {
            format!("is paused: {}", what(at))
        }
        None | Some(Activity::NotBegun) => "has not begun".into(),
        Some(Activity::Waits) => format!("waits: {}", what(at)),
        Some(Activity::Acts) => what(at),
        Some(Activity::Chooses(_)) => "chooses".into(),
        Some(Activity::Passive) => "is passive".into(),
        Some(Activity::Ended(_)) => "has ended".into(),
    };
    let variables = actor.map_or_else(Vec::new, |actor| {
        (0..).map_while(|at| actor.host.script.var(at)).take(actor.host.program.variables.len()).collect()
    });
    let acts = actor.map_or_else(Vec::new, |actor| {
        let ticks = |length: Ticks| u32::try_from(length.0).unwrap_or(u32::MAX);
        let acts = actor.running.iter();
        acts.map(|running| (running.level, ticks(running.least), ticks(running.most))).collect()
    });
    TaskView { up, at, does, variables, queues, acts }
}
