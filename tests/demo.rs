//! The demos as they are shipped: real processes, real sockets, real faults. Bounds of time are wide: the machine may be
//! busy. What must hold on any machine is exact.

mod support;

use imrs_protocol::{Incarnation, NodeId, PACKET_BYTES};
use imrs_wire::envelope::{Datagram, Envelope};
use imrs_wire::recording::RecordingReader;
use rustix::process::Signal;
use serde_json::Value;
use std::fs::File;
use std::net::UdpSocket;
use std::thread;
use std::time::Duration;
use support::{Demo, is_alive, is_well, run, run_in, runtime_dir, signal, wait_until};

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("no number: {value}"))
}

/// What no fault of the demo's own kind may break.
fn check(summary: &Value) -> &Value {
    assert_ne!(summary["outcome"]["held"], false, "{summary}");
    check_rounds(summary)
}

/// What nothing may break.
fn check_rounds(summary: &Value) -> &Value {
    let lift = &summary["rendezvous"][0];
    assert_eq!(lift["port"], "lift", "{summary}");
    assert_eq!(number(&lift["false_releases"]), 0, "{summary}");
    let ends = ["released", "timed_out", "divergent", "unknown"].map(|end| number(&lift[end]));
    assert_eq!(number(&lift["rounds"]), ends.iter().sum::<u64>(), "{summary}");
    lift
}

fn node<'a>(summary: &'a Value, name: &str) -> &'a Value {
    let nodes = summary["nodes"].as_array().expect("nodes");
    nodes.iter().find(|node| node["name"] == name).expect("a node of the cell")
}

#[test]
fn without_faults_everybody_starts_together() {
    let (summary, code, errors) = Demo::start(&["--for", "2800ms", "--no-fault"]).finish();
    let lift = check(&summary);
    assert!(is_well(code, &errors), "{errors}");
    assert_eq!(summary["version"], 1);
    assert!(number(&lift["released"]) >= 1, "{summary}");
    assert_eq!((number(&lift["divergent"]), number(&lift["unknown"])), (0, 0), "{summary}");
    for figure in ["p50", "p99", "max"] {
        assert!(number(&lift["start_skew_us"][figure]) > 0, "{summary}");
    }
    for port in summary["ports"].as_array().expect("ports") {
        for figure in ["sent", "delivered", "expired", "refused", "timed_out"] {
            assert!(port[figure].is_u64(), "{figure} of {port}");
        }
    }
    assert!(number(&summary["commands"]["replies"]) > 0, "{summary}");
    assert!(
        summary["nodes"].as_array().expect("nodes").iter().all(|node| node["exit"] == "clean"),
        "{summary}"
    );
}

#[test]
fn the_text_is_for_people_and_has_no_escapes_in_a_pipe() {
    let said = run(&["demo", "beam-lift", "--no-fault", "--for", "2500ms"]);
    assert!(is_well(said.code, &said.err), "{said:?}");
    assert!(!said.out.contains('\u{1b}') && said.err.is_empty(), "{said:?}");
    for words in ["imrs monitor", "false releases: 0", "start skew:", "What happened", "The arms lifted"] {
        assert!(said.out.contains(words), "`{words}` is missing in\n{}", said.out);
    }
    assert!(said.out.lines().all(|line| line.chars().count() <= 120), "{}", said.out);
}

/// The fault comes when the arms move; on a machine that is busy enough it comes too late, and the demo says so.
#[test]
fn a_link_that_fails_in_mid_lift_stops_both_arms() {
    for attempt in 0..3 {
        let said = run(&["demo", "beam-lift", "--seed", "3"]);
        assert!(is_well(said.code, &said.err), "{said:?}");
        assert!(said.out.contains("went dead"), "{said:?}");
        if said.out.contains("Nothing moved just then") && attempt < 2 {
            continue;
        }
        for words in
            ["armL asked `beat` and got TIME_OUT", "armR", "Neither arm ever went on alone", "As promised"]
        {
            assert!(said.out.contains(words), "`{words}` is missing in\n{}", said.out);
        }
        return;
    }
}

