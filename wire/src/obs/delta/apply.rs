//! Applies a delta to a snapshot, after checking that the delta fits.

use super::age::{
    age_parts, age_timers, age_transit, aged, aged_facts, aged_link, aged_state, counters, counters_of,
};
use super::{
    At, COUNTERS, Changed, Delta, DeltaError, PortAnew, PortChange, TaskAnew, TaskChange, TaskParts, Waiting,
};
use crate::obs::snapshot::{Count, Snapshot, TaskSnapshot};
use imrs_protocol::{PortCounters, PortId, PortView, TaskView};

impl Snapshot {
    /// Changes this snapshot into the snapshot that `delta` describes.
    ///
    /// # Errors
    /// [`DeltaError`]; the snapshot is unchanged then.
    pub fn apply(&mut self, delta: &Delta) -> Result<(), DeltaError> {
        match delta.base_us {
            Some(wanted) if wanted != self.mono_us => {
                return Err(DeltaError::OtherBase { wanted, have: self.mono_us });
            }
            Some(_) => fits(self, delta)?,
            None => {
                fits(&Self::default(), delta)?;
                *self = Self::default();
            }
        }
        let passed = delta.passed_us;
        let facts = delta.node.unwrap_or_else(|| aged_facts(self, passed));
        self.mono_us = self.mono_us.wrapping_add(passed);
        (self.uptime_us, self.insecure, self.real_time) = (facts.uptime_us, facts.insecure, facts.real_time);
        match &delta.tasks {
            Changed::Whole(tasks) => self.tasks = tasks.iter().map(TaskAnew::task).collect(),
            Changed::Parts(parts) => {
                self.tasks.iter_mut().for_each(|task| task.age_us = task.age_us.wrapping_add(passed));
                each(&mut self.tasks, parts, change_task);
            }
        }
        self.transit_age_us = aged(self.transit_age_us, passed, delta.transit_passed_us);
        match &delta.transit {
            Some(transit) => self.transit.clone_from(transit),
            None => age_transit(&mut self.transit, delta.transit_passed_us),
        }
        match &delta.timers {
            Some(timers) => self.timers.clone_from(timers),
            None => age_timers(&mut self.timers, passed),
        }
        match &delta.links {
            Changed::Whole(links) => self.links.clone_from(links),
            Changed::Parts(parts) => {
                self.links.iter_mut().for_each(|link| *link = aged_link(*link, passed));
                each(&mut self.links, parts, |link, new| *link = *new);
            }
        }
        grow(&mut self.discards, &delta.discards);
        grow(&mut self.link_discards, &delta.link_discards);
        Ok(())
    }
}

/// Calls `change` for each changed element. [`fits`] has checked that all these elements exist.
fn each<T, P>(list: &mut [T], parts: &[At<P>], mut change: impl FnMut(&mut T, &P)) {
    let mut rest = list.iter_mut();
    for part in parts {
        if let Some(element) = rest.nth(part.skip as usize) {
            change(element, &part.what);
        }
    }
}

fn change_task(task: &mut TaskSnapshot, change: &TaskChange) {
    let parts = match change {
        TaskChange::Anew(anew) => {
            *task = anew.task();
            return;
        }
        TaskChange::Parts(parts) => parts,
    };
    let own = parts.passed_us;
    task.age_us = task.age_us.wrapping_sub(own);
    task.liveness = parts.liveness.unwrap_or(task.liveness);
    task.view.state = parts.state.unwrap_or_else(|| aged_state(task.view.state, own));
    age_parts(&mut task.view, own);
    each(&mut task.view.ports, &parts.ports, change_port);
    each(&mut task.view.meetings, &parts.meetings, Clone::clone_from);
}

fn change_port(port: &mut PortView, change: &PortChange) {
    let mut by = change.by.iter();
    let mut all = counters(&port.counters);
    for (bit, counter) in all.iter_mut().enumerate() {
        if change.grown & (1 << bit) != 0 {
            *counter = counter.wrapping_add(by.next().copied().unwrap_or(0));
        }
    }
    port.counters = counters_of(all);
    if let Some(Waiting { len, min_slack, queue }) = &change.waiting {
        (port.len, port.min_slack) = (*len, *min_slack);
        port.queue.clone_from(queue);
    }
}

fn grow(counts: &mut Vec<Count>, change: &Changed<u64, Count>) {
    match change {
        Changed::Whole(new) => counts.clone_from(new),
        Changed::Parts(parts) => {
            each(counts, parts, |count, by| count.count = count.count.wrapping_add(*by));
        }
    }
}

/// Checks that every element that `delta` changes exists.
fn fits(snapshot: &Snapshot, delta: &Delta) -> Result<(), DeltaError> {
    match &delta.tasks {
        Changed::Whole(tasks) => tasks.iter().try_for_each(fits_anew)?,
        Changed::Parts(parts) => {
            let mut tasks = snapshot.tasks.iter();
            for part in parts {
                let task = tasks.nth(part.skip as usize).ok_or(DeltaError::NoSuchPart)?;
                match &part.what {
                    TaskChange::Parts(parts) => fits_task(task, parts)?,
                    TaskChange::Anew(anew) => fits_anew(anew)?,
                }
            }
        }
    }
    fits_list(&snapshot.links, &delta.links)?;
    fits_list(&snapshot.discards, &delta.discards)?;
    fits_list(&snapshot.link_discards, &delta.link_discards)
}

fn fits_task(task: &TaskSnapshot, parts: &TaskParts) -> Result<(), DeltaError> {
    fits_parts(task.view.ports.len(), &parts.ports)?;
    fits_parts(task.view.meetings.len(), &parts.meetings)?;
    parts.ports.iter().try_for_each(|at| fits_port(&at.what))
}

fn fits_anew(task: &TaskAnew) -> Result<(), DeltaError> {
    task.ports.iter().try_for_each(|port| fits_port(&port.change))
}

fn fits_port(change: &PortChange) -> Result<(), DeltaError> {
    let one_each = change.grown.count_ones() as usize == change.by.len() && change.grown < 1 << COUNTERS;
    if one_each { Ok(()) } else { Err(DeltaError::OtherCounters) }
}

fn fits_list<T, P>(list: &[T], change: &Changed<P, T>) -> Result<(), DeltaError> {
    match change {
        Changed::Parts(parts) => fits_parts(list.len(), parts),
        Changed::Whole(_) => Ok(()),
    }
}

fn fits_parts<P>(length: usize, parts: &[At<P>]) -> Result<(), DeltaError> {
    let last = parts.iter().map(|part| u64::from(part.skip) + 1).sum::<u64>();
    if last <= length as u64 { Ok(()) } else { Err(DeltaError::NoSuchPart) }
}

impl TaskAnew {
    fn task(&self) -> TaskSnapshot {
        let mut at = 0_u16;
        let ports = self.ports.iter().map(|port| {
            at = at.wrapping_add(port.further);
            port.port(PortId(at))
        });
        let view = TaskView {
            task: self.task,
            state: self.state,
            ports: ports.collect(),
            meetings: self.meetings.clone(),
        };
        TaskSnapshot { liveness: self.liveness, age_us: self.age_us, view }
    }
}

impl PortAnew {
    fn port(&self, port: PortId) -> PortView {
        let mut view = PortView {
            port,
            usage: self.usage,
            class: self.class,
            len: 0,
            capacity: self.capacity,
            min_slack: None,
            queue: Vec::new(),
            counters: PortCounters::default(),
        };
        change_port(&mut view, &self.change);
        view
    }
}
