//! The times in a server that depend on a route: the way back that the deadlines of waiting commands reserve (D18, D184).
//!
//! Dedup entries, windows and epoch guards need no change, although their ends include a link delay, too. A copy that
//! arrives in time arrives before its sender's deadline, because each link on any route charges no less than its delay
//! (D20). When the first copy arrives, that deadline is at most the declared time_out away, and the entry is kept for
//! longer. The execution budget of a command that the task has already taken stays as it was promised: an answer without
//! enough time for the new route is dropped.

use super::Server;
use crate::packet::Class;
use crate::table::CellTable;
use crate::task::own::Own;
use crate::ticks::Instant;

impl Server {
    /// Lets each waiting command expire as soon as its answer could not arrive in time by the routes of `table`, which
    /// replace those of `former`. The caller drops the commands that have expired.
    pub fn reroute(&mut self, own: &Own, former: &CellTable, table: &CellTable) {
        if !table.cell().rules.reserve_way_back {
            return;
        }
        for inbox in &mut self.inboxes {
            let ports = [former, table].map(|table| table.port(inbox.port));
            let ends = ports.map(|port| Some((port?, port?.party(own.task)?)));
            let [Some((port, old)), Some((_, new))] = ends else { continue };
            if port.decl.class == Class::Status || old.peers == new.peers {
                continue;
            }
            let reserve = |expires: &mut Instant, source: usize| {
                if *expires != Instant::NEVER {
                    *expires = *expires + old.peers[source].bound - new.peers[source].bound;
                }
            };
            inbox.queue.change_all(|held, _| {
                if let Some(peer) = new.peer(held.source) {
                    reserve(&mut held.expires, peer.slot.into());
                }
            });
            let assemblies = inbox.long.iter_mut().flat_map(|long| &mut long.assemblies).enumerate();
            assemblies
                .filter(|(_, open)| open.is_open())
                .for_each(|(at, open)| reserve(&mut open.expires, at));
        }
        self.touch_all(own);
    }
}
