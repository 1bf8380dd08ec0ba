//! The scenes about the start of a node: a second start, a start elsewhere, without stored state, under bad conditions,
//! or with another cell than the others.

use super::cells::talk;
use super::hosts::Hosts;
use super::net::{How, Net};
use super::scenes::{
    A, ANSWERED, B, C, NODES, Scene, dropped, gives_up, progress, result, scene, since, talking,
};
use super::switch::Faults;
use super::trial::Trial;
use crate::support::{is_quiet, number, tape};
use imrs_runtime::actuator::now;
use imrs_wire::recording::{Record, ScriptStep};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

const FROM_KILL: &str = "from the kill to the next answer";

/// The scenes of this file.
pub const STARTS: [Scene; 9] = [
    scene("a node is killed and restarted on its port", FROM_KILL, restarted),
    scene("all nodes are killed and restarted", FROM_KILL, all_restarted),
    scene("a node loses its state", ANSWERED, state_lost),
    scene("a node loses its state and starts while it is cut off", ANSWERED, state_lost_alone),
    scene("nodes start while datagrams are lost, doubled and overtaken", ANSWERED, hard_start),
    scene("the addresses of two nodes are exchanged", ANSWERED, addresses_exchanged),
    scene("a clock is a day ahead", "", day_ahead),
    scene("a clock goes back a day when its node restarts", FROM_KILL, day_back),
    scene("a node has another cell file", "from the start of the last node to its complaint", other_cell),
];

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
fn incarnation(net: &Net, node: &str) -> PathBuf {
    net.dir.path().join(format!("state/imrs/hosts/{node}.life"))
}

fn state_lost(seed: u64) -> Trial {
    let mut net = talking(seed);
    net.kill(B);
    std::fs::remove_dir_all(net.dir.path().join("state/imrs/hosts")).expect("its state");
    let again = now();
    net.start(B, &How::default());
    // The other nodes still remember the incarnation that the node has forgotten.
    let stored = std::fs::read_to_string(incarnation(&net, "nb")).expect("its state");
    assert_eq!(stored.trim(), "1", "an incarnation that its neighbours have not heard");
    progress(&net);
    since(net, again)
}

fn all_restarted(seed: u64) -> Trial {
    let mut net = talking(seed);
    net.not_followed = Some("the nodes were restarted, and none of them was up all the time");
    let at = now();
    [A, B, C].into_iter().for_each(|host| net.kill(host));
    net.start_all(&How::default());
    progress(&net);
    since(net, at)
}

/// `na` forgets its incarnation, and no neighbour can tell it which it was. So `na` may use the ids of earlier messages
/// again, which its neighbours remember.
fn state_lost_alone(seed: u64) -> Trial {
    let mut net = talking(seed);
    net.not_followed = Some("two starts of a node had the same incarnation");
    net.kill(A);
    std::fs::remove_dir_all(net.dir.path().join("state/imrs/hosts")).expect("its state");
    net.hosts.isolate(A);
    net.start(A, &How::default());
    thread::sleep(Duration::from_millis(seed % 5 * 400));
    let healed = now();
    net.hosts.heal();
    progress(&net);
    since(net, healed)
}

fn hard_start(seed: u64) -> Trial {
    let mut net = Net::new(&talk(), NODES, seed);
    let delay = Duration::from_millis(80);
    net.hosts.set(Faults { loss: 0.3, duplication: 0.3, late: 0.3, delay, ..Faults::default() });
    net.start_all(&How::default());
    thread::sleep(Duration::from_millis(1_000));
    let healed = now();
    net.hosts.set(Faults::default());
    progress(&net);
    since(net, healed)
}

/// `na` is told the address of `nc` as that of `nb`, and the other way round.
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

/// The monotonic clocks of `nb` are a day ahead of those of the others.
fn day_ahead(seed: u64) -> Trial {
    let net = ahead(seed);
    result(net).1
}

/// The clock of `nb` is a day ahead at first, and that of the restarted `nb` is not: as after a restart of its machine.
fn day_back(seed: u64) -> Trial {
    let mut net = ahead(seed);
    let at = now();
    net.kill(B);
    net.start(B, &How::default());
    progress(&net);
    since(net, at)
}

fn ahead(seed: u64) -> Net {
    const DAY: &str = "86400";
    let mut net = Net::new(&talk(), NODES, seed);
    let under = ["unshare", "-T", "--monotonic", DAY, "--boottime", DAY].map(str::to_owned).into();
    net.start(C, &How::default());
    net.start(B, &How { under, ..How::default() });
    net.start(A, &How::default());
    progress(&net);
    // The recordings of all nodes are compared on one clock, so the times of this one are set back.
    net.before_judging(B, set_back);
    net
}

/// Sets the times of a recording back by a day.
fn set_back(file: &Path) {
    const DAY_US: u64 = 86_400_000_000;
    tape::change(file, file, |records| {
        for record in records {
            if let Record::Script { step: ScriptStep::Begin { at }, .. } = record {
                // Before its restart the node's clock was a day ahead; the restarted node has the clock of the others.
                if *at > now() {
                    *at -= DAY_US;
                }
            }
        }
    });
}

/// The node `nb` has other declarations than its neighbours. Both sides report this, and neither accepts a message of
/// the other.
fn other_cell(seed: u64) -> Trial {
    let mut net = Net::new(&talk(), NODES, seed);
    let cell = net.dir.path().join("other.cell");
    std::fs::write(&cell, talk().replace("bounded_buffer[8]", "bounded_buffer[9]"))
        .expect("the cell is written");
    net.start(C, &How::default());
    net.start(A, &How::default());
    let how = How { cell: Some(cell), is_unrecorded: true, is_text: true, ..How::default() };
    let mut program = net.launch(B, &how);
    let (begun, _) = program.line();
    let told = loop {
        let (at, line) = program.line();
        if line.contains("do not talk") {
            assert!(line.contains("their declarations differ"), "{line}");
            break at;
        }
    };
    let took = told.saturating_duration_since(begun);
    assert!(!is_quiet() || took < Duration::from_secs(1), "{took:?}");
    program.interrupt();
    assert_eq!(program.finish().code, Some(1));
    for host in [A, C] {
        let said = net.stop(host);
        assert!(said.code == Some(1) && said.err.contains("their declarations differ"), "{said:?}");
        assert_eq!(number(&said.last_json()["commands"]["replies"]), 0, "{said:?}");
    }
    net.replay();
    let took = Some(u64::try_from(took.as_micros()).expect("a short time"));
    Trial { took, counts: net.hosts.counts(), model: "not of one cell".into(), ..Trial::default() }
}
