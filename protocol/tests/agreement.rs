//! Tests that nodes with different cells do not talk to each other (D47, D48): every difference between cells changes the
//! digest of the table.

use imrs_protocol::*;

/// Three tasks on four nodes.
fn cell() -> Cell {
    let mut cell = Cell::new("cell", Ticks(1));
    let nodes = ["a", "b", "c", "d"].map(|name| cell.node(name));
    cell.link(nodes[0], nodes[1], Ticks(2));
    cell.link(nodes[1], nodes[2], Ticks(3));
    cell.link(nodes[2], nodes[3], Ticks(5));
    let tasks = [0, 1, 2].map(|i| cell.task(["x", "y", "z"][i], nodes[i]));
    let users = [tasks[1], tasks[2]];
    let port = PortDecl::new("move", tasks[0], Usage::Receive, &users, Ticks(900)).command();
    cell.port(port.bounded_buffer(4).retry(2, Ticks(40)).fragments(3, 2).rate(5, Ticks(60)));
    cell.port(PortDecl::new("lift", tasks[0], Usage::Waitfor, &users, Ticks(800)).resend(Ticks(50), 1));
    cell.port(PortDecl::new("alive", tasks[0], Usage::Response, &[tasks[1]], Ticks(90)));
    let (lease, takeover, every) = (Ticks(300), Ticks(2000), Ticks(30));
    let (trusted, mutual) = (false, false);
    let (primary, standby, via) = (tasks[0], tasks[1], PortId(2));
    cell.couples.push(CoupleDecl { primary, standby, lease, takeover, every, via, trusted, mutual });
    cell
}

fn digest(change: impl FnOnce(&mut Cell)) -> u32 {
    let mut cell = cell();
    change(&mut cell);
    CellTable::new(cell).expect("a checked cell").digest()
}

#[test]
fn every_difference_between_two_cells_shows() {
    type Change = fn(&mut Cell);
    let changes: &[(&str, Change)] = &[
        ("the cell's name", |c| c.name.push('s')),
        ("its tick", |c| c.tick = Ticks(2)),
        ("a node's name", |c| c.nodes[2].name.push('s')),
        ("one more node", |c| _ = c.node("e")),
        ("a link's bound", |c| c.links[1].delay = Ticks(4)),
        ("one end of a link", |c| c.links[2].a = NodeId(1)),
        ("the other end of a link", |c| c.links[2].b = NodeId(0)),
        ("one more link", |c| c.link(NodeId(0), NodeId(2), Ticks(9))),
        ("a task's name", |c| c.tasks[2].name.push('s')),
        ("where a task runs", |c| c.tasks[2].node = NodeId(1)),
        ("one more task", |c| _ = c.task("w", NodeId(0))),
        ("a port's name", |c| c.ports[0].name.push('s')),
        ("a port's owner", |c| {
            c.ports[0].users.swap(0, 1);
            c.ports[0].owner = TaskId(1);
            c.ports[0].users[1].task = TaskId(0);
        }),
        ("its users", |c| _ = c.ports[0].users.pop()),
        ("a user's time_out", |c| c.ports[0].users[1].time_out = Some(Ticks(700))),
        ("its usage", |c| c.ports[0].usage = Usage::Send),
        ("its time_out", |c| c.ports[0].time_out = Ticks(901)),
        ("its class", |c| (c.ports[0].class, c.ports[0].retry) = (Class::Status, 0)),
        ("its buffer", |c| c.ports[0].bounded_buffer = 5),
        ("its format", |c| c.ports[0].format = "height: int16".into()),
        ("how often it is sent again", |c| c.ports[0].retry = 3),
        ("how long apart", |c| c.ports[0].resend = Ticks(41)),
        ("losses that are covered", |c| c.ports[1].losses = 2),
        ("a margin", |c| c.ports[1].margin = Some(Ticks(333))),
        ("a penalty", |c| c.ports[0] = c.ports[0].clone().penalty(Ticks(7))),
        ("latest", |c| c.ports[0] = PortDecl { fragments: 1, ..c.ports[0].clone() }),
        ("packets of a message", |c| c.ports[0].fragments = 4),
        ("packets of an answer", |c| c.ports[0].answer_fragments = 3),
        ("a rate", |c| c.ports[0] = c.ports[0].clone().rate(6, Ticks(60))),
        ("a lease", |c| c.couples[0].lease = Ticks(301)),
        ("who may take over", |c| c.couples[0].mutual = true),
        ("a rule", |c| c.rules.aborts = false),
    ];
    let own = digest(|_| ());
    assert_eq!(own, digest(|_| ()), "the same cell has the same digest");
    let mut seen = vec![("nothing", own)];
    for &(what, change) in changes {
        let digest = digest(change);
        if let Some((same, _)) = seen.iter().find(|(_, known)| *known == digest) {
            panic!("{what} and {same} are not told apart");
        }
        seen.push((what, digest));
    }
}

#[test]
fn the_order_in_which_links_are_declared_does_not_matter() {
    let turned = digest(|c| {
        c.links.reverse();
        for link in &mut c.links {
            std::mem::swap(&mut link.a, &mut link.b);
        }
    });
    assert_eq!(turned, digest(|_| ()));
}

#[test]
fn the_neighbours_of_a_node_are_those_that_a_link_joins_with_it() {
    let mut cell = cell();
    cell.link(NodeId(2), NodeId(1), Ticks(9));
    let table = CellTable::new(cell).expect("a checked cell");
    let of = |node| table.neighbours(NodeId(node)).map(|n| n.0).collect::<Vec<_>>();
    assert_eq!([of(0), of(1), of(2), of(3)], [vec![1], vec![0, 2], vec![1, 3], vec![2]]);
    assert_eq!(table.link_bound(NodeId(1), NodeId(2)), Some(Ticks(3)), "the shorter of two links");
    assert_eq!(table.link_bound(NodeId(0), NodeId(3)), None);
}
