//! The launcher's event loop during a run: it takes the messages of the nodes and injects the faults on time.

use super::{Launcher, Trouble};
use crate::args::Format;
use crate::failure::Failure;
use crate::launch::children::Message;
use crate::launch::clock::now_us;
use crate::launch::error::LaunchError;
use crate::launch::faults::{Fault, node};
use crate::launch::lines::{EndSort, Order, Word};
use crate::launch::noticed::Noticed;
use crate::launch::script_event::{Did, ScriptEvent};
use crate::launch::setups::record_file;
use crate::launch::story::{Moment, Planned};
use crate::output::{Output, span};
use imrs_protocol::{NodeId, TaskId};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

/// Interval at which the event log of the scripts is flushed to the output.
const SHOW_EVERY: Duration = Duration::from_millis(50);
/// Interval at which the progress line is redrawn.
const PROGRESS_EVERY: Duration = Duration::from_millis(250);
/// Most events that are kept for a demo's explanation; later ones are left out.
const LONGEST_STORY: usize = 100_000;

impl Launcher<'_> {
    /// Follows the run until its end and injects the faults on time. Shows every pending line of the event log, however the
    /// run ends.
    pub(in crate::launch) fn follow(&mut self, length: Duration, out: &mut Output) -> Result<(), Failure> {
        let followed = self.follow_until_the_end(length, out);
        out.progress(None);
        followed.and(self.event_log.close(&self.run.loaded.table, out))
    }

    fn follow_until_the_end(&mut self, length: Duration, out: &mut Output) -> Result<(), Failure> {
        for message in std::mem::take(&mut self.early) {
            self.take(message)?;
        }
        let mut progress_at = self.started;
        while self.interrupts.count() == 0 && !self.is_over() {
            let now = self.started.elapsed();
            if now >= length {
                break;
            }
            while self.faults.first().is_some_and(|(at, _)| *at <= now) {
                let (_, fault) = self.faults.remove(0);
                self.carry_out(fault)?;
            }
            self.hear_of_commands();
            for broken in self.judge.settle() {
                if self.run.args.format == Format::Text {
                    self.event_log.broken(broken.at, broken.words(self.run.loaded));
                }
            }
            let shows = !self.event_log.is_empty();
            if shows {
                self.event_log.show(&self.run.loaded.table, now_us(), out)?;
            }
            if progress_at <= Instant::now() {
                let of = self.run.length.map(|all| format!(" of {}", humantime::format_duration(all)));
                let (so_far, of) = (now.as_secs(), of.unwrap_or_default());
                let met = self.gatherer.released();
                let met = met.map(|met| format!(": {met} rounds")).unwrap_or_default();
                out.progress(Some(&format!("{so_far} s{of}{met}")));
                progress_at = Instant::now() + PROGRESS_EVERY;
            }
            let next_fault = self.faults.first().map_or(length, |(at, _)| *at);
            let mut until = (self.started + next_fault.min(length)).min(progress_at);
            if shows {
                until = until.min(Instant::now() + SHOW_EVERY);
            }
            match self.messages.recv_timeout(until.saturating_duration_since(Instant::now())) {
                Ok(message) => self.take(message)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        Ok(())
    }

    /// Whether nothing can happen any more: every script has ended, or its node is gone for good. With `--until-idle` also
    /// when only servers are left.
    fn is_over(&self) -> bool {
        if self.restarts() {
            return false;
        }
        let runs = self.tasks().next().is_some();
        self.gone.len() == self.children.len()
            || runs && self.left().next().is_none()
            || self.run.args.until_idle && self.servers_left().is_some()
    }

    /// Whether a restart of a killed node is still scheduled.
    fn restarts(&self) -> bool {
        self.faults.iter().any(|(_, fault)| matches!(fault, Fault::Restart(_)))
    }

    fn tasks(&self) -> impl Iterator<Item = TaskId> {
        self.children.nodes().flat_map(|node| self.table().tasks_on(node))
    }

    /// The tasks that still run: their scripts have not ended, and their nodes are not gone.
    fn left(&self) -> impl Iterator<Item = TaskId> {
        let is_gone =
            |task: TaskId| self.table().location(task).is_some_and(|node| self.gone.contains(&node));
        self.tasks().filter(move |task| !self.ended.contains(task) && !is_gone(*task))
    }

    /// The tasks that still run, if all of them serve for ever and some other task has ended.
    fn servers_left(&self) -> Option<Vec<TaskId>> {
        let finishes = |task: TaskId| self.run.loaded.can_finish(task);
        let is_idle = !self.restarts() && self.tasks().any(finishes) && !self.left().any(finishes);
        Some(self.left().collect()).filter(|left: &Vec<TaskId>| is_idle && !left.is_empty())
    }

    /// Shows once that only servers are left, if the run has no declared end.
    fn tell_idle(&mut self) {
        let told = self.idle_told || self.run.length.is_some() || self.run.args.format == Format::Json;
        let Some(left) = (!told).then(|| self.servers_left()).flatten() else { return };
        self.idle_told = true;
        let names: Vec<&str> = left.iter().map(|task| &*self.cell.tasks[task.index()].name).collect();
        let names = names.join(", ");
        let end = if self.run.args.until_idle { "" } else { "; Ctrl-C ends the run, or use --until-idle" };
        self.event_log.fault(now_us(), format!("only servers are left: {names}{end}"));
    }

    fn carry_out(&mut self, fault: Fault) -> Result<(), LaunchError> {
        let name = |node: NodeId| self.cell.nodes[node.index()].name.clone();
        match fault {
            Fault::Kill(node) => {
                let at = now_us();
                self.children.kill(node);
                self.gatherer.killed(node, at);
                self.judge.killed(node, at);
            }
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
        let at = now_us();
        if self.run.args.format == Format::Text {
            let words = match fault {
                Fault::Kill(node) => format!("fault: node {} is killed", name(node)),
                Fault::Restart(node) => format!("node {} is started again", name(node)),
                Fault::Cut(a, b) => format!("fault: nothing passes between {} and {}", name(a), name(b)),
                Fault::Heal(a, b) => format!("{} and {} reach each other again", name(a), name(b)),
                Fault::Pause(node) if self.children.in_one_process() => {
                    format!("fault: nothing passes between {} and the others", name(node))
                }
                Fault::Pause(node) => format!("fault: node {} stands still", name(node)),
                Fault::Resume(node) if self.children.in_one_process() => {
                    format!("{} and the others reach each other again", name(node))
                }
                Fault::Resume(node) => format!("node {} goes on", name(node)),
            };
            self.event_log.fault(at, words);
        }
        self.came.push((at, fault));
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
        let record = self.run.args.record.as_ref();
        setup.record = record.map(|file| record_file(file, &format!("{}-{}", setup.node, incarnation + 1)));
        let setup = setup.clone();
        self.children.restart(node, &setup)?;
        let at = now_us();
        self.gatherer.revived(node, at);
        self.judge.revived(node, at);
        self.gone.retain(|gone| *gone != node);
        let table = Arc::clone(&self.run.loaded.table);
        self.ended.retain(|task| table.location(*task) != Some(node));
        if self.children.in_one_process() {
            let book = Order::Book(self.book.clone());
            self.children.order(node, &book);
        }
        Ok(())
    }

    pub(in crate::launch) fn take(&mut self, message: Message) -> Result<(), LaunchError> {
        match message {
            Message::Said(_, Word::Event(event)) => self.gatherer.event(&event),
            Message::Said(node, Word::Figures(figures)) => {
                let name = self.name(node);
                for words in figures.refusals.iter().map(|refusal| refusal.words(&name)) {
                    if self.refused.insert(words.clone()) && self.run.args.format == Format::Text {
                        self.event_log.broken(now_us(), words);
                    }
                }
                self.gatherer.figures(node, *figures);
            }
            Message::Said(node, Word::HeldBack(held)) => self.held_back(node, &held),
            Message::Said(_, Word::Did(did)) => self.did(did)?,
            Message::Said(_, Word::Stands(change)) => self.judge.change(change),
            Message::Said(node, Word::Told(until)) => self.judge.told(node, until),
            Message::Said(node, Word::Untold { since }) => self.judge.untold(node, since),
            Message::Said(_, Word::TaskEnded { task, how, sort }) => {
                self.task_ended(task, how, sort);
                self.tell_idle();
            }
            // The node was restarted: all nodes get its address, and it gets all of theirs.
            Message::Said(node, Word::Bound { address: Some(address), observe }) => {
                self.book.insert(self.name(node), address);
                let book = Order::Book(self.book.clone());
                self.children.order_all(&book);
                self.observed.extend(observe.map(|address| (self.name(node), address)));
                self.tell_observed();
            }
            Message::Said(_, Word::Bound { address: None, .. } | Word::Started | Word::Done) => {}
            Message::Gone(node, incarnation) => {
                // The launcher did not kill it: something else did, or it failed. Its last messages are missing.
                if !self.stopping && self.children.runs(node, incarnation) {
                    let at = now_us();
                    self.gatherer.killed(node, at);
                    self.judge.killed(node, at);
                }
                if self.children.incarnation(node) == incarnation {
                    self.gone.push(node);
                    // First the judge gets the notices that the node wrote about its commands before it died.
                    self.hear_of_commands();
                    self.judge.gone(node);
                    if !self.stopping {
                        self.tell_idle();
                    }
                }
            }
            // Only a wake-up: `interrupts` has counted the signal.
            Message::Interrupted => {}
        }
        Ok(())
    }

    /// Passes the notices of nodes and guards about commands on to the judge.
    pub(in crate::launch) fn hear_of_commands(&mut self) {
        let notices = self.noticed.as_mut().map(Noticed::drain).unwrap_or_default();
        notices.into_iter().for_each(|notice| self.judge.notice(notice));
    }

    fn did(&mut self, did: Did) -> Result<(), LaunchError> {
        if self.stopping {
            return Ok(());
        }
        if let Some((moment, been)) = &mut self.moment {
            let of = self.cell.tasks[did.task.index()].name == moment.task;
            if of && matches!(&did.what, ScriptEvent::Begins { action, .. } if action == moment.action) {
                *been += 1;
                if *been == moment.time {
                    let moment = *moment;
                    self.moment = None;
                    self.plan(moment, did.at)?;
                }
            }
        }
        if self.run.demo.is_some() && self.events.len() < LONGEST_STORY {
            self.events.push(did.clone());
        }
        if self.run.args.format == Format::Text {
            self.event_log.add(did);
        }
        Ok(())
    }

    /// Schedules the fault of a demo: its action began at `at`, in microseconds of the shared clock.
    fn plan(&mut self, moment: &Moment, at: u64) -> Result<(), LaunchError> {
        let passed = Duration::from_micros(now_us().saturating_sub(at));
        let due = self.started.elapsed() + moment.after.saturating_sub(passed);
        match moment.fault {
            Planned::Kill(name) => self.faults.push((due, Fault::Kill(node(self.cell, name)?))),
            Planned::Pause(name, length) => {
                let node = node(self.cell, name)?;
                self.faults.push((due, Fault::Pause(node)));
                self.faults.push((due + length, Fault::Resume(node)));
            }
            Planned::Cut([a, b], length) => {
                let (a, b) = (node(self.cell, a)?, node(self.cell, b)?);
                self.faults.push((due, Fault::Cut(a, b)));
                self.faults.push((due + length, Fault::Heal(a, b)));
            }
        }
        self.faults.sort_by_key(|(at, _)| *at);
        Ok(())
    }

    /// Shows how long each script of a restarted node is held back.
    fn held_back(&mut self, node: NodeId, held: &[(TaskId, u64)]) {
        if self.run.args.format != Format::Text {
            return;
        }
        let all = self.run.loaded.table.tasks_on(node).count() == held.len();
        let mut by_time: BTreeMap<u64, Vec<&str>> = BTreeMap::new();
        for (task, time) in held {
            by_time.entry(*time).or_default().push(&self.cell.tasks[task.index()].name);
        }
        let of = |names: &[&str]| match names {
            _ if all && names.len() == held.len() => String::new(),
            [name] => format!("task {name} "),
            names => format!("tasks {} ", names.join(", ")),
        };
        let lines: Vec<_> = by_time
            .iter()
            .map(|(time, names)| {
                let (name, of, time) = (self.name(node), of(names), span(*time));
                format!("node {name}: {of}held back {time} more: commands of its earlier incarnation may still arrive")
            })
            .collect();
        lines.into_iter().for_each(|line| self.event_log.fault(now_us(), line));
    }

    fn task_ended(&mut self, task: TaskId, how: String, sort: EndSort) {
        self.ended.push(task);
        // After an injected fault, a task that aborts is judged by the demo's explanation, not here.
        let expected = sort == EndSort::Aborted && self.run.demo.is_some() && self.is_disturbed();
        if sort != EndSort::Well && !expected {
            let what = format!("task `{}` {how}", self.cell.tasks[task.index()].name);
            self.trouble.push(Trouble { at_fault: false, what });
        }
        self.gatherer.script_ended(task, how);
    }

    fn is_disturbed(&self) -> bool {
        !self.came.is_empty() || self.run.args.loss.0 > 0.0
    }
}

/// The progress line on standard error; hidden in JSON runs.
pub(in crate::launch) fn progress_line(format: Format) -> ProgressBar {
    let target = match format {
        Format::Text => ProgressDrawTarget::stderr(),
        Format::Json => ProgressDrawTarget::hidden(),
    };
    ProgressBar::with_draw_target(None, target).with_style(ProgressStyle::default_spinner())
}
