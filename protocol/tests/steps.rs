//! A node that is inspected between its steps (D39): its pending effects are part of its state, and are packed like its
//! other parts (D51).

use crate::support::{
    NextExpiry, arrive, get, get_on, packet as packet_in_words, reply, send, send_for,
    signal as signal_in_words,
};
use imrs_protocol::*;
use std::sync::Arc;

const X: TaskId = TaskId(0);
const Y: TaskId = TaskId(1);
const Z: TaskId = TaskId(2);
const N1: NodeId = NodeId(1);

/// The port for commands from X and Z to Y.
const MOVE: PortId = PortId(0);
/// The port for commands from X and Y to Z.
const FAR: PortId = PortId(1);
/// The port of the waitfor of X, Y and Z.
const LIFT: PortId = PortId(2);

/// A cell with X and Y on one node, and Z on another, two ticks away.
fn cell() -> Cell {
    let mut cell = Cell::new("steps", Ticks(1));
    let (here, there) = (cell.node("here"), cell.node("there"));
    cell.link(here, there, Ticks(2));
    for (name, node) in [("x", here), ("y", here), ("z", there)] {
        cell.task(name, node);
    }
    let commands = |name, to, users: &[TaskId]| {
        PortDecl::new(name, to, Usage::Receive, users, Ticks(30)).command().bounded_buffer(4)
    };
    cell.port(commands("move", Y, &[X, Z]));
    cell.port(commands("far", Z, &[X, Y]));
    cell.port(PortDecl::new("lift", X, Usage::Waitfor, &[Y, Z], Ticks(60)).resend(Ticks(20), 0));
    cell
}

/// The packets that left a node, and the signals that reached a task of it.
#[derive(Default)]
struct Outside {
    /// Whether the link takes packets now.
    open: bool,
    words: Vec<String>,
    told: Vec<Signal>,
}

impl NodeOutbox for Outside {
    fn ready(&mut self, _: NodeId) -> bool {
        self.open
    }
    fn link(&mut self, next: NodeId, packet: Packet) {
        self.words.push(format!("to {next}: {}", unnumbered(&packet_in_words(&packet))));
    }
    fn signal(&mut self, task: TaskId, signal: Signal) {
        self.words.push(format!("{task}: {}", unnumbered(&signal_in_words(&signal))));
        self.told.push(signal);
    }
}

/// Removes from a text the numbers that packed states hold only relative to other numbers.
fn unnumbered(words: &str) -> String {
    let round =
        |word: &str| word.strip_prefix('r').is_some_and(|n| n.starts_with(|c: char| c.is_ascii_digit()));
    let number = |word: &&str| !(word.starts_with('#') || round(word));
    words.split(' ').filter(number).collect::<Vec<_>>().join(" ")
}

/// A pass that finds the least round of the waitfor in the state of a node.
#[derive(Default)]
struct Bases {
    round: Option<Round>,
}

impl Walk for Bases {
    const PASS: Pass = Pass::Look;

    fn round(&mut self, _: PortId, round: &mut Round) {
        self.round = Some(self.round.filter(|least| !least.is_newer_than(*round)).unwrap_or(*round));
    }
}

/// A node that the test steps one pending effect at a time.
#[derive(Clone)]
struct Steps(Node);

impl Steps {
    fn new(transit: u16) -> Self {
        let table = NodeTable::new(Arc::new(CellTable::new(cell()).expect("a checked cell")), NodeId(0));
        Self(Node::new(table, Incarnation(0), false, transit))
    }

    /// The numbers to which packed numbers are relative. The test chooses the numbers of Z.
    fn bases(&mut self) -> (Vec<Round>, Vec<Seq24>) {
        let mut bases = Bases::default();
        let mut sequences: Vec<Seq24> = Vec::new();
        let parts = self.0.parts_mut();
        for task in &mut parts.tasks {
            task.walk(&parts.table, &mut bases);
            sequences.push(task.next_sequence());
        }
        self.0.walk_work(&mut bases);
        sequences.push(Seq24::new(9));
        (vec![bases.round.unwrap_or_default(); 3], sequences)
    }

