//! The scenes of a couple: two tasks that share a tool, on two hosts. The log of the tool shows which task acted when.

use super::hosts::Hosts;
use super::net::{How, Net};
use super::scenes::Scene;
use super::switch::Faults;
use super::trial::Trial;
use crate::support::{signal, wait_until};
use crate::two_owners::freezer::Freezer;
use crate::two_owners::tool::{Bound, command, log_of, two_owners};
use crate::two_owners::trial::{CELL, TAKEOVER};
use imrs_runtime::actuator::now;
use rustix::process::Signal;
use std::cell::RefCell;
use std::thread;
use std::time::Duration;

/// The hosts of the two nodes.
const PRIMARY: usize = 0;
const STANDBY: usize = 1;
/// How long an action takes. It is longer than a take-over, so that a command whose node is dead would go on acting.
const WELD: Duration = Duration::from_millis(2_500);
/// How long the cell runs after the fault has ended.
const AFTERWARDS: Duration = Duration::from_millis(400);
/// The words that say what the time of a trial measures.
const TOOK: &str = "from the fault to the first step of the standby";

/// The scenes of this file.
pub const PAIR: [Scene; 9] = [
    scene("the owner of a tool is cut off", |seed| {
        pair(seed, &How::default(), |net| net.hosts.isolate(PRIMARY), |net| net.hosts.heal())
    }),
    scene("what the owner of a tool sends is cut off", |seed| {
        pair(seed, &How::default(), |net| net.hosts.cut(PRIMARY, STANDBY), |net| net.hosts.heal())
    }),
    scene("what is sent to the owner of a tool is cut off", |seed| {
        pair(seed, &How::default(), |net| net.hosts.cut(STANDBY, PRIMARY), |net| net.hosts.heal())
    }),
    scene("the link of the owner of a tool goes down", |seed| {
        let (down, up) =
            (|net: &mut Net| net.hosts.link(PRIMARY, "down"), |net: &mut Net| net.hosts.link(PRIMARY, "up"));
        pair(seed, &How::default(), down, up)
    }),
    scene("the owner of a tool is stopped", |seed| {
        let (stop, go_on) = (
            |net: &mut Net| signal(net.pid(PRIMARY), Signal::STOP),
            |net: &mut Net| signal(net.pid(PRIMARY), Signal::CONT),
        );
        pair(seed, &How::default(), stop, go_on)
    }),
    scene("the owner of a tool is frozen", frozen),
    scene("the owner of a tool is killed", |seed| {
        pair(seed, &How::default(), |net| net.kill(PRIMARY), |_| ())
    }),
    scene("two thirds of the owner's datagrams are lost", |seed| {
        let lossy = |net: &mut Net| net.hosts.set(Faults { loss: 0.67, ..Faults::default() });
        pair(seed, &How::default(), lossy, |net| net.hosts.set(Faults::default()))
    }),
    scene("the clock of the standby is a day ahead, and the owner of a tool is killed", |seed| {
        let under = ["unshare", "-T", "--monotonic", "86400"].map(str::to_owned).into();
        pair(seed, &How { under, ..How::default() }, |net| net.kill(PRIMARY), |_| ())
    }),
];

const fn scene(name: &'static str, run: fn(u64) -> Trial) -> Scene {
    Scene { name, took: TOOK, run }
}

/// The cell of the couple, with each node on a host of its own.
fn cell() -> String {
    let [first, second] = [PRIMARY, STANDBY].map(|host| Hosts::address(host).to_string());
    let placed = CELL.replacen("HOST", &first, 1).replacen("HOST", &second, 1);
    placed.replace("port N1", "port 7000").replace("port N2", "port 7000")
}

/// Runs the cell. Once the primary acts, `fault` is applied, and it lasts until the standby has acted.
fn pair(seed: u64, standby: &How, mut fault: impl FnMut(&mut Net), end: impl FnOnce(&mut Net)) -> Trial {
    let mut net = Net::new(&cell(), &["n1", "n2"], seed);
    let dir = net.dir.path().to_owned();
    let action = |name| vec!["--action".into(), command(name, &dir, Bound::Both, WELD)];
    net.start(STANDBY, &How { args: action("weld_standby"), ..standby.clone() });
    net.start(PRIMARY, &How { args: action("weld_primary"), ..How::default() });
    let acts = |least: usize| log_of(&dir).iter().filter(|line| line.acts).count() >= least;
    wait_until("the primary acts", || acts(20));
    // The delay is random, so that the fault can come at any time of the lease.
    let mut draws = fastrand::Rng::with_seed(seed);
    thread::sleep(Duration::from_millis(draws.u64(0..600)));
    let (owner, at) = (log_of(&dir).last().expect("it acts").epoch, now());
    fault(&mut net);
    let newer = || log_of(&dir).into_iter().find(|line| line.acts && line.epoch > owner && line.at > at);
    if owner == 1 {
        wait_until("the standby acts", || newer().is_some());
    } else {
        // On a late machine the standby may act already. Then no task takes over from it.
        thread::sleep(TAKEOVER);
    }
    thread::sleep(Duration::from_millis(draws.u64(0..400)));
    end(&mut net);
    thread::sleep(AFTERWARDS);
    let counts = net.hosts.counts();
    let ended = net.finish();
    let trial = Trial::of(&ended, counts);
    let (two_owners, took) = (two_owners(&log_of(&dir)), newer().map(|line| line.at - at));
    assert_eq!(two_owners, 0, "{:?}", log_of(&dir));
    Trial { two_owners: Some(two_owners), took, ..trial }
}

fn frozen(seed: u64) -> Trial {
    let held = RefCell::new(None);
    let freeze = |net: &mut Net| match Freezer::of([net.pid(PRIMARY)].into_iter()) {
        Ok(frozen) => drop(held.replace(Some(frozen))),
        Err(why) => {
            println!("SKIPPED the freezer ({why}): the node is stopped instead");
            signal(net.pid(PRIMARY), Signal::STOP);
        }
    };
    let thaw = |net: &mut Net| {
        drop(held.take());
        signal(net.pid(PRIMARY), Signal::CONT);
    };
    pair(seed, &How::default(), freeze, thaw)
}
