//! Fused steps within a node: which two tasks a request concerns. `task/fused.rs` says what they do.

use super::{Node, NodeOutbox, Parts};
use crate::ids::TaskId;
use crate::mapping;
use crate::request::Request;

impl Node {
    /// Takes a request as one fused step with the other task that it concerns (D176); [`step`](Self::step) does so by itself.
    /// False, and nothing has changed, if anything about it is unusual.
    pub fn fuse(&mut self, task: TaskId, request: &Request, out: &mut impl NodeOutbox) -> bool {
        let Self { parts: Parts { table, tasks, .. }, places, .. } = self;
        let other = match *request {
            Request::Send { port, to, .. } => {
                table.port(port).and_then(|port| mapping::only_peer(port, task, to))
            }
            Request::Reply { to, .. } => Some(to.source),
            _ => None,
        };
        let place = |task: TaskId| places.get(task.index()).map(|&place| usize::from(place));
        let Some(pair) = place(task).zip(other.and_then(place)).filter(|_| table.is_decided()) else {
            return false;
        };
        let Ok([own, other]) = tasks.get_disjoint_mut([pair.0, pair.1]) else { return false };
        match *request {
            Request::Send { port, contents, time_out, .. } => {
                own.send_fused(other, table, (port, contents, time_out), out)
            }
            Request::Reply { to, contents } => own.reply_fused(other, table, (to, contents), out),
            _ => false,
        }
    }
}
