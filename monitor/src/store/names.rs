//! The names in a cell's table, escaped for the terminal.

use crate::name::Name;
use imrs_protocol::{Class, NodeId, PortId, TaskId, Ticks, Usage};
use imrs_wire::obs::{LinkName, PartyName, Table};

/// A task of the cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskInfo {
    /// The name of the task.
    pub name: Name,
    /// The node on which it runs.
    pub node: NodeId,
}

/// A port of the cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortInfo {
    /// The name of the port.
    pub name: Name,
    /// The class of the port's messages.
    pub class: Class,
    /// The value of `bounded_buffer`: how many messages the port's buffer holds.
    pub capacity: u16,
    /// The margin, if the port is a `waitfor`.
    pub margin: Ticks,
    /// The tasks that have the port: the owner first, then the users.
    pub parties: Vec<PartyName>,
}

impl PortInfo {
    /// Whether the port is a rendezvous.
    #[must_use]
    pub fn is_waitfor(&self) -> bool {
        self.parties.first().is_some_and(|party| party.usage == Usage::Waitfor)
    }

    /// The time_out of `task` on this port: the TTL of a new message.
    #[must_use]
    pub fn time_out(&self, task: TaskId) -> Option<Ticks> {
        self.parties.iter().find(|p| p.task == task).map(|p| p.time_out)
    }
}

/// The names of a cell. Node data is untrusted, so an unknown id gets a placeholder name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Names {
    /// The name of the cell.
    pub cell: Name,
    /// The tick of the cell: the declared lateness of timers, in ticks of the nodes.
    pub tick: Ticks,
    /// The names of the nodes.
    pub nodes: Vec<Name>,
    /// The links of the cell.
    pub links: Vec<LinkName>,
    /// The tasks of the cell.
    pub tasks: Vec<TaskInfo>,
    /// The ports of the cell.
    pub ports: Vec<PortInfo>,
    /// The ports that are a rendezvous, ascending, so that callers need not search all ports.
    pub meetings: Vec<PortId>,
}

impl Names {
    /// Escapes the names in `table`.
    #[must_use]
    pub fn new(table: Table) -> Self {
        let port = |p: imrs_wire::obs::PortName| PortInfo {
            name: Name::new(&p.name),
            class: p.class,
            capacity: p.capacity,
            margin: p.margin,
            parties: p.parties,
        };
        let ports: Vec<PortInfo> = table.ports.into_iter().map(port).collect();
        Self {
            cell: Name::new(&table.cell),
            tick: table.tick,
            nodes: table.nodes.iter().map(|n| Name::new(&n.name)).collect(),
            links: table.links,
            tasks: table.tasks.iter().map(|t| TaskInfo { name: Name::new(&t.name), node: t.node }).collect(),
            meetings: (0..ports.len()).filter(|&i| ports[i].is_waitfor()).map(PortId::from_index).collect(),
            ports,
        }
    }

    /// Names for a cell whose table has not arrived yet.
    #[must_use]
    pub fn unknown(cell: &str) -> Self {
        Self::new(Table { cell: cell.to_owned(), ..Table::default() })
    }

    /// The name of a node.
    #[must_use]
    pub fn node(&self, id: NodeId) -> Name {
        self.nodes.get(id.index()).cloned().unwrap_or_else(|| Name::new(&format!("{id}?")))
    }

    /// The name of a task.
    #[must_use]
    pub fn task(&self, id: TaskId) -> Name {
        self.tasks.get(id.index()).map_or_else(|| Name::new(&format!("{id}?")), |t| t.name.clone())
    }

    /// The node on which a task runs.
    #[must_use]
    pub fn home(&self, id: TaskId) -> Option<NodeId> {
        self.tasks.get(id.index()).map(|t| t.node)
    }

    /// A port; `None` if the cell does not have it.
    #[must_use]
    pub fn port(&self, id: PortId) -> Option<&PortInfo> {
        self.ports.get(id.index())
    }

    /// The name of a port.
    #[must_use]
    pub fn port_name(&self, id: PortId) -> Name {
        self.port(id).map_or_else(|| Name::new(&format!("{id}?")), |p| p.name.clone())
    }
}
