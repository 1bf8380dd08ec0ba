//! Tests what a run reports about its links: delays against the declared bound, damage, and datagrams that no node
//! sent.

use crate::kept_out::Between;
use crate::support::live::named;
use crate::support::program::Program;
use crate::support::{Said, imrs, is_whole, number, own_address, run_in, runtime_dir, signal};
use rustix::process::Signal;
use serde_json::Value;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::net::{Ipv4Addr, UdpSocket};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A cell of two nodes that send each other statuses for ever.
fn cell(dir: &Path, name: &str, own: Ipv4Addr, [a, b]: [u16; 2]) -> String {
    let task = |me: &str, other: &str, mine: &str, theirs: &str| {
        format!(
            "task {me} on n{me}
  port {mine}(n: int16)  usage = send  user_list = {{{other}}}  time_out = 2 sec  class = 1  bounded_buffer[8];
  use_port {theirs}(n: int16)  usage = receive;
begin
  order {theirs} > self;
  on receive {theirs}(n) do skip; end;
  loop send {mine}(1); delay 5 msec; end;
end {me};
"
        )
    };
    let text = format!(
        "cell news;
tick 1 msec;
node na at \"{own}\" port {a};  node nb at \"{own}\" port {b};
link na -- nb delay 50 msec;
{}{}",
        task("a", "b", "ping", "pong"),
        task("b", "a", "pong", "ping")
    );
    let file = dir.join(name);
    std::fs::write(&file, text).expect("the cell is written");
    file.to_str().expect("UTF-8").into()
}

/// The summary of node `name`.
fn node<'a>(summary: &'a Value, name: &str) -> &'a Value {
    named(&summary["nodes"], name)
}

#[test]
fn the_summary_has_the_delays_of_each_link_beside_its_bound() {
    let dir = runtime_dir();
    let (own, ports) = own_address();
    let cell = cell(dir.path(), "news.cell", own, ports);
    let said = run_in(dir.path(), &["run", &cell, "--for", "2s", "--format", "json"]);
    assert_eq!(said.code, Some(0), "{said:?}");
    let summary = said.last_json();
    for (to, from) in [("na", "nb"), ("nb", "na")] {
        let link = &node(&summary, to)["links"][0];
        assert_eq!((&link["from"], &link["bound_us"]), (&from.into(), &50_000.into()), "{link}");
        let [p50, p99, max] = ["p50_us", "p99_us", "max_us"].map(|name| number(&link["delay"][name]));
        assert!(number(&link["delay"]["count"]) > 0 && p50 <= p99 && p99 <= max, "{link}");
        assert_eq!(link["integrity"]["failures"], 0, "{link}");
        assert_eq!(node(&summary, to)["security"]["alarms"], 0, "{summary}");
    }
    let said = run_in(dir.path(), &["run", &cell, "--for", "1s"]);
    let line = said.out.lines().find_map(|line| line.strip_prefix("    link from na: ")).expect("a link");
    assert!(
        line.starts_with("p50 ") && line.ends_with(" of 50 ms") || line.starts_with("too few "),
        "{said:?}"
    );
}

/// Damages a third of the datagrams that pass, chosen by a hash of their number. If every third datagram were damaged,
/// nodes that take turns could lose the same datagram of each handshake.
fn damage(bytes: &mut [u8]) {
    static PASSED: AtomicUsize = AtomicUsize::new(0);
    let mut hasher = DefaultHasher::new();
    PASSED.fetch_add(1, Ordering::Relaxed).hash(&mut hasher);
    if hasher.finish().is_multiple_of(3)
        && let Some(last) = bytes.last_mut()
    {
        *last ^= 1;
    }
}

