//! Tests of the crates as packages: the entries of their manifests, and those README examples that no crate
//! documentation contains.

use super::{CRATES, ROOT, read};
use imrs_model::{Options, Silent, verify};
use imrs_monitor::query::Filter;
use imrs_protocol::{
    Cell, CellTable, Contents, Incarnation, Instant, Node, NodeId, NodeInput, NodeOutbox, NodeTable, Outcome,
    PACKET_BYTES, Packet, PortDecl, Request, Signal, Target, TaskId, Ticks, Usage,
};
use imrs_wire::envelope::{Datagram, Digests, Envelope, EnvelopeError, Purpose, Session, open};
use std::error::Error;
use std::path::Path;
use std::sync::Arc;

#[test]
fn packages_describe_themselves() {
    for room in CRATES.into_iter().chain(["."]) {
        let manifest = read(&format!("{room}/Cargo.toml"));
        let value = |key: &str| {
            let line = manifest.lines().find_map(|line| line.strip_prefix(&format!("{key} = ")));
            line.unwrap_or_else(|| panic!("{room}/Cargo.toml has no {key}")).trim_matches('"').to_owned()
        };
        assert_eq!(value("documentation"), format!("https://docs.rs/{}", value("name")));
        assert!(
            Path::new(ROOT).join(room).join(value("readme")).exists(),
            "{room} has no {}",
            value("readme")
        );
        for list in ["keywords", "categories"] {
            assert!((1..=5).contains(&(value(list).matches('"').count() / 2)), "{list} of {room}");
        }
        assert!(!manifest.contains(concat!("example", ".invalid")), "{room} has an address that is none");
    }
}

#[derive(Default)]
struct Told {
    signals: Vec<(TaskId, Signal)>,
}

impl NodeOutbox for Told {
    fn link(&mut self, _next: NodeId, _packet: Packet) {}

    fn signal(&mut self, task: TaskId, signal: Signal) {
        self.signals.push((task, signal));
    }
}

#[test]
fn the_example_of_the_protocol_runs() -> Result<(), Box<dyn Error>> {
    let mut told = Told::default();
    let mut cell = Cell::new("greeting", Ticks(1_000));
    let here = cell.node("here");
    let (asker, answerer) = (cell.task("asker", here), cell.task("answerer", here));
    let ask = cell.port(PortDecl::new("ask", asker, Usage::Send, &[answerer], Ticks(500_000)).command());
    let table = Arc::new(CellTable::new(cell).expect("a sound cell"));
    let mut node = Node::new(NodeTable::new(table, here), Incarnation(0), false, 16);

    // Time is an input of the state machine: no task answers, so the command's time_out ends.
    let contents = Contents::new(b"how many?").ok_or("too long")?;
    let question = Request::Send { port: ask, to: Target::One(answerer), contents, time_out: None };
    node.step(Instant::START, NodeInput::Request(asker, question), &mut told);
    node.step(Instant(500_000), NodeInput::Time, &mut told);
    assert_eq!(told.signals, [(asker, Signal::Outcome(Outcome::TimedOutUnknown))]);
    Ok(())
}

#[test]
fn the_example_of_the_wire_runs() -> Result<(), Box<dyn Error>> {
    let digests = Digests { cell: 0xdead_beef, statements: 0 };
    let (sender, receiver, incarnation) = (NodeId(1), NodeId(2), Incarnation(0));
    let (session, purpose) = (Session(77), Purpose::Packets);
    let (restarted, counter, tx_mono, echo) = (false, 0, 0, None);
    let envelope =
        Envelope { sender, receiver, incarnation, restarted, session, counter, tx_mono, echo, purpose };
    let mut datagram = Datagram::default();
    assert!(datagram.push(&[7; PACKET_BYTES]));
    let mut bytes = datagram.seal(&envelope, digests).to_vec();
    assert_eq!(open(&bytes, receiver, digests, |_| true)?.1, [[7; PACKET_BYTES]]);

    bytes[50] ^= 1;
    assert_eq!(open(&bytes, receiver, digests, |_| true), Err(EnvelopeError::Checksum));
    Ok(())
}

#[test]
fn the_example_of_the_model_runs() {
    let options = Options { full: false, claim: Some("pairing".into()), jobs: 1, memory: 2 << 30 };
    let report = verify(&options, &Silent);
    for verdict in &report.claims {
        println!("{} under {}: {:?}", verdict.name, verdict.rule, verdict.outcome);
    }
    assert!(report.claims.iter().all(|verdict| verdict.as_expected));
}

#[test]
fn the_example_of_the_monitor_runs() -> Result<(), Box<dyn Error>> {
    let urgent = Filter::parse("class=2 and slack<5ms")?;
    assert!(urgent.is_some());
    let mistake = Filter::parse("slak<5ms").expect_err("a field that does not exist");
    println!("{mistake}");
    Ok(())
}
