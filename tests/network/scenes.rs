//! The scenes of the cell in which three tasks talk: each has one fault, and goes on until the tasks talk as before.

use super::cells::talk;
use super::net::{Ended, How, Net};
use super::switch::Faults;
use super::trial::Trial;
use crate::support::live::{figure, released};
use crate::support::{Said, signal, wait_until};
use crate::two_owners::freezer::Freezer;
use imrs_runtime::actuator::now;
use rustix::fs::statvfs;
use rustix::process::Signal;
use std::thread;
use std::time::Duration;

pub const NODES: &[&str] = &["na", "nb", "nc"];
/// The hosts of the nodes.
pub const A: usize = 0;
pub const B: usize = 1;
pub const C: usize = 2;

/// A scene: one fault, which many trials repeat.
pub struct Scene {
    pub name: &'static str,
    /// What the time of a trial measures.
    pub took: &'static str,
    /// Runs a trial with this seed.
    pub run: fn(u64) -> Trial,
}

pub const fn scene(name: &'static str, took: &'static str, run: fn(u64) -> Trial) -> Scene {
    Scene { name, took, run }
}

pub const ANSWERED: &str = "from the end of the fault to the next answer";

/// The scenes of this file: faults of links, of a node that goes on, and of its disk.
pub const SCENES: [Scene; 13] = [
    scene("a third of the datagrams is lost", "", lossy),
    scene("half of the datagrams come twice", "", doubled),
    scene("half of the datagrams are overtaken", "", overtaken),
    scene("datagrams come after their time_out", "", belated),
    scene("a fifth of the datagrams is corrupted", "", corrupted),
    scene("recorded datagrams are sent again", "", repeated),
    scene("a node is cut off", ANSWERED, |seed| cut(seed, |net| net.hosts.isolate(B))),
    scene("questions are cut off", ANSWERED, |seed| cut(seed, |net| net.hosts.cut(A, B))),
    scene("answers are cut off", ANSWERED, |seed| cut(seed, |net| net.hosts.cut(B, A))),
    scene("a link goes down and comes up", ANSWERED, link_down),
    scene("a node is stopped", ANSWERED, stopped),
    scene("a node is frozen", ANSWERED, frozen),
    scene("the disk of a recording is full", "", disk_full),
];

/// Starts the cell, and waits until its tasks communicate.
pub fn talking(seed: u64) -> Net {
    let net = Net::started(&talk(), NODES, seed);
    progress(&net);
    net
}

/// Waits until all three tasks have met several more times. Between two meetings `a` asks `b`, and sends to `c`.
pub fn progress(net: &Net) {
    let mut first = None;
    net.until("all talk", |sample| {
        let met = released(sample, "a");
        met >= *first.get_or_insert(met) + 3
    });
}

/// Waits until `a` has given up a command after the beginning of this call.
pub fn gives_up(net: &Net) {
    let mut first = None;
    net.until("a command times out", |sample| {
        let given_up = figure(sample, "a", "ask", "timed_out");
        given_up > *first.get_or_insert(given_up)
    });
}

/// Waits until `more` further commands of `a` have ended, in whatever way.
fn asks(net: &Net, more: u64) {
    let mut first = None;
    net.until("commands end", |sample| {
        let sent = figure(sample, "a", "ask", "sent");
        sent >= *first.get_or_insert(sent) + more
    });
}

/// The result of a run. The time of the trial is counted from the instant `at`.
pub fn since(net: Net, at: u64) -> Trial {
    let (ended, trial) = result(net);
    Trial { took: ended.evidence.first(true, at), ..trial }
}

pub fn result(net: Net) -> (Ended, Trial) {
    let counts = net.hosts.counts();
    let ended = net.finish();
    let trial = Trial::of(&ended, counts);
    assert!(trial.outcome("replies") >= 3, "{trial:?}");
    (ended, trial)
}

/// How many datagrams all links dropped for these reasons.
pub fn dropped(ended: &Ended, reasons: &[&str]) -> u64 {
    let of = |said: &Said| {
        let summary = said.last_json();
        let discards = &summary["nodes"][0]["link_discards"];
        reasons.iter().filter_map(|reason| discards[reason].as_u64()).sum::<u64>()
    };
    ended.said.iter().map(|(_, said)| of(said)).sum()
}

/// A run in which datagrams have these faults while `a` asks some questions.
fn faulty(seed: u64, faults: Faults) -> (Ended, Trial) {
    let net = talking(seed);
    net.hosts.set(faults);
    asks(&net, 8);
    net.hosts.set(Faults::default());
    progress(&net);
    result(net)
}

fn lossy(seed: u64) -> Trial {
    let (_, trial) = faulty(seed, Faults { loss: 0.3, ..Faults::default() });
    assert!(trial.counts.lost > 0, "{trial:?}");
    trial
}

fn doubled(seed: u64) -> Trial {
    let (ended, trial) = faulty(seed, Faults { duplication: 0.5, ..Faults::default() });
    assert!(trial.counts.duplicated > 0, "{trial:?}");
    // Each copy is dropped at its receiver, except the last ones, which may come after the end of their node.
    let copies = dropped(&ended, &["replayed"]);
    assert!((1..=trial.counts.duplicated).contains(&copies), "{copies} copies: {trial:?}");
    trial
}