#[test]
fn when_the_robots_node_dies_the_other_takes_over_and_looks_at_the_spot() {
    let said = run(&["demo", "failover-weld", "--seed", "3"]);
    assert!(is_well(said.code, &said.err), "{said:?}");
    for words in [
        "the node of r1 was killed, in the middle of `weld 0`",
        "TAKES OVER",
        "r2 began with `recheck 0`",
        "At no instant were both robots active",
        "As promised",
    ] {
        assert!(said.out.contains(words), "`{words}` is missing in\n{}", said.out);
    }
    // They reach each other through nt, which passes their packets on.
    assert!(
        said.out.lines().any(|line| line.contains("node nt") && line.contains("passed on")),
        "{}",
        said.out
    );
}

#[test]
fn the_tool_of_a_dead_robot_goes_to_another() {
    let said = run(&["demo", "shared-tool", "--seed", "3"]);
    assert!(is_well(said.code, &said.err), "{said:?}");
    for words in [
        "the node of weldA was killed, and weldA had the tool",
        "Nobody brought it back",
        "At no instant had two of them the tool",
        "As promised",
    ] {
        assert!(said.out.contains(words), "`{words}` is missing in\n{}", said.out);
    }
}

#[test]
fn a_camera_that_stands_still_costs_time_and_no_wrong_grip() {
    for (how, words) in [(&[][..], "node nc stood still for"), (&["--in-process"], "node nc was cut off for")]
    {
        let said = run(&[&["demo", "conveyor", "--seed", "3", "--format", "json"][..], how].concat());
        assert!(is_well(said.code, &said.err), "{said:?}");
        let summary = said.last_json();
        assert_eq!(summary["outcome"]["held"], true, "{summary}");
        assert!(summary["outcome"]["words"].to_string().contains(words), "{summary}");
        // No part is left out: how many were taken, and where each is.
        let parts = summary["outcome"]["words"][0].as_str().expect("a sentence");
        let numbers = parts.split(|c: char| !c.is_ascii_digit()).filter_map(|number| number.parse().ok());
        let numbers: Vec<u64> = numbers.collect();
        assert!(numbers.len() >= 3 && numbers[0] == numbers[1..].iter().sum::<u64>(), "{parts}");
        assert_eq!(number(&summary["rendezvous"][0]["false_releases"]), 0, "{summary}");
        // Who stood still ended well.
        assert_eq!(node(&summary, "nc")["exit"], "clean", "{summary}");
    }
}

#[test]
fn of_two_that_change_the_speed_at_once_one_gives_way() {
    let said = run(&["demo", "belt-administrator", "--seed", "3"]);
    assert!(is_well(said.code, &said.err), "{said:?}");
    for words in ["both had asked for another speed", "gave way", "No version of the speed was changed twice"]
    {
        assert!(said.out.contains(words), "`{words}` is missing in\n{}", said.out);
    }
}

#[test]
fn a_robot_that_is_cut_off_stops_before_the_other_takes_over() {
    let demo = ["demo", "failover-weld", "--cut", "n1--nt@1s+9s", "--for", "4s", "--format", "json"];
    let said = run(&demo);
    assert!(is_well(said.code, &said.err), "{said:?}");
    let summary = said.last_json();
    assert_eq!(summary["outcome"]["held"], true, "{summary}");
    let words = summary["outcome"]["words"].to_string();
    assert!(words.contains("the lease of r1 ran out") && words.contains("took over"), "{words}");
}

#[test]
fn lost_packets_cost_time_but_never_a_false_start() {
    let (summary, code, errors) = Demo::start(&["--for", "5s", "--loss", "20%", "--seed", "5"]).finish();
    let lift = check(&summary);
    assert!(is_well(code, &errors), "{errors}");
    assert!(number(&lift["rounds"]) > 0, "{summary}");
    assert!(
        summary["nodes"].as_array().unwrap().iter().all(|n| number(&n["lost_on_purpose"]) > 0),
        "{summary}"
    );
    let resent: u64 = summary["ports"].as_array().unwrap().iter().map(|port| number(&port["resent"])).sum();
    assert!(resent > 0, "{summary}");
    assert_eq!(summary["loss"], 0.2);
}

