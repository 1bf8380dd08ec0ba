//! A node with scripts allocates nothing after `new` (§5.2.3: no run-time allocation; D15).

use crate::allocations;
use imrs_protocol::script::*;
use imrs_protocol::*;
use imrs_testkit::{HostInput, HostOutbox, ScriptedNode};
use std::sync::Arc;

const ROBOT: TaskId = TaskId(0);
const ARM: TaskId = TaskId(1);

/// A script that for ever asks its neighbour, with long questions and answers, and acts in between.
fn robot(port: PortId) -> Program {
    let mut b = ProgramBuilder::new("robot");
    let fields: Vec<(Type, Slot)> = (0..5).map(|_| (Type::Word, b.variable("w", Type::Word))).collect();
    b.forever(|b| {
        b.send(port, Target::One(ARM), &fields).unpack(&fields[1..]);
        b.run("weld", Ticks(1), Ticks(3)).delay(Ticks(2));
    });
    b.finish().expect("a checked program")
}

/// A script that works, and answers from a handler that interrupts the work.
fn arm(port: PortId) -> Program {
    let mut b = ProgramBuilder::new("arm");
    b.order(&[Ranked::Port(port), Ranked::Own]);
    b.forever(|b| {
        b.run("lift", Ticks(1), Ticks(3));
    });
    let fields: Vec<(&str, Type)> = (0..5).map(|_| ("w", Type::Word)).collect();
    b.on_message(port, &fields, |b, came| {
        let answer: Vec<(Type, Slot)> = came[1..].iter().map(|&slot| (Type::Word, slot)).collect();
        b.delay(Ticks(1)).reply(&answer);
    });
    b.finish().expect("a checked program")
}

/// The running actions, in an array of fixed size.
#[derive(Default)]
struct Room {
    actions: [Option<(TaskId, u8)>; 4],
    begun: u32,
}

impl NodeOutbox for Room {
    fn link(&mut self, _: NodeId, _: Packet) {}
    fn signal(&mut self, _: TaskId, _: Signal) {}
}

impl HostOutbox for Room {
    fn run(&mut self, task: TaskId, action: Action<'_>) {
        self.begun += 1;
        *self.actions.iter_mut().find(|slot| slot.is_none()).expect("room") = Some((task, action.level));
    }
    fn cut_short(&mut self, _: TaskId, _: u8) {}
    fn choose(&mut self, _: TaskId, _: u16) -> Option<u16> {
        Some(0)
    }
    fn ended(&mut self, task: TaskId, end: End) {
        panic!("{task} ended: {end:?}");
    }
}

#[test]
fn scripts_allocate_nothing() {
    let mut cell = Cell::new("one", Ticks(1));
    let node = cell.node("n");
    cell.task("robot", node);
    cell.task("arm", node);
    let port = cell.port(PortDecl::new("ask", ROBOT, Usage::Query, &[ARM], Ticks(20)).fragments(2, 2));
    let table = NodeTable::new(Arc::new(CellTable::new(cell).expect("a checked cell")), node);
    let node = Node::new(table, Incarnation(0), false, 4);
    let programs = [(ROBOT, Arc::new(robot(port))), (ARM, Arc::new(arm(port)))];
    let mut node = ScriptedNode::new(node, programs).expect("checked programs");
    let mut room = Room::default();
    let mut now = Instant::START;
    node.step(now, HostInput::Begin, &mut room);
    let before = allocations();
    for tick in 0..500 {
        now += Ticks(1);
        node.step(now, NodeInput::Time, &mut room);
        for (task, level) in std::mem::take(&mut room.actions).into_iter().flatten() {
            node.step(now, HostInput::Acted { task, level, ok: true, value: tick }, &mut room);
        }
    }
    assert_eq!(allocations() - before, 0, "allocations after `new`");
    assert!(room.begun > 400, "{} actions", room.begun);
}
