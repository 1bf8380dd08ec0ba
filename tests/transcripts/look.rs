//! Reads the part of the state that a step of a transcript shows.

use super::steps::Look;
use super::words::{Names, text};
use imrs_protocol::*;

/// Writes this part of the state as text.
pub fn look(look: Look, nodes: &[Node], table: &CellTable) -> Result<String, String> {
    let names = Names(table);
    let of = |task: TaskId| {
        let node = &nodes[table.location(task)?.index()];
        Some((node.task(task)?, &node.parts().table))
    };
    let port_of = |port: PortId, task: TaskId| {
        let (task, table) = of(task)?;
        task.view(table, usize::MAX).ports.into_iter().find(|view| view.port == port)
    };
    let not_there = "the task has no such port";
    Ok(match look {
        Look::Queue(port, task) => names.queue(&port_of(port, task).ok_or(not_there)?),
        Look::Counters(port, task) => names.counters(&port_of(port, task).ok_or(not_there)?.counters),
        Look::State(task) => names.state(&of(task).ok_or("the task runs nowhere")?.0.state()),
        Look::Transit(node) => names.transit(&nodes[node.index()].parts().transit.waiting()),
        Look::Answer(port, of_task, task) => {
            let (task, _) = of(task).ok_or("the task runs nowhere")?;
            answer(task, port, of_task).map_or_else(|| "no answer".into(), |said| text(&said))
        }
    })
}

/// All contents of the message that a signal delivered.
pub fn whole(task: &CommTask, signal: &Signal) -> Vec<u8> {
    match signal {
        Signal::Message(d) | Signal::Interrupt(Call::Message(d)) => {
            let parts = (0..d.fragments).filter_map(|i| task.fragment(i));
            parts.flat_map(|part| part.as_bytes().to_vec()).collect()
        }
        _ => Vec::new(),
    }
}

/// The answer of the task `of` to the last request that was sent through the port.
pub fn answer(task: &CommTask, port: PortId, of: TaskId) -> Option<Vec<u8>> {
    let parts = (0..16).map_while(|i| task.answer_fragment(port, of, i));
    let said: Vec<&Contents> = parts.collect();
    (!said.is_empty()).then(|| said.iter().flat_map(|part| part.as_bytes().to_vec()).collect())
}