#[test]
fn with_the_hoist_killed_both_arms_get_their_time_out() {
    let (summary, code, errors) = Demo::start(&["--for", "6s", "--kill", "hoist@1ms"]).finish();
    let lift = check(&summary);
    assert!(is_well(code, &errors), "{errors}");
    assert_eq!(number(&lift["released"]), 0, "{summary}");
    assert_eq!(node(&summary, "nh")["exit"], "killed");
    let after = summary["after_kill"].as_array().expect("who gave up");
    for arm in ["armL", "armR"] {
        let gave_up = after.iter().find(|a| a["task"] == arm).unwrap_or_else(|| panic!("{arm} in {summary}"));
        let (waited, time_out) = (number(&gave_up["waited_us"]), number(&gave_up["time_out_us"]));
        // Never early; late only by what a busy machine adds.
        assert!(waited >= time_out && waited < time_out + 2_000_000, "{gave_up}");
    }
}

#[test]
fn a_killed_node_lives_again_and_the_others_hear_of_it() {
    for how in [&[][..], &["--in-process"]] {
        let args = ["--kill", "nt@1s", "--restart", "dresser@1500ms", "--for", "9s", "--format", "json"];
        let said = run(&[&["demo", "failover-weld"], &args[..], how].concat());
        let summary = said.last_json();
        assert!(is_well(said.code, &said.err), "{said:?}");
        let relay = node(&summary, "nt");
        assert_eq!((&relay["exit"], number(&relay["lives"])), (&"clean".into(), 2), "{summary}");
        // Its second life passes packets on.
        assert!(number(&relay["forwarded"]) > 0, "{summary}");
        assert_eq!(summary["outcome"]["held"], true, "{summary}");
    }
}

#[test]
fn who_dies_and_lives_again_is_not_said_to_have_gone_on_meanwhile() {
    for (name, args) in [
        ("failover-weld", ["--kill", "n1@1s", "--restart", "r1@3s", "--for", "5s"]),
        ("beam-lift", ["--kill", "nr@1500ms", "--restart", "nr@3s", "--for", "7s"]),
    ] {
        let said = run(&[&["demo", name, "--seed", "3", "--format", "json"], &args[..]].concat());
        assert!(is_well(said.code, &said.err), "{said:?}");
        let summary = said.last_json();
        assert_ne!(summary["outcome"]["held"], false, "{summary}");
        assert!(
            summary["nodes"].as_array().unwrap().iter().any(|node| number(&node["lives"]) == 2),
            "{summary}"
        );
        for meeting in summary["rendezvous"].as_array().unwrap() {
            assert_eq!(number(&meeting["false_releases"]), 0, "{summary}");
        }
    }
}

#[test]
fn a_node_that_stood_still_carries_out_nothing_old() {
    let demo = Demo::start(&["--for", "8s", "--no-fault"]);
    let right = demo.pid("nr");
    thread::sleep(Duration::from_millis(800));
    signal(right, Signal::STOP);
    // Longer than anything lives in this cell.
    thread::sleep(Duration::from_secs(5));
    signal(right, Signal::CONT);
    let (summary, code, errors) = demo.finish();
    let lift = check_rounds(&summary);
    // The partners gave up, as their scripts say. An arm whose node is frozen in mid lift cannot stop: the demo says so.
    let alone = summary["outcome"]["held"] == false;
    assert!(!alone || summary["outcome"]["words"].to_string().contains("armR moved on for"), "{summary}");
    assert!(code == Some(0) || code == Some(1) && (alone || errors.contains("aborted")), "{errors}");
    // They went on announcing themselves; what waited for the node in its kernel came out old.
    assert!(number(&node(&summary, "nr")["discards"]["expired_on_the_way"]) > 0, "{summary}");
    assert!(number(&lift["timed_out"]) + number(&lift["divergent"]) > 0, "{summary}");
}

#[test]
fn a_cut_link_is_survived() {
    let (summary, code, errors) = Demo::start(&["--for", "5s", "--cut", "nl--nr@500ms+1s"]).finish();
    let lift = check(&summary);
    assert!(is_well(code, &errors), "{errors}");
    assert!(number(&node(&summary, "nl")["cut_off"]) > 0, "{summary}");
    assert!(number(&lift["released"]) > 0, "{summary}");
}