#[test]
fn a_link_that_damages_datagrams_is_faulty_on_the_screen_in_the_summary_and_in_the_exit_code() {
    if !is_whole() {
        // On a busy machine the line once did not come within minutes.
        eprintln!("*** SKIPPED: a link damages datagrams with IMRS_WHOLE=1 only ***");
        return;
    }
    let dir = runtime_dir();
    let (own, ports) = own_address();
    let between = Between::new(own, ports, damage);
    let [to_nb, to_na] = between.ports();
    let here = cell(dir.path(), "here.cell", own, [ports[0], to_nb]);
    let there = cell(dir.path(), "there.cell", own, [to_na, ports[1]]);
    let keys = dir.path().join("keys").to_str().expect("UTF-8").to_owned();
    let made = run_in(dir.path(), &["keygen", &here, "--out", &keys]);
    assert_eq!(made.code, Some(0), "{made:?}");
    let start = |cell: &str, node: &str| {
        let args = ["run", cell, "--node", node, "--for", "10m", "--keys", &keys];
        Program::start(imrs(dir.path(), &args))
    };
    let (other, mut node) = (start(&there, "nb"), start(&here, "na"));
    while !node.line().1.contains("link nb -> na is faulty: ") {}
    for one in [node, other] {
        one.interrupt();
        let said: Said = one.finish();
        // Both directions of the link have the same damage, so the other node may call the link faulty, too.
        let is_faulty = said.out.contains(" is faulty: ");
        assert!(said.code == Some(6) || !is_faulty && said.code == Some(0), "{said:?}");
    }
}

#[test]
fn a_node_that_stops_in_order_tells_its_neighbours() {
    let dir = runtime_dir();
    let (own, ports) = own_address();
    let cell = cell(dir.path(), "news.cell", own, ports);
    let made = run_in(dir.path(), &["keygen", &cell]);
    assert_eq!(made.code, Some(0), "{made:?}");
    let start =
        |node: &str| Program::start(imrs(dir.path(), &["run", &cell, "--node", node, "--for", "10m"]));
    let (other, mut node) = (start("nb"), start("na"));
    // The test sends SIGTERM below, as a service manager does to stop a node. Before that, the nodes must have
    // communicated.
    let mut seen = crate::support::live::Seen::by_monitor(dir.path());
    seen.until("the nodes have talked", |seen| {
        let links = named(&seen["nodes"], "na")["links"].as_array().cloned().unwrap_or_default();
        links.iter().any(|link| number(&link["delay"]["count"]) + number(&link["unmeasured"]) > 0)
    });
    signal(other.pid(), Signal::TERM);
    let said = other.finish();
    assert_eq!(said.code, Some(0), "{said:?}");
    while !node.line().1.contains("node nb has stopped in order, it says to na") {}
    node.interrupt();
    let said = node.finish();
    assert_eq!(said.code, Some(0), "{said:?}");
}

#[test]
fn garbage_of_strangers_is_an_alarm_and_no_fault_of_a_link() {
    let dir = runtime_dir();
    let (own, ports) = own_address();
    let cell = cell(dir.path(), "news.cell", own, ports);
    let mut run = Program::start(imrs(dir.path(), &["run", &cell, "--for", "10m", "--format", "json"]));
    let started = run.json();
    let address = named(&started["started"], "na")["address"].as_str().expect("an address").to_owned();
    let stranger = UdpSocket::bind((own, 0)).expect("a socket");
    for _ in 0..40 {
        stranger.send_to(&[7; 120], &address).expect("it leaves");
    }
    // A monitor shows these counts once the node has dropped the datagrams.
    crate::support::live::Seen::by_monitor(dir.path()).until("garbage is counted", |seen| {
        let drops = named(&seen["nodes"], "na")["link_discards"].as_array().cloned().unwrap_or_default();
        drops.iter().any(|of| of["reason"] == "not_imrs" && number(&of["count"]) > 8)
    });
    run.interrupt();
    let said = run.finish();
    assert_eq!(said.code, Some(6), "{said:?}");
    let summary = said.last_json();
    let security = &node(&summary, "na")["security"];
    assert!(security["alarms"] == 1 && number(&security["events"]["not_imrs"]) > 8, "{security}");
    assert_eq!(node(&summary, "na")["links"][0]["integrity"]["failures"], 0, "{summary}");
    assert_eq!(node(&summary, "nb")["security"]["alarms"], 0, "{summary}");
}
