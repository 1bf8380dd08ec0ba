//! Runs two cells of the documents on three hosts, over UDP and over zenoh, and compares their summaries (D211).

use super::guide;
use super::hosts::{Hosts, are_possible};
use super::net::{How, Net};
use super::zenoh::{Carried, Transport, datagrams};
use crate::support::live::{figure, released};
use crate::support::{example, number, run_in};
use serde_json::Value;
use std::net::Ipv4Addr;

/// A cell of the documents, with one node for each host.
struct Demo {
    name: &'static str,
    nodes: &'static [&'static str],
    text: fn() -> String,
    /// What stands for the address of each node in the text.
    places: [&'static str; 3],
    /// Whether a monitor's sample shows that enough has happened.
    is_done: fn(&Value) -> bool,
}

/// The guide's cell on three machines: a robot and a press meet once, and six parts go by commands.
const LINE: Demo = Demo {
    name: "the guide's line",
    nodes: &["feeding", "pressing", "watching"],
    text: guide::cell_of_the_chapter,
    places: ["\"127.77.83.1\" port 7411", "\"127.77.83.2\" port 7411", "\"127.77.83.3\" port 7411"],
    is_done: |sample| figure(sample, "panel", "count", "delivered") >= 6,
};

/// The demonstration of two arms and a hoist, ten times as slow: its links take at most 10 ms, as zenoh needs.
const BEAM: Demo = Demo {
    name: "beam-lift, ten times as slow",
    nodes: &["nl", "nr", "nh"],
    text: || slower(&std::fs::read_to_string(example("beam_lift.cell")).expect("an example"), 10),
    places: ["\"10.0.0.11\"", "\"10.0.0.12\"", "\"10.0.0.13\""],
    is_done: |sample| released(sample, "armL") >= 3,
};

/// How the datagrams of a run go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    Udp,
    Zenoh,
    /// Over zenoh, and the router is stopped ten times for 200 ms.
    Stalled,
}

/// The text of a cell in which all times are `by` times as long.
fn slower(text: &str, by: u32) -> String {
    let code = text.lines().map(|line| line.split_once("//").map_or(line, |(code, _)| code));
    let mut words: Vec<String> = Vec::new();
    for word in code.flat_map(|line| line.split_inclusive(' ').chain(["\n"])) {
        if matches!(word.trim_end_matches([' ', ';', ',']), "msec" | "sec")
            && let Some(length) = words.last_mut()
        {
            let times = |time: &str| time.trim().parse::<u32>().map(|time| (time * by).to_string());
            let times: Vec<String> = length.split("..").map(|time| times(time).expect("a time")).collect();
            *length = times.join("..") + " ";
        }
        words.push(word.to_owned());
    }
    words.concat()
}

/// Runs a demonstration, and returns the summary of the whole cell.
fn run(demo: &Demo, way: Way, seed: u64) -> Value {
    let place = |text: String, (host, place): (usize, &&str)| {
        assert!(text.contains(place), "{text}");
        let (ip, port) = match way {
            Way::Udp => (Hosts::address(host), 7_000),
            Way::Zenoh | Way::Stalled => (Ipv4Addr::LOCALHOST, 7_000 + host),
        };
        text.replace(place, &format!("\"{ip}\" port {port}"))
    };
    let text = demo.places.iter().enumerate().fold((demo.text)(), place);
    let mut net = Net::on(Hosts::new(demo.nodes.len() + 1, seed), &text, demo.nodes);
    let carried = (way != Way::Udp).then(|| Carried::start(&net, Transport::Tcp));
    let report = |node: &str| net.dir.path().join(format!("{node}.json")).display().to_string();
    let reports: Vec<String> = demo.nodes.iter().map(|node| report(node)).collect();
    for host in (0..demo.nodes.len()).rev() {
        net.start(host, &How { args: vec!["--report".into(), reports[host].clone()], ..How::default() });
    }
    for _ in 0..if way == Way::Stalled { 10 } else { 0 } {
        carried.iter().for_each(Carried::stall);
        net.until("a node is seen", |sample| {
            sample["nodes"].as_array().is_some_and(|nodes| !nodes.is_empty())
        });
    }
    net.until("enough has happened", demo.is_done);
    let cell = net.cell.clone();
    let ended = net.finish();
    let messages = ended.evidence.messages;
    assert!(messages.executed > 0 && messages.stale == 0 && messages.twice == 0, "{way:?}: {messages:?}");
    let files: Vec<&str> = reports.iter().map(String::as_str).collect();
    let args = [&["summary", cell.to_str().expect("UTF-8")], &files[..], &["--format", "json"]].concat();
    let said = run_in(ended.dir.path(), &args);
    let whole = said.last_json();
    let [out, into] = carried.map_or_else(|| datagrams(&ended), Carried::finish);
    let (meet, commands) = (&whole["rendezvous"][0], &whole["commands"]);
    println!(
        "| {} | {way:?} | {} released all, {} none, {} some; {} false | {} answered of {} that were sent | {} | {out}, {into} |",
        demo.name,
        meet["released"],
        meet["timed_out"],
        meet["divergent"],
        meet["false_releases"],
        commands["replies"],
        messages.commands,
        messages.stale
    );
    whole
}

#[test]
fn demonstrations_over_zenoh_have_the_rendezvous_and_the_commands_that_they_have_over_udp() {
    if !are_possible() {
        return;
    }
    println!(
        "| cell | the way | rounds | commands | stale | datagrams that went out, came in |\n|---|---|---|---|---|---|"
    );
    for way in [Way::Udp, Way::Zenoh, Way::Stalled] {
        let line = run(&LINE, way, 1);
        let meet = &line["rendezvous"][0];
        // Robot and press meet once. A round before that may time out, because the other node has not started yet.
        let outcome = ["released", "divergent", "unknown", "false_releases"].map(|name| number(&meet[name]));
        assert_eq!(outcome, [1, 0, 0, 0], "{way:?}: {line}");
        let part = line["ports"].as_array().expect("ports").iter().filter(|port| port["name"] == "part");
        let part: Vec<u64> = part.map(|port| number(&port["delivered"])).collect();
        assert_eq!(part.iter().sum::<u64>(), 6, "{way:?}: {line}");
        let beam = run(&BEAM, way, 1);
        let meet = &beam["rendezvous"][0];
        let outcome = ["timed_out", "divergent", "unknown", "false_releases"].map(|name| number(&meet[name]));
        assert!(number(&meet["released"]) >= 2 && outcome == [0; 4], "{way:?}: {beam}");
        assert!(number(&beam["commands"]["replies"]) > 0, "{way:?}: {beam}");
    }
}

#[test]
fn a_slower_cell_has_longer_times_and_no_other_difference() {
    let slow = slower(
        "tick 1 msec;  // 2 sec\nrun ready takes 0..500 msec;\non silence beat 3 sec when x < 2 do",
        10,
    );
    assert_eq!(
        slow,
        "tick 10 msec;  \nrun ready takes 0..5000 msec;\non silence beat 30 sec when x < 2 do\n"
    );
}
