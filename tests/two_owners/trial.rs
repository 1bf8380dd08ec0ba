//! One trial: runs a cell whose two tasks share a tool, applies a fault to the node whose task acts, and reads the log
//! of the tool.

use super::fault::{FAULTS, Fate, Fault};
use super::tool::{Bound, command, log_of, two_owners};
use crate::support::live::Live;
use crate::support::{own_address, runtime_dir, wait_until};
use imrs_runtime::actuator::now;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

/// The cell of the trials: two welders that share a tool. The lease is long, so that it rarely ends before the fault,
/// even on a busy machine.
pub const CELL: &str = "\
cell two_owners;
tick 1 msec;
node n1 at \"HOST\" port N1;  node n2 at \"HOST\" port N2;
link n1 -- n2 delay 2 msec;
task r1 on n1 module welders
  port alive()  usage = response  user_list = {r2}  time_out = 60 msec  class = 2;
begin
  loop run weld_primary takes 0 msec .. 60 sec; end;
end r1;
task r2 on n2 module welders standby of r1
  use_port alive()  usage = query  time_out = 60 msec;
begin
  loop delay 1 sec; end;
takeover
  loop run weld_standby takes 0 msec .. 60 sec; end;
end r2;
couple work r1 -> r2 lease 700 msec takeover 1000 msec every 30 msec via alive;
check one_active: never r1.active and r2.active;
";
pub const TAKEOVER: Duration = Duration::from_secs(1);
/// The usual duration of an action. It is longer than a take-over, so that a command whose node is dead would go on acting.
const WELD: Duration = Duration::from_millis(2500);
/// The duration of an action that is so short that a fault often comes between two actions, or at the start of one.
const TACK: Duration = Duration::from_millis(40);
/// The duration of an action that is so long that only a guard ends it.
const ENDLESS: Duration = Duration::from_secs(50);
/// How long processes may stay stopped after the planned time, until the standby acts. A command that was stopped in
/// the middle of a step makes the standby wait (D150).
const HELD_ON: Duration = Duration::from_secs(3);
/// In a comparison processes stay stopped until the standby has acted in this many steps.
const STEPS: usize = 20;
/// How long the cell runs after the fault has ended.
const AFTERWARDS: Duration = Duration::from_millis(500);

/// The plan of a trial.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    pub number: u64,
    pub fault: Fault,
    /// The least time during which processes are stopped.
    pub length: Duration,
    pub bound: Bound,
    action: Duration,
}

impl Plan {
    /// The plan of the trial with this number. In a long series (`are_many`) processes are also stopped for up to half
    /// a minute.
    pub fn of(number: u64, are_many: bool) -> Self {
        let (kind, round) = (number % FAULTS.len() as u64, number / FAULTS.len() as u64);
        let mut draws = fastrand::Rng::with_seed(number);
        let millis = match (kind + round) % 6 {
            0 => draws.u64(100..900),
            5 if are_many => draws.u64(5_000..=30_000),
            _ => draws.u64(1_100..=2_000),
        };
        Self {
            number,
            fault: FAULTS[usize::try_from(kind).expect("a few")],
            length: Duration::from_millis(millis),
            bound: if round.is_multiple_of(2) { Bound::Both } else { Bound::Gate },
            action: if (kind + round) % 4 == 3 { TACK } else { WELD },
        }
    }

    /// The plan of a comparison: a trial with this fault, in which only the guard limits the command.
    pub fn comparison(number: u64, fault: Fault) -> Self {
        Self { number, fault, length: TAKEOVER, bound: Bound::Neither, action: ENDLESS }
    }

    /// The plan of a trial in which a node is stopped for longer than a take-over.
    pub fn stopped(number: u64) -> Self {
        let (fault, length) = (super::fault::NODE_STOPPED, 3 * TAKEOVER / 2);
        Self { number, fault, length, bound: Bound::Both, action: WELD }
    }
}

/// The result of a trial. Times are in microseconds.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct Trial {
    pub number: u64,
    pub fault: String,
    pub bound: Bound,
    /// How long an older epoch still acted after the first step of a newer one.
    pub two_owners: u64,
    /// Whether the fault came while an action of the owner was being carried out.
    pub mid_action: bool,
    /// Whether a guard with a running command was stopped.
    pub guard_held: bool,
    /// How long processes were stopped; 0 if the fault stopped none.
    pub held: u64,
    /// The time from the fault to the standby's first step.
    pub took_over: Option<u64>,
    /// Whether the standby acted only after a stopped command was resumed.
    pub waited: bool,
    /// The time from the fault to the last step of the owner's command, if during that time nothing could kill the command.
    pub went_on: Option<u64>,
    /// The summary's verdict on the check that at most one task is active.
    pub check: String,
}