    fn packed(&mut self, (rounds, sequences): &(Vec<Round>, Vec<Seq24>)) -> [Vec<u8>; 4] {
        let frame = Frame { rounds, sequences, incarnations: true };
        let Parts { table, tasks, transit, timer } = self.0.parts_mut();
        let all = Encode::bytes(&frame, |w| tasks.iter_mut().for_each(|task| task.walk(table, w)));
        let transit = Encode::bytes(&frame, |w| transit.walk(table, w));
        let timer = Encode::bytes(&frame, |w| timer.walk(w));
        let work = Encode::bytes(&frame, |w| self.0.walk_work(w));
        [all, transit, timer, work].map(|bytes| bytes.expect("it fits"))
    }

    /// Packs the node and reads it back into its state before the last step, so that no field is right by chance.
    fn read_back(&self, mut into: Self) -> Self {
        let mut buried = self.clone();
        buried.0.parts_mut().tasks.iter_mut().for_each(CommTask::bury);
        let bases = buried.bases();
        let bytes = buried.packed(&bases);
        let [tasks, transit, timer, work] = &bytes;
        let parts = into.0.parts_mut();
        let Parts { table, .. } = parts;
        let read = Decode::read(tasks, true, |r| parts.tasks.iter_mut().for_each(|task| task.walk(table, r)));
        assert_eq!(read, tasks.len());
        assert_eq!(Decode::read(transit, true, |r| parts.transit.walk(table, r)), transit.len());
        assert_eq!(Decode::read(timer, true, |r| parts.timer.walk(r)), timer.len());
        assert_eq!(Decode::read(work, true, |r| into.0.walk_work(r)), work.len());
        let home = (vec![Frame::ROUND; 3], vec![Frame::SEQUENCE; 3]);
        assert_eq!(into.packed(&home), bytes, "other bytes after reading back");
        assert_eq!(into.0.is_busy(), self.0.is_busy());
        into
    }

    /// Takes one input. After every step a node that was packed and read back must behave as this node does. Returns what
    /// happened, and how many steps the input took.
    fn take(&mut self, input: NodeInput, open: bool) -> (Outside, usize) {
        self.take_after(0, input, open)
    }

    fn take_after(&mut self, ticks: u64, input: NodeInput, open: bool) -> (Outside, usize) {
        let mut out = Outside { open, ..Outside::default() };
        let mut before = self.clone();
        self.0.begin(self.0.now() + Ticks(ticks), input, &mut out);
        self.0.file(&mut out);
        let mut steps = 0;
        loop {
            let [mut plain, mut read] =
                [(self.clone(), String::new()), (self.read_back(before), String::new())];
            for (node, words) in [&mut plain, &mut read] {
                let mut out = Outside { open, ..Outside::default() };
                while node.next(&mut out) {}
                node.0.flush(&mut out);
                *words = out.words.join("\n");
            }
            assert_eq!(read.1, plain.1, "after {steps} steps of {input:?}");
            before = self.clone();
            if !self.next(&mut out) {
                break;
            }
            steps += 1;
        }
        assert!(!self.0.is_busy());
        self.0.flush(&mut out);
        (out, steps)
    }

    /// Hands the first queued input to its task. Returns false if no input is queued.
    fn next(&mut self, out: &mut Outside) -> bool {
        let waits = self.0.is_busy();
        self.0.take(0, out);
        self.0.file(out);
        waits
    }

    fn ask(&mut self, task: TaskId, request: Request) -> Vec<String> {
        self.take(NodeInput::Request(task, request), true).0.words
    }

    fn pass(&mut self, ticks: u64) -> Vec<String> {
        self.take_after(ticks, NodeInput::Time, true).0.words
    }
}

