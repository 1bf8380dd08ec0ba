//! The faults of a trial: what happens to the node whose task acts, to the guard of its command, and to the command itself.

use super::freezer::Freezer;
use crate::support::{is_alive, signal};
use rustix::process::Signal;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    Spared,
    /// The process is stopped, and later resumed.
    Held,
    Killed,
}

/// How the processes of a fault are stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Means {
    Signal,
    Freezer,
}

/// A fault of the node whose task acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    pub name: &'static str,
    pub node: Fate,
    pub guard: Fate,
    pub tool: Fate,
    means: Means,
}

const fn fault(name: &'static str, [node, guard, tool]: [Fate; 3], means: Means) -> Fault {
    Fault { name, node, guard, tool, means }
}

/// The fault in which only the node is stopped. This fault revealed the first defect with two owners.
pub const NODE_STOPPED: Fault =
    fault("node stopped", [Fate::Held, Fate::Spared, Fate::Spared], Means::Signal);

/// All faults of the trials. A stopped guard cannot kill its command.
pub const FAULTS: [Fault; 11] = {
    use Fate::{Held, Killed, Spared};
    use Means::{Freezer, Signal};
    [
        fault("node killed", [Killed, Spared, Spared], Signal),
        fault("node killed, guard frozen", [Killed, Held, Spared], Freezer),
        NODE_STOPPED,
        fault("node and guard stopped", [Held, Held, Spared], Signal),
        fault("node and guard frozen", [Held, Held, Spared], Freezer),
        fault("node, guard and command stopped", [Held, Held, Held], Signal),
        fault("node, guard and command frozen", [Held, Held, Held], Freezer),
        fault("node killed, command stopped", [Killed, Spared, Held], Signal),
        fault("node killed, guard and command frozen", [Killed, Held, Held], Freezer),
        fault("guard stopped", [Spared, Held, Spared], Signal),
        // Here the kernel ends the stopped guard: it sends SIGHUP to a stopped process group without a parent in its session.
        fault("node killed, guard stopped", [Killed, Held, Spared], Signal),
    ]
};

impl Fault {
    /// Whether after this fault no process is left to kill the command, although the command's task must lose the lease.
    pub fn lets_the_command_go_on(&self) -> bool {
        let ends_the_guard = self.node == Fate::Killed && self.means == Means::Signal;
        (self.guard, self.tool) == (Fate::Held, Fate::Spared) && self.node != Fate::Spared && !ends_the_guard
    }

    pub fn holds(&self) -> bool {
        [self.node, self.guard, self.tool].contains(&Fate::Held)
    }

    /// Applies the fault to the node with this process id. Returns the processes that it stopped.
    pub fn strike(&self, node: u32) -> Struck {
        let mut struck = Struck { held: Vec::new(), frozen: None, guards: Vec::new() };
        let holds_more = [self.guard, self.tool].contains(&Fate::Held);
        // The node is stopped first. Otherwise it could start its next command while this function looks for the
        // processes.
        if self.node != Fate::Spared && self.means == Means::Signal && holds_more {
            signal(node, Signal::STOP);
        }
        let guards = children(node);
        let tools: Vec<u32> = guards.iter().flat_map(|&guard| children(guard)).collect();
        let of = [(self.node, vec![node]), (self.guard, guards.clone()), (self.tool, tools.clone())];
        struck.held =
            of.into_iter().filter(|(fate, _)| *fate == Fate::Held).flat_map(|(_, all)| all).collect();
        struck.hold(self.means);
        if self.guard == Fate::Held && !tools.is_empty() {
            struck.guards = guards;
        }
        if self.node == Fate::Killed {
            signal(node, Signal::KILL);
        }
        struck
    }
}

/// The processes that a fault stopped. Dropping this value resumes them.
pub struct Struck {
    held: Vec<u32>,
    frozen: Option<Freezer>,
    /// The stopped guards that had a running command.
    guards: Vec<u32>,
}

impl Struck {
    /// Whether a guard that had a command is still stopped.
    pub fn holds_a_guard(&self) -> bool {
        self.guards.iter().any(|&guard| is_alive(guard))
    }

    fn hold(&mut self, means: Means) {
        if means == Means::Freezer {
            match Freezer::of(self.held.iter().copied()) {
                Ok(frozen) => {
                    self.frozen = Some(frozen);
                    return;
                }
                Err(why) => println!("SKIPPED the freezer ({why}): the processes are stopped instead"),
            }
        }
        self.held.iter().for_each(|&pid| signal(pid, Signal::STOP));
    }
}

impl Drop for Struck {
    fn drop(&mut self) {
        match self.frozen.take() {
            Some(frozen) => frozen.thaw(),
            None => self.held.iter().for_each(|&pid| signal(pid, Signal::CONT)),
        }
    }
}

/// The child processes of `pid`. The children of a node are the guards of its commands. The only child of a guard is
/// its command.
fn children(pid: u32) -> Vec<u32> {
    let all = std::fs::read_dir("/proc").expect("/proc").flatten();
    let all = all.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let parent = |pid: &u32| {
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
        stat.rsplit_once(')')?.1.split_whitespace().nth(1)?.parse::<u32>().ok()
    };
    all.filter(|child| parent(child) == Some(pid)).collect()
}