/// The log of a trial's tool, from which times after the fault are computed.
struct View<'a> {
    tool: &'a Path,
    /// The last epoch that acted before the fault.
    owner: u8,
    /// The time of the fault.
    at: u64,
}

impl View<'_> {
    /// The times of the steps after the fault: those of the owner's epoch, or those of newer epochs.
    fn after(&self, of_owner: bool) -> Vec<u64> {
        let log = log_of(self.tool).into_iter().filter(|line| line.acts && line.at > self.at);
        let log =
            log.filter(|line| if of_owner { line.epoch == self.owner } else { line.epoch > self.owner });
        log.map(|line| line.at).collect()
    }

    fn took_over(&self) -> Option<u64> {
        self.after(false).first().map(|first| first - self.at)
    }
}

/// Runs a trial.
pub fn trial(plan: &Plan) -> Trial {
    let dir = runtime_dir();
    let live = start(dir.path(), plan);
    let acts = |least: usize| log_of(dir.path()).iter().filter(|line| line.acts).count() >= least;
    wait_until("the primary acts", || acts(20));
    // The delay is random, so that the fault can come at any time of the lease.
    thread::sleep(Duration::from_millis(fastrand::Rng::with_seed(plan.number).u64(0..600)));
    let owner = log_of(dir.path()).last().expect("it acts").epoch;
    // If the standby already acts, no task takes over from it.
    let (node, is_primary) = (if owner % 2 == 1 { "n1" } else { "n2" }, owner % 2 == 1);
    let view = View { tool: dir.path(), owner, at: now() };
    let struck = plan.fault.strike(live.pid(node));
    let (struck_by, is_killed) = (now(), plan.fault.node == Fate::Killed);
    // If neither a deadline nor a gate stops the old owner's command, it should act at the same time as the new owner's
    // command. Either of them may have to wait for a processor.
    let may_be_two = plan.bound == Bound::Neither && plan.fault.lets_the_command_go_on();
    let least = if plan.bound == Bound::Neither { STEPS } else { 1 };
    let is_seen = || !may_be_two || !struck.holds_a_guard() || two_owners(&log_of(dir.path())) > 0;
    hold(plan, || !is_primary || (view.after(false).len() >= least && is_seen()));
    let (guard_held, held) = (struck.holds_a_guard(), now() - view.at);
    drop(struck);
    if is_killed && is_primary {
        wait_until("the standby acts", || view.took_over().is_some());
    }
    thread::sleep(AFTERWARDS);
    live.interrupt();
    let (summary, ..) = live.finish();
    let log = log_of(dir.path());
    let before = log.iter().rev().find(|line| line.at <= view.at && line.epoch == owner);
    Trial {
        number: plan.number,
        fault: plan.fault.name.to_owned(),
        bound: plan.bound,
        two_owners: two_owners(&log),
        mid_action: before.is_some_and(|line| line.acts),
        guard_held,
        held: if plan.fault.holds() { held } else { 0 },
        took_over: view.took_over(),
        waited: plan.fault.tool == Fate::Held && view.took_over().is_some_and(|after| after > held),
        went_on: (guard_held && plan.fault.lets_the_command_go_on()).then(|| {
            // Later steps of the owner do not count, because its task may then hold the lease again.
            let last = view.after(true).into_iter().rfind(|&at| at <= view.at + held);
            last.map_or(0, |last| last.saturating_sub(struck_by))
        }),
        check: summary["checks"][0]["outcome"].as_str().expect("an outcome").to_owned(),
    }
}

fn start(dir: &Path, plan: &Plan) -> Live {
    let (host, [n1, n2]) = own_address();
    let cell = CELL.replace("HOST", &host.to_string());
    let cell = cell.replace("port N1", &format!("port {n1}")).replace("port N2", &format!("port {n2}"));
    let file = dir.join("two_owners.cell");
    std::fs::write(&file, cell).expect("the cell is written");
    let [primary, standby] =
        ["weld_primary", "weld_standby"].map(|name| command(name, dir, plan.bound, plan.action));
    let (file, seed) = (file.to_str().expect("UTF-8"), plan.number.to_string());
    let run = ["run", file, "--for", "10m", "--seed", &seed, "--action", &primary, "--action", &standby];
    Live::start(dir, &run)
}

/// Waits while processes are stopped, for the planned time. If the standby must take over, this also waits until `acts`
/// is true.
fn hold(plan: &Plan, acts: impl Fn() -> bool) {
    let Plan { fault, length, .. } = plan;
    if fault.holds() {
        thread::sleep(*length);
    }
    if fault.node == Fate::Spared || (fault.node == Fate::Held && *length < TAKEOVER) {
        return;
    }
    if fault.tool == Fate::Spared {
        return wait_until("the standby acts", acts);
    }
    let end = Instant::now() + HELD_ON;
    while !acts() && Instant::now() < end {
        thread::sleep(Duration::from_millis(5));
    }
}