/// A packet that Z sends to a task of the node.
fn from_z(kind: Kind, to: TaskId, port: PortId, contents: Contents) -> NodeInput {
    let packet = Packet {
        kind,
        destination: to,
        source: Z,
        port,
        id: MessageId { incarnation: Incarnation(0), sequence: Seq24::new(8) },
        remaining: Ticks(20),
        contents,
        ..Packet::BLANK
    };
    NodeInput::Packet { from: N1, packet, charge: Ticks(2) }
}

#[test]
fn a_command_between_two_tasks_of_a_node_may_be_looked_at_on_its_way() {
    let mut node = Steps::new(4);
    node.ask(Y, get(20));
    let (out, steps) = node.take(NodeInput::Request(X, send(MOVE, Y, 7)), true);
    assert_eq!((out.words, steps), (vec!["T1: message [7] from T0 for 30".into()], 1), "the delivery");
    let [Signal::Message(command)] = out.told[..] else { panic!("{:?}", out.told) };
    assert_eq!(node.ask(Y, reply(&command, 3)), ["T1: accepted 1", "T0: reply [3]"]);
    let (out, _) = node.take(from_z(Kind::Send, Y, MOVE, Contents::EMPTY), true);
    assert_eq!(out.words, Vec::<String>::new());
    assert_eq!(node.ask(Y, get_on(MOVE, 0)), ["T1: message [] from T2 for 16"], "less the way back (D18)");
}

#[test]
fn a_meeting_may_be_looked_at_between_its_members_arrivals() {
    let mut node = Steps::new(4);
    node.pass(3);
    let first = node.ask(X, arrive(LIFT));
    assert_eq!(first, ["to N1: ARRIVE T0>T2 for 60"]);
    assert_eq!(node.ask(Y, arrive(LIFT)), ["to N1: ARRIVE T1>T2 for 60"]);
    let arrival = Meeting { round: Round(1), released: Round(0), arguments: [0; 8] }.to_contents();
    let (out, _) = node.take(from_z(Kind::Arrive, X, LIFT, arrival), true);
    assert!(out.words.contains(&"T0: released complete".into()), "{:?}", out.words);
    assert!(out.words.contains(&"T1: released by T0".into()), "{:?}", out.words);
}

#[test]
fn a_packet_that_never_left_may_be_looked_at_on_its_way_back() {
    let mut node = Steps::new(1);
    let (out, _) = node.take(NodeInput::Request(X, send_for(FAR, Z, 1, 25)), false);
    assert_eq!(out.words, Vec::<String>::new());
    let (out, steps) = node.take(NodeInput::Request(Y, send_for(FAR, Z, 2, 20)), false);
    assert_eq!(out.words, ["T0: Refused"], "the more urgent one took its place (D19)");
    assert!(steps >= 2, "into the buffer, and word to X");
    assert_eq!(node.pass(1), ["to N1: SEND T1>T2 [2] for 19"]);
}

#[test]
fn delays_are_with_the_timer_at_once_and_its_word_may_be_looked_at_on_its_way() {
    let mut node = Steps::new(4);
    let delay = |length| Request::Delay { id: TimeId(3), length: Ticks(length) };
    let (_, steps) = node.take(NodeInput::Request(X, delay(9)), true);
    assert_eq!(steps, 0, "nobody else takes the arming");
    node.ask(Y, delay(5));
    assert_eq!(node.pass(5), ["T1: time_out 3"]);
    let (out, steps) = node.take(NodeInput::Request(X, Request::Cancel), true);
    assert_eq!((out.words, steps), (vec!["T0: cancelled".into()], 0), "nor the disarming");
    assert_eq!(node.0.next_expiry(), None);
    // Packing a node with an effect that has not been carried out is an error: the packed form never silently leaves the
    // effect out.
    node.0.begin(Instant::START, NodeInput::Request(X, delay(300)), &mut Outside::default());
    let (rounds, sequences) = node.bases();
    let frame = Frame { rounds: &rounds, sequences: &sequences, incarnations: true };
    assert_eq!(Encode::bytes(&frame, |w| node.0.walk_work(w)), Err(Overflow));
}

