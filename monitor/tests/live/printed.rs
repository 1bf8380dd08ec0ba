//! Tests of the output without a screen: one sample, or one per period.

use super::*;

/// Prints repeatedly until `is_so` accepts the output: on a busy machine a node may not answer in time for one sample.
fn printed(options: &Options, is_so: impl Fn(&str) -> bool) -> (Verdict, String) {
    let end = Instant::now() + LIMIT;
    loop {
        let (verdict, out) = print(options);
        match verdict {
            Ok(verdict) if is_so(&out) => return (verdict, out),
            other => assert!(Instant::now() < end, "{other:?}: {out}"),
        }
    }
}

fn print(options: &Options) -> (Result<Verdict, imrs_monitor::MonitorError>, String) {
    let mut out = Vec::new();
    let verdict = imrs_monitor::print(options, &mut out);
    (verdict, String::from_utf8(out).unwrap())
}

#[test]
fn one_sample_as_json_keeps_its_contract() {
    let (_temp, base) = base();
    serve(&base, 0..3);
    let options = Options { base: Some(base), once: true, format: Format::Json, ..Options::default() };
    let (verdict, out) = printed(&options, |out| out.matches("\"up\":true").count() == 3);
    assert_eq!(verdict, Verdict::Healthy);
    assert_eq!(out.matches('\n').count(), 1);
    let json: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(json["version"], 1);
    let nodes = json["nodes"].as_array().unwrap();
    assert_eq!(nodes.iter().map(|n| n["name"].as_str().unwrap()).collect::<Vec<_>>(), NODES);
    let node = &nodes[1];
    assert_eq!((&node["up"], &node["incarnation"]), (&true.into(), &1.into()));
    assert_eq!(node["transit"]["len"], 1);
    assert_eq!(node["transit"]["capacity"], 16);
    let task = &node["tasks"][0];
    assert_eq!((task["name"].as_str(), task["state"].as_str()), (Some("armR"), Some("waitfor")));
    let port = task["ports"].as_array().unwrap().iter().find(|p| p["name"] == "beat").unwrap();
    let keys = [
        "usage",
        "class",
        "len",
        "capacity",
        "min_slack_us",
        "enqueued",
        "delivered",
        "expired",
        "refused",
        "rejected",
        "evicted",
        "penalty_us",
    ];
    for key in keys {
        assert!(!port[key].is_null(), "{key} in {port}");
    }
    assert_eq!((&port["usage"], &port["class"], &port["len"]), (&"receive".into(), &2.into(), &3.into()));
    assert!(port["min_slack_us"].as_u64().unwrap() <= 7_000);
    let waitfor = &task["waitfor"][0];
    assert_eq!((&waitfor["port"], &waitfor["round"]), (&"lift".into(), &12.into()));
    assert_eq!(waitfor["state"], "gathering");
    assert_eq!(waitfor["members"][2]["task"], "hoist");
    assert_eq!(
        (&waitfor["members"][2]["arrived"], &waitfor["members"][0]["arrived"]),
        (&false.into(), &true.into())
    );
    assert!(
        waitfor["members"][0]["confirmed"] == false && waitfor["remaining_us"].as_u64().unwrap() <= 500_000
    );
}

#[test]
fn one_sample_as_text_has_no_escapes_and_names_who_is_missing() {
    let (_temp, base) = base();
    serve(&base, 0..2);
    let options = Options { base: Some(base), once: true, ..Options::default() };
    let (verdict, out) = printed(&options, |out| out.matches(": up").count() == 2);
    assert_eq!(verdict, Verdict::Finding);
    assert!(out.contains("CRITICAL nh: never seen"), "{out}");
    assert!(!out.contains('\u{1b}'));
    assert!(out.contains("waitfor lift r12: 2 of 3 arrived"), "{out}");
    assert!(out.contains("missing hoist@nh (never seen)"), "{out}");
}

#[test]
fn nothing_found_is_said_with_where_and_what_to_do() {
    let (_temp, base) = base();
    let (verdict, out) = print(&Options { base: Some(base.clone()), once: true, ..Options::default() });
    let error = verdict.unwrap_err();
    assert_eq!((error.exit_code(), out.as_str()), (3, ""));
    let text = error.to_string();
    assert!(text.contains("imrs demo beam-lift") && text.contains("no running node found under"), "{text}");
    let endpoint = Endpoint::Unix(base.join("none.sock"));
    let (verdict, _) = print(&Options { connect: vec![endpoint], once: true, ..Options::default() });
    let error = verdict.unwrap_err();
    assert_eq!(error.exit_code(), 3);
    assert!(error.to_string().contains("none.sock"), "{error}");
}