#[test]
fn garbage_is_counted_by_reason_and_does_no_harm() {
    let dir = runtime_dir();
    let file = dir.path().join("run.imrs");
    let demo = Demo::start(&["--for", "5s", "--loss", "1%", "--record", file.to_str().unwrap()]);
    let recorded = dir.path().join("run.nl.imrs");
    wait_until("the recording has its header", || {
        File::open(&recorded).is_ok_and(|file| RecordingReader::new(file).is_ok())
    });
    let digest = RecordingReader::new(File::open(&recorded).unwrap()).unwrap().header().digest;

    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let target = demo.address("nl");
    let mut sent = 0;
    let mut send = |bytes: &[u8]| {
        socket.send_to(bytes, target).unwrap();
        sent += 1;
        if sent % 32 == 0 {
            // The node's queue in the kernel is bounded.
            thread::sleep(Duration::from_millis(5));
        }
    };
    for first in 0..=255_u8 {
        let mut bytes = [first; 72];
        bytes[1] = !first;
        send(&bytes);
    }
    let envelope = Envelope {
        sender: NodeId(1),
        incarnation: Incarnation(0),
        restarted: false,
        counter: 1,
        tx_mono: 0,
        echo: None,
    };
    let mut datagram = Datagram::default();
    datagram.push(&[0; PACKET_BYTES]);
    send(datagram.seal(&envelope, digest ^ 1));
    send(datagram.seal(&Envelope { sender: NodeId(9), ..envelope }, digest));
    let whole = datagram.seal(&envelope, digest).to_vec();
    (0..whole.len()).for_each(|length| send(&whole[..length]));
    for bit in 0..whole.len() * 8 {
        let mut flipped = whole.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        send(&flipped);
    }

    let seen = run_in(demo.dir.path(), &["monitor", "--once", "--format", "json"]);
    assert!(seen.out.contains("link_discards"), "{seen:?}");
    let (summary, code, errors) = demo.finish();
    let lift = check(&summary);
    assert!(is_well(code, &errors), "{errors}");
    assert!(number(&lift["released"]) > 0, "{summary}");
    assert_eq!(node(&summary, "nl")["exit"], "clean");
    let counted = &node(&summary, "nl")["link_discards"];
    for (reason, least) in [
        ("not_imrs", 200),
        ("version", 4),
        ("mode", 4),
        ("other_cell", 1),
        ("unknown_node", 1),
        ("too_short", 30),
        ("checksum", 400),
    ] {
        assert!(counted.get(reason).is_some_and(|n| number(n) >= least), "{reason} in {counted}");
    }
}

/// Where the record begins that holds this byte.
fn record_near(bytes: &[u8], byte: usize) -> usize {
    let mut at = 12;
    loop {
        let length: [u8; 4] = bytes[at..at + 4].try_into().unwrap();
        let next = at + 12 + u32::from_le_bytes(length) as usize;
        if next > byte {
            return at;
        }
        at = next;
    }
}

#[test]
fn what_was_recorded_replays_bit_equal_and_a_changed_file_is_noticed() {
    let dir = runtime_dir();
    let file = dir.path().join("run.imrs");
    let (summary, code, errors) =
        Demo::start(&["--for", "3s", "--loss", "10%", "--record", file.to_str().unwrap()]).finish();
    check(&summary);
    assert!(is_well(code, &errors), "{errors}");
    for (node, task) in [("nl", "armL"), ("nr", "armR"), ("nh", "hoist")] {
        let recorded = dir.path().join(format!("run.{node}.imrs"));
        let said = run(&["replay", recorded.to_str().unwrap(), "--format", "json"]);
        assert_eq!(said.code, Some(0), "{said:?}");
        let replayed = said.last_json();
        assert_eq!((&replayed["whole"], &replayed["node"]), (&Value::from(true), &Value::from(node)));
        let of = &replayed["tasks"][0];
        assert_eq!((&of["name"], &of["divergence"], &of["lost"]), (&task.into(), &Value::Null, &0.into()));
        assert!(number(&of["steps"]) > 20, "{replayed}");
    }
    let recorded = dir.path().join("run.nl.imrs");
    let whole = std::fs::read(&recorded).unwrap();
    let at = record_near(&whole, whole.len() / 2);
    let replayed = |bytes: &[u8]| {
        std::fs::write(&recorded, bytes).unwrap();
        run(&["replay", recorded.to_str().unwrap()])
    };
    // In the length, its checksum, that of the contents, and the contents.
    for place in [0, 2, 3, 5, 9, 12] {
        let mut damaged = whole.clone();
        damaged[at + place] ^= 1;
        let said = replayed(&damaged);
        assert_eq!(said.code, Some(2), "{said:?}");
        assert!(said.err.contains(&format!("at byte {at}: the record is damaged")), "{}", said.err);
    }
    // A file that was cut off is as good as far as it goes.
    for length in [at + 5, at + 20] {
        let said = replayed(&whole[..length]);
        assert_eq!(said.code, Some(0), "{said:?}");
        assert!(said.out.contains("was cut off"), "{}", said.out);
    }
}

