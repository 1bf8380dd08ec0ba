//! The launcher during a run: it takes the messages of the nodes and injects the faults at their times.

use super::{Launcher, WITHOUT_END};
use crate::children::Message;
use crate::clock::now_us;
use crate::error::LaunchError;
use crate::fact::Fact;
use crate::faults::Fault;
use crate::noticed::Noticed;
use crate::pipe::{Order, Word};
use crate::run::Moment;
use crate::script_event::{Did, ScriptEvent};
use crate::setups::record_file;
use imrs_protocol::NodeId;
use std::time::{Duration, Instant};

impl Launcher<'_> {
    /// Does the work that is due now: injects faults, and judges the checks. Returns false if the run is over.
    pub fn advance(&mut self) -> Result<bool, LaunchError> {
        for message in std::mem::take(&mut self.early) {
            self.take(message);
        }
        let now = self.elapsed();
        if self.interrupts.count() > 0 || self.is_over() || now >= self.length() {
            return Ok(false);
        }
        while self.faults.first().is_some_and(|(at, _)| *at <= now) {
            let (_, fault) = self.faults.remove(0);
            self.carry_out(fault)?;
        }
        self.hear_of_commands();
        self.log.judge();
        Ok(true)
    }

    /// Waits for the next message of a node and takes it. Waits at most until `until`, the next fault or the end of the run.
    pub fn wait(&mut self, until: Instant) {
        let length = self.length();
        let next = self.faults.first().map_or(length, |(at, _)| *at).min(length);
        let until = (self.started + next).min(until);
        // The launcher itself holds a sender, so an error means that no message came in time.
        if let Ok(message) = self.messages.recv_timeout(until.saturating_duration_since(Instant::now())) {
            self.take(message);
        }
    }

    fn length(&self) -> Duration {
        self.run.length.unwrap_or(WITHOUT_END)
    }

    /// Whether nothing can happen any more: for every task, the script has ended or the node is gone for good. With
    /// `until_idle` the run is also over when the only tasks that still run serve for ever.
    fn is_over(&self) -> bool {
        let standing = &self.log.standing;
        !self.restarts()
            && (standing.is_gone()
                || standing.has_ended()
                || self.run.until_idle && standing.servers_left().is_some())
    }

    /// Whether a restart of a killed node is still scheduled.
    fn restarts(&self) -> bool {
        self.faults.iter().any(|(_, fault)| matches!(fault, Fault::Restart(_)))
    }

    /// Puts the fact into the event log, once, that only tasks that serve for ever still run. Only if the run has no
    /// declared end.
    fn tell_idle(&mut self) {
        if self.idle_told || self.run.length.is_some() || self.restarts() || self.log.is_over {
            return;
        }
        if let Some(left) = self.log.standing.servers_left() {
            self.idle_told = true;
            self.log.note(now_us(), &Fact::Idle(left));
        }
    }

    fn carry_out(&mut self, fault: Fault) -> Result<(), LaunchError> {
        let name = |node: NodeId| self.cell.nodes[node.index()].name.clone();
        // The killed node may not have reported its events from just before the kill. So the kill is noted with a time
        // from before the call.
        let before = now_us();
        match fault {
            Fault::Kill(node) => self.children.kill(node),
            Fault::Restart(node) => self.restart(node)?,
            Fault::Cut(a, b) => {
                self.children.order(a, &Order::Cut(name(b)));
                self.children.order(b, &Order::Cut(name(a)));
            }
            Fault::Heal(a, b) => {
                self.children.order(a, &Order::Heal(name(b)));
                self.children.order(b, &Order::Heal(name(a)));
            }
            Fault::Pause(node) | Fault::Resume(node) => {
                let stands = matches!(fault, Fault::Pause(_));
                if !self.children.stand_still(node, stands) {
                    self.set_apart(node, stands);
                }
            }
        }
        let at = if matches!(fault, Fault::Kill(_)) { before } else { now_us() };
        self.log.note(at, &Fact::Fault(fault));
        Ok(())
    }

    /// Cuts or heals all links of a node.
    fn set_apart(&mut self, node: NodeId, apart: bool) {
        let order = |name: &str| if apart { Order::Cut(name.into()) } else { Order::Heal(name.into()) };
        let cell = self.cell;
        for link in cell.links.iter().filter(|link| link.a == node || link.b == node) {
            let other = if link.a == node { link.b } else { link.a };
            self.children.order(node, &order(&cell.nodes[other.index()].name));
            self.children.order(other, &order(&cell.nodes[node.index()].name));
        }
    }

    /// Starts the next incarnation of a killed node. The other nodes learn its address once it has bound its socket.
    fn restart(&mut self, node: NodeId) -> Result<(), LaunchError> {
        let Some((_, setup)) = self.setups.iter_mut().find(|(of, _)| *of == node) else { return Ok(()) };
        setup.incarnation = setup.incarnation.wrapping_add(1);
        setup.restarted = true;
        let incarnation = self.children.incarnation(node) + 1;
        let record = self.run.record.as_ref();
        setup.record = record.map(|file| record_file(file, &format!("{}-{}", setup.node, incarnation + 1)));
        let setup = setup.clone();
        self.children.restart(node, &setup)?;
        if self.children.in_one_process() {
            let book = Order::Book(self.book.clone());
            self.children.order(node, &book);
        }
        Ok(())
    }

    /// Takes a message of a node.
    pub(super) fn take(&mut self, message: Message) {
        match message {
            Message::Said(node, word) => {
                self.heard.insert(node, Instant::now());
                match &word {
                    // The node was restarted: all other nodes get its new address, and the node gets the addresses of
                    // all nodes.
                    Word::Bound { address: Some(address), observe } => {
                        self.book.insert(self.name(node), *address);
                        let book = Order::Book(self.book.clone());
                        self.children.order_all(&book);
                        self.observed.extend(observe.map(|address| (self.name(node), address)));
                        self.tell_observed();
                    }
                    Word::Did(did) => self.watch(did),
                    _ => {}
                }
                let is_end = matches!(word, Word::TaskEnded { .. });
                self.log.note(now_us(), &Fact::Said(node, word));
                if is_end {
                    self.tell_idle();
                }
            }
            Message::Gone(node, incarnation) => {
                // The launcher did not kill this node: something else killed it, or the node failed. The last messages
                // of the node are missing.
                if !self.log.is_over && self.children.runs(node, incarnation) {
                    self.log.note(now_us(), &Fact::Died(node));
                }
                if self.children.incarnation(node) == incarnation {
                    self.heard.remove(&node);
                    // The judge must first get the notices that the node wrote about its commands before it died.
                    self.hear_of_commands();
                    self.log.note(now_us(), &Fact::Gone(node));
                    self.tell_idle();
                }
            }
            // This message only wakes the launcher: `interrupts` has already counted the signal.
            Message::Interrupted => {}
        }
    }

    /// Notes what nodes and guards have reported about commands.
    pub(super) fn hear_of_commands(&mut self) {
        let notices = self.noticed.as_mut().map(Noticed::drain).unwrap_or_default();
        notices.into_iter().for_each(|notice| self.log.note(now_us(), &Fact::Noticed(notice)));
    }

    /// Schedules the fault that waits for the beginning of an action, if this event is that beginning.
    fn watch(&mut self, did: &Did) {
        let Some((moment, been)) = self.moment.as_mut().filter(|_| !self.log.is_over) else { return };
        let ScriptEvent::Begins { action, .. } = &did.what else { return };
        if did.task != moment.task || *action != moment.action {
            return;
        }
        *been += 1;
        if *been == moment.time
            && let Some((moment, _)) = self.moment.take()
        {
            self.plan(&moment, did.at);
        }
    }

    /// Schedules a fault and its end. `at` is the beginning of the action that triggers them, in microseconds of the
    /// clock that all processes share.
    fn plan(&mut self, moment: &Moment, at: u64) {
        let passed = Duration::from_micros(now_us().saturating_sub(at));
        let due = self.elapsed() + moment.after.saturating_sub(passed);
        self.faults.extend(moment.faults.iter().map(|(later, fault)| (due + *later, *fault)));
        self.faults.sort_by_key(|(at, _)| *at);
    }
}
