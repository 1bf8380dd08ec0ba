//! The fault matrix of the monitor (M15): each fault that is injected into running nodes raises its own finding and no unrelated
//! one. Nodes without a fault raise none. The cells are slow, so that a busy machine by itself causes no finding.

mod cells;
mod named;
mod scene;
mod starved;
mod told;

use crate::support::live::{Seen, figure, named};
use crate::support::{Said, bound, look_until, own_address, side_by_side, signal};
use cells::{CIRCLE, CRASH, FLOOD, LATE, LIGHT, NO_SPACE, SLOW, STARVED, WATCHED, two_texts};
use imrs_wire::envelope::VERSION;
use rustix::process::Signal;
use scene::Scene;
use serde_json::Value;
use std::collections::BTreeSet;
use std::net::UdpSocket;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

#[test]
fn a_healthy_run_raises_nothing() {
    // `.ci/long` runs this for half an hour.
    Scene::start(WATCHED, &[]).is_calm_for(Duration::from_secs(bound("IMRS_HEALTHY", 10)));
}

#[test]
fn a_killed_node_is_dead_and_those_who_wait_for_it_are_told() {
    let related = ["node-dead", "rendezvous-lost-member", "time-outs", "link-discards"];
    let mut scene = Scene::start(WATCHED, &[]);
    scene.is_calm_for(Duration::from_secs(1));
    let since = Instant::now();
    signal(scene.node("nb").pid, Signal::KILL);
    for lint in ["node-dead", "rendezvous-lost-member"] {
        scene.raises(since, lint, &related);
    }
}

#[test]
fn a_node_that_comes_back_is_no_fault_any_more() {
    let (host, ports) = own_address::<3>();
    let text = ["na", "nb", "nc"].iter().zip(ports).fold(WATCHED.to_owned(), |text, (node, port)| {
        text.replacen(&format!("node {node};"), &format!("node {node} at \"{host}\" port {port};"), 1)
    });
    let mut scene =
        Scene::of(&[(&text, &["--node", "nb"]), (&text, &["--node", "nc"]), (&text, &["--node", "na"])]);
    // The first nodes may send before the last node has started. The monitor reports this as a fault until it is over.
    scene.is_over("it is a fault that others come later", BTreeSet::is_empty);
    let since = scene.kill("nb");
    // The node stays down until the monitor has shown its death.
    scene.raises(since, "node-dead", &["rendezvous-lost-member", "time-outs", "link-discards"]);
    scene.start_node(&text, "nb");
    scene.is_over("it is a fault", BTreeSet::is_empty);
    scene.is_calm_for(Duration::from_secs(1));
}

#[test]
fn a_restarted_node_says_how_long_it_is_held_back() {
    // The script is held back for so long that a monitor notices it on any machine.
    let text = WATCHED.replace("time_out = 20 sec", "time_out = 2000 sec") + LIGHT;
    let (take, took) = ("  use_port news(n: int16)  usage = receive;", "on receive news(n) do skip; end;");
    let text = text
        .replace(take, &format!("{take}\n  use_port light(n: int16)  usage = receive;"))
        .replace("order news > self", "order news > light > self")
        .replace(took, &format!("{took}\n  on receive light(n) do skip; end;"));
    let mut scene = Scene::start(&text, &["--kill", "nb@1s", "--restart", "nb@2s"]);
    let others = ["node-dead", "rendezvous-lost-member", "time-outs", "link-discards"];
    scene.raises(scene.started, "held-back", &others);
    let report = scene.report();
    assert!(named(&report["nodes"], "nc")["held_back_us"].is_null(), "{report}");
    let nodes = report["nodes"].as_array().expect("nodes");
    let again = nodes.iter().find(|node| node["name"] == "nb" && node["up"] == true).expect("its next life");
    let left = named(&again["tasks"], "b")["held_back_us"].as_u64().expect("held back");
    assert_eq!(again["held_back_us"], left, "{report}");
    // The other task of the node is not held back.
    assert!(named(&again["tasks"], "d")["held_back_us"].is_null(), "{report}");
    let works = |report: &Value| {
        let again =
            report["nodes"].as_array()?.iter().find(|node| node["name"] == "nb" && node["up"] == true)?;
        named(&named(&again["tasks"], "d")["ports"], "light")["sent"].as_u64().filter(|sent| *sent > 0)
    };
    Seen::by_monitor(scene.dir()).until("its other task works", |report| works(report).is_some());
    assert!((1..=2_000_100_000).contains(&left), "{report}");
    let found = report["findings"].as_array().expect("findings");
    let found = found.iter().find(|found| found["code"] == "held-back").expect("a finding");
    let words = format!(
        "held back {} s more: commands of its earlier incarnation may still arrive",
        left.div_ceil(1_000_000)
    );
    assert_eq!([&found["node"], &found["task"], &found["text"]], ["nb", "b", &words], "{report}");
    let says =
        |said: &Said| said.out.contains("task b: held back ") && said.out.contains(" s more: commands of");
    look_until(scene.dir(), &["monitor", "--once", "--format", "text"], "what is held back", says);
}