/// A time-out is queued while its task stops the timer, or starts it again. `file`, which queues inputs,
/// drops the time-out.
#[test]
fn a_report_of_an_earlier_start_is_dropped() {
    let start = Request::Start { id: TimeId(1), length: Ticks(5) };
    for (again, expected) in [(Request::Stop { id: TimeId(1) }, 0), (start, 1)] {
        let mut node = Steps::new(4);
        node.ask(X, start);
        let mut out = Outside::default();
        node.0.let_pass(node.0.now() + Ticks(5), &mut out);
        assert_eq!(node.0.inputs(), 1, "the word");
        node.0.begin(node.0.now(), NodeInput::Request(X, again), &mut out);
        node.0.file(&mut out);
        assert_eq!(node.0.inputs(), 0, "{again:?}");
        assert_eq!(node.0.next_expiry().into_iter().count(), expected, "{again:?}");
    }
}

#[test]
fn news_of_a_restart_may_be_looked_at_between_two_tasks() {
    let mut node = Steps::new(4);
    node.ask(X, send(FAR, Z, 1));
    node.ask(Y, send(FAR, Z, 2));
    let (out, steps) = node.take(NodeInput::PeerRestarted(N1), true);
    assert_eq!((out.words, steps), (vec!["T0: PeerRestarted".into(), "T1: PeerRestarted".into()], 2));
}

/// If two tasks have something due at the same time, either task may be first, and the state between the two steps is
/// visible (D170).
#[test]
fn what_tasks_do_at_one_time_may_be_taken_in_either_order() {
    let mut node = Steps::new(4);
    let delay = Request::Delay { id: TimeId(3), length: Ticks(300) };
    node.0.step(Instant::START, NodeInput::Request(X, delay), &mut Outside::default());
    node.ask(Y, get(300));
    let mut before = node.clone();
    let mut out = Outside { open: true, ..Outside::default() };
    node.0.let_pass(node.0.now() + Ticks(300), &mut out);
    node.0.file(&mut out);
    assert_eq!((&out.words[..], node.0.inputs()), (&[][..], 2), "nobody has taken anything");
    assert_eq!(
        (node.0.late(X), node.0.late(Y)),
        (Ticks::ZERO, Ticks(300)),
        "the Timer's word is no time of X"
    );
    let (told, over) = ("T0: time_out 3", "T1: nothing");
    for order in [[told, over], [over, told]] {
        let mut node = node.read_back(before.clone());
        let mut out = Outside { open: true, ..Outside::default() };
        for words in order {
            let task = if words == told { X } else { Y };
            let at = node.0.open().find(|&at| node.0.waiting(at).is_some_and(|(of, _)| of == task));
            node.0.take(at.expect("it waits"), &mut out);
            node.0.file(&mut out);
            before = node.read_back(before);
        }
        assert_eq!(out.words, order);
        assert_eq!((node.0.is_busy(), node.0.late(Y)), (false, Ticks::ZERO));
    }
}

/// A task handles passed time before it takes an input from others.
#[test]
fn a_task_takes_what_came_first_first() {
    let mut node = Steps::new(4);
    node.ask(Y, get(5));
    let mut out = Outside { open: true, ..Outside::default() };
    node.0.let_pass(node.0.now() + Ticks(5), &mut out);
    node.0.begin(node.0.now(), NodeInput::Request(X, send(MOVE, Y, 7)), &mut out);
    node.0.file(&mut out);
    let waits: Vec<_> = (0..2).filter_map(|at| node.0.waiting(at)).collect();
    assert!(matches!(waits[..], [(Y, Input::Time), (Y, Input::Packet(_))]), "{waits:?}");
    assert_eq!(node.0.open().collect::<Vec<_>>(), [0]);
    node.0.take(0, &mut out);
    node.0.take(0, &mut out);
    assert_eq!(out.words, ["T1: nothing"], "the command is for the next that Y asks for");
}