#[test]
fn a_monitor_sees_the_nodes_while_they_run() {
    let demo = Demo::start(&["--for", "5s", "--loss", "1%"]);
    let mut nodes = Value::Null;
    wait_until("all nodes are seen", || {
        let said = run_in(demo.dir.path(), &["monitor", "--once", "--format", "json"]);
        if said.code == Some(0) {
            nodes = said.last_json()["nodes"].take();
        }
        nodes.as_array().is_some_and(|nodes| nodes.len() == 3 && nodes.iter().all(|node| node["up"] == true))
    });
    let left = nodes.as_array().unwrap().iter().find(|node| node["name"] == "nl").expect("the left node");
    assert!(left["incarnation"].is_u64() && left["transit"]["capacity"].is_u64(), "{left}");
    let task = &left["tasks"][0];
    assert_eq!(task["name"], "armL");
    let ports = task["ports"].as_array().expect("ports");
    for port in ports {
        for figure in
            ["class", "len", "capacity", "enqueued", "delivered", "expired", "refused", "rejected", "evicted"]
        {
            assert!(port[figure].is_u64(), "{figure} of {port}");
        }
        assert!(port.get("min_slack_us").is_some() && port["usage"].is_string(), "{port}");
    }
    let lift = &task["waitfor"][0];
    assert_eq!(
        (&lift["port"], lift["members"].as_array().map(Vec::len)),
        (&"lift".into(), Some(3)),
        "{lift}"
    );
    assert!(lift["round"].is_u64() && lift["state"].is_string(), "{lift}");
    let (summary, code, errors) = demo.finish();
    check(&summary);
    assert!(is_well(code, &errors), "{errors}");
}

#[test]
fn ctrl_c_ends_the_run_in_order_with_its_summary() {
    let demo = Demo::start(&["--for", "10m"]);
    let nodes: Vec<u32> = demo.nodes.iter().map(|(_, pid, _)| *pid).collect();
    thread::sleep(Duration::from_millis(500));
    signal(demo.launcher(), Signal::INT);
    let (summary, code, errors) = demo.finish();
    check(&summary);
    assert!(is_well(code, &errors), "{errors}");
    assert!(summary["nodes"].as_array().unwrap().iter().all(|node| node["exit"] == "clean"), "{summary}");
    assert!(nodes.iter().all(|&pid| !is_alive(pid)));
}

#[test]
fn no_node_outlives_its_launcher() {
    let demo = Demo::start(&["--for", "10m"]);
    let nodes: Vec<u32> = demo.nodes.iter().map(|(_, pid, _)| *pid).collect();
    assert!(nodes.iter().all(|&pid| is_alive(pid)));
    signal(demo.launcher(), Signal::KILL);
    wait_until("all nodes have ended", || nodes.iter().all(|&pid| !is_alive(pid)));
}

#[test]
fn a_node_that_somebody_else_ends_is_a_finding() {
    let demo = Demo::start(&["--for", "2s"]);
    signal(demo.pid("nr"), Signal::KILL);
    let (summary, code, errors) = demo.finish();
    check(&summary);
    assert_eq!(code, Some(1), "{errors}");
    assert_eq!(node(&summary, "nr")["exit"], "ended by signal 9");
    assert!(errors.contains("nr"), "{errors}");
}