#[test]
fn a_stopped_node_is_silent_until_it_goes_on() {
    let mut scene = Scene::start(WATCHED, &[]);
    scene.is_calm_for(Duration::from_secs(1));
    let (since, pid) = (Instant::now(), scene.node("nb").pid);
    signal(pid, Signal::STOP);
    // On a late machine the node is silent for so long that the partners' waitfor nearly times out.
    scene.raises(since, "node-silent", &["time-outs", "rendezvous-stuck"]);
    signal(pid, Signal::CONT);
    scene.is_over("it is silent", |codes| !codes.contains("node-silent"));
}

#[test]
fn more_news_than_are_taken_are_a_flood() {
    let mut scene = Scene::start(FLOOD, &[]);
    let since = scene.started + Duration::from_secs(2);
    scene.raises(since, "status-flood", &["refused"]);
}

#[test]
fn commands_without_space_are_refused() {
    let mut scene = Scene::waiting(NO_SPACE);
    let since = scene.go();
    // The command that was sent first is more urgent. If it arrives second, it evicts the command that was sent second.
    scene.raises(since, "refused", &["command-evicted"]);
}

#[test]
fn a_message_that_waits_too_long_is_at_risk_and_then_expired() {
    let mut scene = Scene::waiting(SLOW);
    let sent = scene.go();
    // A tenth of the message's TTL remains at this time.
    let since = sent + Duration::from_millis(5400);
    scene.raises_before(since, "deadline-risk", "expired", "nb");
    scene.is_over("it is at risk", |codes| !codes.contains("deadline-risk"));
    let since = sent + Duration::from_secs(6);
    scene.raises(since, "expired", &[]);
}

#[test]
fn a_rendezvous_whose_patience_ends_is_stuck() {
    let mut scene = Scene::start(LATE, &[]);
    // A quarter of the task's time_out remains at this time.
    let since = scene.started + Duration::from_secs(9);
    scene.raises_before(since, "rendezvous-stuck", "time-outs", "na");
}

#[test]
fn tasks_that_ask_each_other_wait_in_a_circle() {
    let mut scene = Scene::start(CIRCLE, &[]);
    let since = scene.started + Duration::from_secs(2);
    scene.raises(since, "wait-cycle", &[]);
}

#[test]
fn a_question_that_is_rejected_again_and_again_starves() {
    let mut scene = Scene::start(STARVED, &[]);
    // By this time there were three rejections, with the penalty between them.
    let since = scene.started + Duration::from_millis(2600);
    scene.raises(since, "starving", &[]);
}

#[test]
fn questions_over_a_cut_link_time_out() {
    let text = WATCHED.replace("user_list = {b}  time_out = 20 sec", "user_list = {b}  time_out = 2 sec");
    let mut scene = Scene::start(&text, &["--cut", "na--nb@2s+60s"]);
    // While the link is cut, `a` waits for the answer of `b`, and `b` waits for `a` at the rendezvous: a cycle.
    let consequences = ["time-outs", "wait-cycle", "rendezvous-stuck"];
    scene.raises(scene.started + Duration::from_secs(4), "time-outs", &["wait-cycle", "link-cut"]);
    // Packets go on being sent, and none has arrived for two seconds.
    scene.raises(scene.started + Duration::from_secs(6), "link-cut", &consequences);
}

