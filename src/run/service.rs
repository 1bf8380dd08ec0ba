//! Reports the state of a run to the service manager that started this program, by the protocol of `sd_notify(3)`.
//! Without such a manager nothing is sent.

use crate::output::{complain, count};
use imrs_launch::{Launcher, Run};
use sd_notify::NotifyState;
use std::time::{Duration, Instant};

/// How many pings the program sends within the time in which the service manager wants one.
const PINGS: u32 = 3;

/// The service manager, as a run sees it.
pub struct Service {
    /// The time within which the service manager wants a ping; `None` if it wants no pings.
    within: Option<Duration>,
    /// When the last ping was sent.
    pinged: Instant,
    /// Whether a message to the manager has failed. The first failure is reported, later ones are not.
    has_failed: bool,
}

impl Service {
    /// Reports that all nodes of the run are up.
    pub fn ready(run: &Run<'_>, launcher: &Launcher<'_>) -> Self {
        let mut service =
            Self { within: sd_notify::watchdog_enabled(), pinged: Instant::now(), has_failed: false };
        let nodes: Vec<&str> = launcher.nodes().map(|node| node.name).collect();
        let status = format!(
            "{} of the cell {} up: {}",
            count(nodes.len() as u64, "node"),
            run.loaded.table.cell().name,
            nodes.join(", ")
        );
        service.tell(&[NotifyState::Ready, NotifyState::Status(&status)]);
        service
    }

    /// Sends a ping if one is due. Sends none if a node has been silent for so long that the manager should restart the
    /// run.
    pub fn ping(&mut self, silent_for: Duration) {
        let Some(within) = self.within else { return };
        let every = within / PINGS;
        if self.pinged.elapsed() >= every && silent_for < within - every {
            self.pinged = Instant::now();
            self.tell(&[NotifyState::Watchdog]);
        }
    }

    /// Reports that the run ends.
    pub fn stopping(&mut self) {
        self.tell(&[NotifyState::Stopping, NotifyState::Status("stopping")]);
    }

    fn tell(&mut self, states: &[NotifyState<'_>]) {
        if let Err(error) = sd_notify::notify(states)
            && !std::mem::replace(&mut self.has_failed, true)
        {
            complain(format_args!("the service manager (NOTIFY_SOCKET) does not listen: {error}"));
        }
    }
}