fn overtaken(seed: u64) -> Trial {
    let faults = Faults { late: 0.5, delay: Duration::from_millis(60), ..Faults::default() };
    let (_, trial) = faulty(seed, faults);
    assert!(trial.counts.late > 0, "{trial:?}");
    trial
}

fn belated(seed: u64) -> Trial {
    let faults = Faults { late: 0.5, delay: Duration::from_millis(1_500), ..Faults::default() };
    let (_, trial) = faulty(seed, faults);
    assert!(trial.counts.late > 0, "{trial:?}");
    trial
}

fn corrupted(seed: u64) -> Trial {
    let (ended, trial) = faulty(seed, Faults { corruption: 0.2, ..Faults::default() });
    assert!(trial.counts.corrupted > 0, "{trial:?}");
    let all = [
        "too_short",
        "not_imrs",
        "version",
        "mode",
        "other_cell",
        "unknown_node",
        "length",
        "replayed",
        "purpose",
        "misdelivered",
        "other_keys",
        "stale_session",
        "forged",
    ];
    assert!(dropped(&ended, &["forged"]) > 0, "{:?}", ended.said);
    let dropped = dropped(&ended, &all);
    assert!(dropped <= trial.counts.corrupted, "{dropped} dropped: {trial:?}");
    trial
}

/// An attacker sends recorded datagrams again: at once, and after one of the nodes has restarted.
fn repeated(seed: u64) -> Trial {
    let mut net = talking(seed);
    assert!(net.hosts.repeat() > 50);
    progress(&net);
    net.stop(C);
    net.start(C, &How::default());
    progress(&net);
    assert!(net.hosts.repeat() > 50);
    progress(&net);
    let (ended, trial) = result(net);
    assert!(dropped(&ended, &["replayed"]) > 0, "{:?}", ended.said);
    assert!(dropped(&ended, &["stale_session"]) > 0, "{:?}", ended.said);
    trial
}

/// A run in which `a` gets no answer for a while.
fn cut(seed: u64, cut: fn(&Net)) -> Trial {
    let net = talking(seed);
    cut(&net);
    gives_up(&net);
    thread::sleep(Duration::from_millis(seed % 7 * 100));
    let healed = now();
    net.hosts.heal();
    progress(&net);
    let trial = since(net, healed);
    assert!(trial.counts.cut > 0, "{trial:?}");
    trial
}

fn link_down(seed: u64) -> Trial {
    let (net, host) = (talking(seed), if seed.is_multiple_of(2) { A } else { B });
    net.hosts.link(host, "down");
    gives_up(&net);
    let up = now();
    net.hosts.link(host, "up");
    progress(&net);
    since(net, up)
}

fn stopped(seed: u64) -> Trial {
    let net = talking(seed);
    signal(net.pid(B), Signal::STOP);
    gives_up(&net);
    thread::sleep(Duration::from_millis(seed % 5 * 300));
    let goes_on = now();
    signal(net.pid(B), Signal::CONT);
    progress(&net);
    since(net, goes_on)
}

fn frozen(seed: u64) -> Trial {
    let net = talking(seed);
    let frozen = match Freezer::of([net.pid(B)].into_iter()) {
        Ok(frozen) => frozen,
        Err(why) => {
            println!("SKIPPED the freezer ({why}): nothing was frozen");
            return result(net).1;
        }
    };
    gives_up(&net);
    let goes_on = now();
    frozen.thaw();
    progress(&net);
    since(net, goes_on)
}

/// A run in which the disk with the recording of `nb` has only 16 kB.
fn disk_full(seed: u64) -> Trial {
    let mut net = Net::new(&talk(), NODES, seed);
    let disk = net.dir.path().join("disk");
    std::fs::create_dir(&disk).expect("a folder");
    let [full, out] = [&disk, net.dir.path()].map(|path| path.display().to_string());
    let script =
        format!("mount -t tmpfs -o size=16k none {full} && \"$@\"; code=$?; cp {full}/* {out}/; exit $code");
    let under = ["unshare", "-m", "sh", "-c", &script, "sh"].map(str::to_owned).into();
    net.start(C, &How::default());
    net.start(B, &How { under, record: Some(disk.join("start-1.imrs")), ..How::default() });
    net.start(A, &How::default());
    // Only the processes of that node see the disk.
    let disk = format!("/proc/{}/root{full}", net.pid(B));
    wait_until("the disk is full", || statvfs(&*disk).is_ok_and(|disk| disk.f_bavail == 0));
    progress(&net);
    let counts = net.hosts.counts();
    let mut ended = net.finish();
    let of_b = ended.said.iter().position(|(host, _)| *host == B).expect("it ended");
    let (_, said) = ended.said.remove(of_b);
    assert_eq!(said.code, Some(5), "{said:?}");
    for words in [" is no longer written: ", "imrs: incomplete: the recording "] {
        assert!(said.err.contains(words), "{said:?}");
    }
    let summary = said.last_json();
    assert_eq!(summary["nodes"][0]["exit"], "clean", "{summary}");
    let trial = Trial::of(&ended, counts);
    // The node went on without recording. The recording is judged up to its end.
    assert!(trial.outcome("replies") > trial.messages.executed, "{trial:?}");
    trial
}
