//! The scenes of the cell in which three tasks talk: each has one fault, and goes on until the tasks talk as before.

use super::cells::talk;
use super::hosts::Hosts;
use super::net::{Ended, How, Net};
use super::switch::Faults;
use super::trial::Trial;
use crate::support::live::{figure, released};
use crate::support::{Said, number, signal, tape, wait_until};
use crate::two_owners::freezer::Freezer;
use imrs_runtime::actuator::now;
use imrs_wire::recording::{Record, ScriptStep};
use rustix::fs::statvfs;
use rustix::process::Signal;
use std::path::Path;
use std::thread;
use std::time::Duration;

pub const NODES: &[&str] = &["na", "nb", "nc"];
/// The hosts of the nodes.
pub const A: usize = 0;
pub const B: usize = 1;
pub const C: usize = 2;

/// A scene, and what its time is.
pub struct Scene {
    pub name: &'static str,
    /// What the time of a trial measures.
    pub took: &'static str,
    /// Runs a trial with this seed.
    pub run: fn(u64) -> Trial,
}

const fn scene(name: &'static str, took: &'static str, run: fn(u64) -> Trial) -> Scene {
    Scene { name, took, run }
}

const ANSWERED: &str = "from the end of the fault to the next answer";

/// The scenes of this file.
pub const SCENES: [Scene; 17] = [
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
    scene("a node is killed and restarted on its port", "from the kill to the next answer", restarted),
    scene("a node loses its state", ANSWERED, state_lost),
    scene("the addresses of two nodes are exchanged", ANSWERED, addresses_exchanged),
    scene("the disk of a recording is full", "", disk_full),
    scene("a clock is a day ahead", "", day_ahead),
];

/// The cell, whose tasks talk.
fn talking(seed: u64) -> Net {
    let net = Net::started(&talk(), NODES, seed);
    progress(&net);
    net
}

/// Waits until all three tasks have met several times more. Between two meetings `a` asks `b`, and sends to `c`.
fn progress(net: &Net) {
    let mut first = None;
    net.until("all talk", |sample| {
        let met = released(sample, "a");
        met >= *first.get_or_insert(met) + 3
    });
}

/// Waits until `a` has given up a command since this was called.
fn gives_up(net: &Net) {
    let mut first = None;
    net.until("a command times out", |sample| {
        let given_up = figure(sample, "a", "ask", "timed_out");
        given_up > *first.get_or_insert(given_up)
    });
}

/// Waits until `a` has ended so many commands more, in whatever way.
fn asks(net: &Net, more: u64) {
    let mut first = None;
    net.until("commands end", |sample| {
        let sent = figure(sample, "a", "ask", "sent");
        sent >= *first.get_or_insert(sent) + more
    });
}

/// The result of a run, whose time began at this instant.
fn since(net: Net, at: u64) -> Trial {
    let (ended, trial) = result(net);
    Trial { took: ended.evidence.first(true, at), ..trial }
}

fn result(net: Net) -> (Ended, Trial) {
    let counts = net.hosts.counts();
    let ended = net.finish();
    let trial = Trial::of(&ended, counts);
    assert!(trial.outcome("replies") >= 3, "{trial:?}");
    (ended, trial)
}

/// How many datagrams all links dropped for these reasons.
fn dropped(ended: &Ended, reasons: &[&str]) -> u64 {
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
    // Every copy is dropped where it arrives, but the last ones may come after the end of their node.
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

fn restarted(seed: u64) -> Trial {
    let mut net = talking(seed);
    let at = now();
    net.kill(B);
    thread::sleep(Duration::from_millis(seed % 4 * 50));
    net.start(B, &How::default());
    progress(&net);
    since(net, at)
}

/// The file with the incarnation of a node.
fn incarnation(net: &Net, node: &str) -> std::path::PathBuf {
    net.dir.path().join(format!("state/imrs/hosts/{node}.life"))
}

fn state_lost(seed: u64) -> Trial {
    let mut net = talking(seed);
    net.kill(B);
    std::fs::remove_dir_all(net.dir.path().join("state/imrs/hosts")).expect("its state");
    let again = now();
    net.start(B, &How::default());
    // The other nodes remember the incarnation that the node has forgotten.
    let stored = std::fs::read_to_string(incarnation(&net, "nb")).expect("its state");
    assert_eq!(stored.trim(), "1", "an incarnation that its neighbours have not heard");
    progress(&net);
    since(net, again)
}

/// `na` looks for `nb` at the address of `nc`, and the other way round.
fn addresses_exchanged(seed: u64) -> Trial {
    let mut net = Net::new(&talk(), NODES, seed);
    let [b, c] = [B, C].map(|host| Hosts::address(host).to_string());
    let text = talk().replace(&b, "THERE").replace(&c, &b).replace("THERE", &c);
    let cell = net.dir.path().join("exchanged.cell");
    std::fs::write(&cell, text).expect("the cell is written");
    net.start(C, &How::default());
    net.start(B, &How::default());
    net.start(A, &How { cell: Some(cell), ..How::default() });
    gives_up(&net);
    let said = net.stop(A);
    let summary = said.last_json();
    assert_eq!(number(&summary["commands"]["replies"]), 0, "{summary}");
    let again = now();
    net.start(A, &How::default());
    progress(&net);
    let counts = net.hosts.counts();
    let ended = net.finish();
    assert!(dropped(&ended, &["misdelivered"]) > 0, "{:?}", ended.said);
    let trial = Trial::of(&ended, counts);
    Trial { took: ended.evidence.first(true, again), ..trial }
}

/// The recording of `nb` is on a disk of 16 kB.
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
    // The node went on without its recording, which is judged as far as it goes.
    assert!(trial.outcome("replies") > trial.messages.executed, "{trial:?}");
    trial
}

/// The monotonic clocks of `nb` are a day ahead of those of the others.
fn day_ahead(seed: u64) -> Trial {
    const DAY: &str = "86400";
    let mut net = Net::new(&talk(), NODES, seed);
    let under = ["unshare", "-T", "--monotonic", DAY, "--boottime", DAY].map(str::to_owned).into();
    net.start(C, &How::default());
    net.start(B, &How { under, ..How::default() });
    net.start(A, &How::default());
    progress(&net);
    // A recording is compared with those of the others on their clock.
    net.before_judging(B, set_back);
    result(net).1
}

/// Sets the times of a recording back by a day.
fn set_back(file: &Path) {
    const DAY_US: u64 = 86_400_000_000;
    tape::change(file, file, |records| {
        for record in records {
            if let Record::Script { step: ScriptStep::Begin { at }, .. } = record {
                *at = at.checked_sub(DAY_US).expect("a clock that is a day ahead");
            }
        }
    });
}
