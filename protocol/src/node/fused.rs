//! Fused steps within a node: which two tasks a request concerns. `task/fused.rs` says what they do.

use super::{Node, NodeOutbox, Parts};
use crate::ids::{PortId, TaskId};
use crate::mapping;
use crate::request::{Request, Target};
use crate::table::Ends;
use crate::task::CommTask;

impl Node {
    /// Takes a request as one fused step with the other task that it concerns (D176); [`step`](Self::step) does so by itself.
    /// False, and nothing has changed, if anything about it is unusual.
    pub fn fuse(&mut self, task: TaskId, request: &Request, out: &mut impl NodeOutbox) -> bool {
        match *request {
            Request::Send { port, to, contents, time_out } => self
                .pair(task, port, to)
                .is_some_and(|(own, other, ends)| own.send_fused(other, ends, (contents, time_out), out)),
            Request::Reply { to, contents } => self
                .pair(task, to.port, Target::One(to.source))
                .is_some_and(|(own, other, ends)| own.reply_fused(other, ends, (to, contents), out)),
            _ => false,
        }
    }

    /// A task of this node, the only other task to which it addresses a message, if that runs here too, and their port.
    #[inline(always)]
    fn pair(
        &mut self,
        task: TaskId,
        port: PortId,
        to: Target,
    ) -> Option<(&mut CommTask, &mut CommTask, Ends<'_>)> {
        let Parts { table, tasks, .. } = &mut self.parts;
        let (port, own) = mapping::own_end(table, port, task).ok()?;
        let peer = mapping::only_peer(own, to).filter(|_| table.is_decided())?;
        let pair = [table.place(task)?, table.place(peer.task)?];
        let [this, other] = tasks.get_disjoint_mut(pair).ok()?;
        Some((this, other, Ends { port, own, peer }))
    }
}