#[test]
fn datagrams_of_strangers_break_the_integrity_or_are_of_another_version() {
    let cases = [([0x9d, 0x4d, VERSION, 0], "integrity"), ([0x9d, 0x4d, 99, 0], "version-mismatch")];
    side_by_side(cases, |(bytes, lint)| {
        let mut scene = Scene::start(WATCHED, &["--insecure"]);
        scene.is_calm_for(Duration::from_secs(1));
        let since = Instant::now();
        let stranger = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        let datagram = [&bytes[..], &[7; 96]].concat();
        stranger.send_to(&datagram, scene.node("nb").address.expect("a socket")).expect("it is sent");
        scene.raises(since, lint, &[]);
    });
}

#[test]
fn more_datagrams_than_the_kernel_keeps_are_told() {
    let mut scene = Scene::start(WATCHED, &[]);
    scene.is_calm_for(Duration::from_secs(1));
    let (pid, address) = (scene.node("nb").pid, scene.node("nb").address.expect("a socket"));
    signal(pid, Signal::STOP);
    let stranger = UdpSocket::bind("127.0.0.1:0").expect("a socket");
    for _ in 0..20_000 {
        // An error means that the kernel's queue is full, which is intended.
        let _ = stranger.send_to(&[7; 1400], address);
    }
    signal(pid, Signal::CONT);
    let since = Instant::now();
    // The kernel reports its drop count with the next datagram that finds room.
    let (over, is_over) = mpsc::channel::<()>();
    let more = std::thread::spawn(move || {
        while is_over.recv_timeout(Duration::from_millis(50)) == Err(RecvTimeoutError::Timeout) {
            let _ = stranger.send_to(&[7; 20], address);
        }
    });
    scene.raises(since, "kernel-residency", &["integrity", "time-outs", "node-silent", "wait-cycle"]);
    drop(over);
    more.join().expect("it only sends");
}

#[test]
fn nodes_of_two_texts_of_a_cell_are_told_apart() {
    let [one, other] = two_texts();
    let mut scene = Scene::of(&[(&one, &["--node", "na"]), (&other, &["--node", "nb"])]);
    let since = scene.started;
    // The first node sends before the second one has started.
    scene.raises(since, "digest-mismatch", &["link-discards"]);
}

#[test]
fn real_time_that_is_refused_is_noted() {
    let mut scene = Scene::start(WATCHED, &["--rt"]);
    let report = scene.report();
    let had = |node: &Value| node["real_time"] == "had";
    if report["nodes"].as_array().expect("nodes").iter().all(had) {
        scene.is_calm_for(Duration::from_secs(1));
        return;
    }
    let since = scene.started;
    scene.raises(since, "no-real-time", &[]);
}

#[test]
fn a_task_that_runs_on_and_on_has_crashed() {
    let mut scene = Scene::start(CRASH, &[]);
    let since = scene.started + Duration::from_secs(2);
    scene.raises(since, "task-crashed", &["refused", "status-flood", "events-lost"]);
}

#[test]
fn a_monitor_that_does_not_read_is_told_what_it_missed() {
    let text = "\
cell chat;
tick 1 msec;
node na;
task a on na
  port news(n: int16)  usage = send  user_list = {b}  time_out = 2 sec  class = 1  bounded_buffer[64];
  var n: int16;
begin
  loop
    n := 0;
    while n < 50 do send news(n); n := n + 1; end;
    delay 1 msec;
  end;
end a;
task b on na
  use_port news(n: int16)  usage = receive;
begin
  order news > self;
  on receive news(n) do skip; end;
  loop delay 1 sec; end;
end b;
";
    let mut scene = Scene::start(text, &[]);
    let monitor = scene.monitor.pid();
    signal(monitor, Signal::STOP);
    // The task sends more events than all buffers between node and monitor can hold.
    let mut other = Seen::by_monitor(scene.dir());
    let sent = |seen: &Value| figure(seen, "a", "news", "sent");
    let before = sent(&other.until("it is seen", |seen| sent(seen) > 0));
    other.until("many more are sent", |seen| sent(seen) > before + 150_000);
    drop(other);
    signal(monitor, Signal::CONT);
    let since = Instant::now();
    // The monitor knows the age of the node's last report only once it has read all frames.
    scene.raises(
        since,
        "events-lost",
        &["node-silent", "refused", "status-flood", "evicted", "expired", "deadline-risk", "timer-late"],
    );
}