#[test]
fn a_stopped_node_does_not_hold_up_a_sample_of_the_others() {
    let (_temp, base) = base();
    listen(&base, NODES[0], |mut peer| peer.serve(0));
    listen(&base, NODES[1], |_peer| thread::sleep(LIMIT));
    let (send, done) = mpsc::channel();
    thread::spawn(move || {
        let options = Options { base: Some(base), once: true, ..Options::default() };
        let is_so = |out: &str| out.contains("node nl: up") && out.contains("cannot attach: unix:");
        send.send(printed(&options, is_so)).unwrap();
    });
    let (verdict, out) = done.recv_timeout(LIMIT).expect("it hangs");
    // A node that does not answer is a finding.
    assert_eq!(verdict, Verdict::Finding, "{out}");
}

#[test]
fn names_of_the_wire_are_printed_escaped_and_kept_in_json() {
    let (_temp, base) = base();
    listen(&base, "evil", |mut peer| {
        peer.hello(0, VERSION, SCHEMA).unwrap();
        let mut names = table();
        names.tasks[0].name = "arm\u{1b}]0;x\u{7}\u{202e}".into();
        peer.say(&ServerFrame::Table(names)).unwrap();
        let _ = peer.hear();
        let _ = peer.say(&ServerFrame::Snapshot(snapshot(0)));
        thread::sleep(LIMIT);
    });
    let options = |format| Options { base: Some(base.clone()), once: true, format, ..Options::default() };
    let (_, text) = printed(&options(Format::Text), |out| out.contains("arm"));
    assert!(text.contains("arm\\x1b]0;x\\x07\\u202e") && !text.contains('\u{1b}'), "{text}");
    let (_, json) = printed(&options(Format::Json), |out| out.contains("arm"));
    assert!(json.trim_end().chars().all(|c| !c.is_control() && c != '\u{202e}'), "{json}");
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["nodes"][0]["tasks"][0]["name"], "arm\u{1b}]0;x\u{7}\u{202e}");
    assert_eq!(json["nodes"][0]["name"], identity(0, 1).node);
}

/// A writer that accepts output until `enough` returns true, then acts like a closed pipe.
struct Reader<F> {
    enough: F,
    taken: Arc<std::sync::Mutex<String>>,
}

impl<F: Fn(&str) -> bool> std::io::Write for Reader<F> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let mut taken = self.taken.lock().unwrap();
        if taken.ends_with('\n') && (self.enough)(&taken) {
            return Err(std::io::ErrorKind::BrokenPipe.into());
        }
        taken.push_str(std::str::from_utf8(bytes).unwrap());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// The printed output up to the line at which `enough` returns true.
fn print_until(options: Options, enough: impl Fn(&str) -> bool + Send + 'static) -> String {
    let taken = Arc::new(std::sync::Mutex::new(String::new()));
    let mut out = Reader { enough, taken: taken.clone() };
    let (send, done) = mpsc::channel();
    thread::spawn(move || {
        let end = Instant::now() + LIMIT;
        let verdict = loop {
            match imrs_monitor::print(&options, &mut out) {
                // On a busy machine a node may answer later than the monitor waits.
                Err(imrs_monitor::MonitorError::NothingFound { .. }) if Instant::now() < end => {
                    out.taken.lock().unwrap().clear();
                }
                verdict => break verdict,
            }
        };
        send.send(verdict.unwrap()).unwrap();
    });
    let verdict = done.recv_timeout(2 * LIMIT).expect("it does not end with its reader");
    assert_eq!(verdict, Verdict::Healthy);
    let taken = taken.lock().unwrap();
    taken.clone()
}

#[test]
fn samples_are_printed_period_after_period_until_the_reader_has_gone() {
    let (_temp, base) = base();
    listen(&base, "nl", |mut peer| peer.serve(0));
    let watch = Some(Duration::from_millis(20));
    let options = Options { base: Some(base), watch, format: Format::Json, ..Options::default() };
    let out = print_until(options, |out| out.lines().count() >= 3);
    let lines: Vec<serde_json::Value> = out.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(lines.len(), 3);
    assert!(lines.iter().all(|l| l["nodes"][0]["up"] == true));
}

#[test]
fn lines_say_what_happens_while_it_happens() {
    let (_temp, base) = base();
    listen(&base, "nl", |mut peer| {
        peer.greet(0).unwrap();
        peer.say(&ServerFrame::Snapshot(snapshot(0))).unwrap();
        for round in 12.. {
            thread::sleep(Duration::from_millis(50));
            // The events alternate between two kinds, so that the journal does not combine them.
            let event = if round % 2 == 0 { Event::GaveUp } else { Event::PartnerAborted };
            let happened = observed(event, LIFT, 2, round);
            if peer.say(&ServerFrame::Events(events(0, &[happened]))).is_err() {
                return;
            }
        }
    });
    let options = Options { base: Some(base), text: true, ..Options::default() };
    let says = |line: &str| {
        line.contains("nl gave up lift at armL round ") || line.contains("nl aborted lift at armL round")
    };
    let out = print_until(options, move |out| out.lines().any(says));
    assert!(out.lines().last().is_some_and(says), "{out}");
    // If the machine stood still before the first sample, the node counts as silent.
    let stood = out.contains("node nl: up") || out.contains("node nl: SILENT");
    assert!(stood, "how it stood comes first: {out}");
}
