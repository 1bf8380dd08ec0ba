//! Tests of drivers of nodes with scripts: a driver without the optional callbacks, a couple's lease, and scripts that are
//! packed at every tick.

use super::arm;
use super::host::{A, B, HALT, beam_lift, bytes, finish, triangle};
use imrs_protocol::script::*;
use imrs_protocol::*;
use imrs_testkit::{HostInput, HostOutbox, ScriptedNode, VirtualCell};
use std::sync::Arc;

/// A driver that ignores the optional callbacks of scripts.
#[derive(Default)]
struct Quiet {
    ended: Vec<TaskId>,
    cut: usize,
}

impl NodeOutbox for Quiet {
    fn link(&mut self, _: NodeId, _: Packet) {}
    fn signal(&mut self, _: TaskId, _: Signal) {}
}

impl HostOutbox for Quiet {
    fn run(&mut self, _: TaskId, _: Action<'_>) {}
    fn cut_short(&mut self, _: TaskId, _: u8) {
        self.cut += 1;
    }
    fn choose(&mut self, _: TaskId, _: u16) -> Option<u16> {
        None
    }
    fn ended(&mut self, task: TaskId, _: End) {
        self.ended.push(task);
    }
}

#[test]
fn a_driver_may_ignore_what_scripts_say_of_themselves() {
    let mut cell = triangle();
    let port = cell.port(PortDecl::new("move", A, Usage::Send, &[B], Ticks(9)).command());
    cell.tasks[1].node = NodeId(0);
    let mut asker = ProgramBuilder::new("a");
    asker.send(port, Target::All, &[]).delay(Ticks(4)).end();
    let mut server = ProgramBuilder::new("b");
    server.receive(port, None, &[]).end();
    let programs = [(A, finish(asker)), (B, finish(server))].map(|(task, p)| (task, Arc::new(p)));
    let table = NodeTable::new(Arc::new(CellTable::new(cell).expect("a checked cell")), NodeId(0));
    let mut node =
        ScriptedNode::new(Node::new(table, Incarnation(0), false, 4), programs).expect("checked programs");
    let mut out = Quiet::default();
    node.step(Instant::START, HostInput::Begin, &mut out);
    assert_eq!(out.ended, [B], "it ends, and leaves the command unanswered");
    assert_eq!(node.node.time_left(), Some(Ticks(9)), "the sender waits for the answer");
    node.step(Instant(9), NodeInput::Time, &mut out);
    assert_eq!(node.node.time_left(), Some(Ticks(4)), "then it delays");
    node.step(Instant(13), NodeInput::Time, &mut out);
    assert_eq!((out.ended, out.cut), (vec![B, A], 0));
    assert_eq!(node.node.time_left(), None);
}

#[test]
fn the_end_of_a_couples_script_ends_its_heartbeats_and_a_fence_its_action() {
    let mut cell = Cell::new("couple", Ticks(1));
    let (here, there) = (cell.node("here"), cell.node("there"));
    cell.link(here, there, Ticks(1));
    let (p, s) = (cell.task("p", here), cell.task("s", there));
    let via = cell.port(PortDecl::new("alive", p, Usage::Response, &[s], Ticks(6)));
    cell.couples.push(CoupleDecl {
        primary: p,
        standby: s,
        lease: Ticks(14),
        takeover: Ticks(32),
        every: Ticks(4),
        via,
        trusted: false,
        mutual: false,
    });
    let mut primary = ProgramBuilder::new("p");
    primary.statement().op(Op::Lease).run("weld", Ticks(500), Ticks(500)).end();
    let mut standby = ProgramBuilder::new("s");
    standby.delay(Ticks(40)).end();
    let mut virtual_cell = VirtualCell::new(cell).begin([(p, finish(primary)), (s, finish(standby))]);
    virtual_cell.run(70);
    let log = virtual_cell.log();
    assert_eq!(log[0], "5 p: weld", "granted at the second beat");
    assert_eq!(log[1], "40 s: ended Finished");
    // No heartbeat came after the grant, so the lease ended, and with it the action.
    let fenced: Vec<&String> = log[2..].iter().collect();
    assert!(fenced[0].ends_with("p: cut short") && fenced[1].ends_with("p: ended Fenced"), "{log:?}");
}

#[test]
fn scripts_packed_at_every_tick_do_the_same() {
    let run = |packed: bool| {
        let mut virtual_cell = beam_lift();
        for tick in 0..60 {
            if tick == 20 {
                virtual_cell.ask(
                    A,
                    Request::Send { port: HALT, to: Target::All, contents: bytes(&[1]), time_out: None },
                );
            }
            virtual_cell.run(1);
            for node in virtual_cell.nodes.iter_mut().filter(|_| packed) {
                let next: Vec<Seq24> = (0..3).map(|_| Frame::SEQUENCE).collect();
                let frame = Frame { rounds: &[], sequences: &next, incarnations: true };
                for ScriptHost { program, script, .. } in
                    node.scripts.iter_mut().map(|hosted| &mut hosted.host)
                {
                    let bytes = Encode::bytes(&frame, |w| script.walk(program, w)).expect("it fits");
                    let mut read = Script::new(program);
                    assert_eq!(Decode::read(&bytes, true, |r| read.walk(program, r)), bytes.len());
                    *script = read;
                }
            }
        }
        (virtual_cell.log(), virtual_cell.activities(), virtual_cell.var_at(B, arm::MOVING))
    };
    assert_eq!(run(true), run(false));
}
