//! Tests the texts of faults (R35): each is one sentence that says what is wrong and what to do about it.

use imrs_protocol::*;

const A: TaskId = TaskId(0);
const B: TaskId = TaskId(1);

/// A cell of two tasks on one node.
fn pair() -> Cell {
    let mut cell = Cell::new("pair", Ticks(1));
    let node = cell.node("n");
    cell.task("a", node);
    cell.task("b", node);
    cell
}

/// The texts of the faults of the pair after `change`.
fn said(change: impl FnOnce(&mut Cell)) -> Vec<String> {
    let mut cell = pair();
    change(&mut cell);
    let errors = CellTable::new(cell).map(|_| ()).expect_err("a fault");
    errors.iter().map(ToString::to_string).collect()
}

fn port(name: &str, usage: Usage) -> PortDecl {
    PortDecl::new(name, A, usage, &[B], Ticks(20))
}

#[test]
fn a_name_that_leads_nowhere_or_to_two_things_is_told() {
    let twice = said(|c| _ = c.task("a", NodeId(0)));
    assert_eq!(twice, ["two tasks are called `a`: rename one"]);
    let nowhere = said(|c| c.link(NodeId(0), NodeId(4), Ticks(1)));
    assert_eq!(nowhere, ["link N0--N4 names something that is not in the cell"]);
    let stranger = said(|c| _ = c.port(PortDecl::new("p", A, Usage::Send, &[TaskId(7)], Ticks(5))));
    assert_eq!(stranger, ["port `p` names something that is not in the cell"]);
    let itself = said(|c| c.link(NodeId(0), NodeId(0), Ticks(1)));
    assert_eq!(itself, ["a link joins `n` with itself: remove it"]);
    let module = said(|c| _ = c.port(port("p", Usage::Send).module("arms")));
    assert_eq!(module, ["port `p` names module `arms`, which no task belongs to"]);
}

#[test]
fn a_user_list_that_cannot_be_is_told() {
    let none = said(|c| _ = c.port(PortDecl::new("p", A, Usage::Send, &[], Ticks(5))));
    assert_eq!(none, ["port `p` has no users: name them in its user_list"]);
    let twice = said(|c| _ = c.port(PortDecl::new("p", A, Usage::Send, &[B, B], Ticks(5))));
    assert_eq!(twice, ["port `p` lists `b` twice"]);
    let crowd = |n: usize| -> (Vec<String>, Vec<String>) {
        let with = |usage| {
            said(|c| {
                let users: Vec<TaskId> = (0..n).map(|i| c.task(&format!("t{i}"), NodeId(0))).collect();
                c.port(PortDecl::new("p", A, usage, &users, Ticks(90)));
                c.port(port("known fault", Usage::Send).bounded_buffer(0));
            })
        };
        (with(Usage::Waitfor), with(Usage::Query))
    };
    let known = "port `known fault` has bounded_buffer[0]: it needs at least 1";
    assert_eq!(crowd(63), (vec![known.into()], vec![known.into()]), "64 meet, and one asks 63");
    let (meet, ask) = crowd(64);
    assert_eq!(meet, ["waitfor `p` joins more than 64 tasks: meet in groups", known]);
    assert_eq!(ask, ["port `p` asks more than 63 tasks at a time: ask in groups", known]);
}

#[test]
fn an_option_that_cannot_be_is_told() {
    let one = |decl: PortDecl| said(|c| _ = c.port(decl)).join("; ");
    assert_eq!(
        one(port("p", Usage::Send).bounded_buffer(0)),
        "port `p` has bounded_buffer[0]: it needs at least 1"
    );
    let timeless = said(|c| _ = c.port(PortDecl { time_out: Ticks(0), ..port("p", Usage::Send) }));
    assert_eq!(timeless[0], "port `p` has no time_out");
    assert_eq!(
        one(port("p", Usage::Send).retry(1, Ticks(4))),
        "port `p` waits for an answer, so it must be class 2"
    );
    assert_eq!(
        one(port("p", Usage::Send).fragments(17, 1)),
        "port `p`: a message of 17 packets: 1 to 16 are possible; send a longer one in parts"
    );
    let wraps = one(PortDecl::new("p", A, Usage::Send, &[B], Ticks(u64::MAX / 4)).rate(1000, Ticks(1)));
    assert_eq!(wraps, "port `p`: too many messages in one time_out: lower its rate or its time_out");
}

#[test]
fn a_time_out_that_the_way_uses_up_is_told_with_the_least_that_does() {
    let apart = |delay, decl: PortDecl| {
        said(|c| {
            let far = c.node("far");
            c.link(NodeId(0), far, Ticks(delay));
            c.tasks[1].node = far;
            c.port(decl);
        })
    };
    let command = port("p", Usage::Send).command();
    assert_eq!(
        apart(20, command.clone()),
        ["port `p`: time_out 20 must exceed 40 ticks (the links that it passes)"]
    );
    let meeting = port("p", Usage::Waitfor).resend(Ticks(6), 0);
    let told = apart(20, meeting).join("; ");
    assert!(told.starts_with("waitfor `p`: time_out 20 must exceed "), "{told}");
    assert!(told.ends_with(" ticks (the margin and the links), or no task is ever released"), "{told}");
    let unreachable = said(|c| {
        c.tasks[1].node = c.node("island");
        c.port(command);
    });
    assert_eq!(
        unreachable,
        ["port `p` joins `a` and `b`, but no chain of at most 8 links joins their nodes"]
    );
}

#[test]
fn a_couple_that_both_may_act_in_is_told() {
    let couple = |c: &mut Cell| {
        let via = c.port(PortDecl::new("alive", A, Usage::Response, &[B], Ticks(6)));
        c.couples.push(CoupleDecl {
            primary: A,
            standby: B,
            lease: Ticks(20),
            takeover: Ticks(40),
            every: Ticks(4),
            via,
            trusted: false,
            mutual: false,
        });
    };
    let with = |change: fn(&mut Cell)| {
        said(|c| {
            couple(c);
            change(c);
        })
        .join("; ")
    };
    assert_eq!(
        with(|c| c.couples.push(c.couples[0].clone())),
        "couple `a -> b`: one of its tasks is in another couple already"
    );
    let short = with(|c| c.couples[0].lease = Ticks(1));
    assert!(short.starts_with("couple `a -> b`: lease 1 must be at least 9 ticks"), "{short}");
    let soon = with(|c| c.couples[0].takeover = Ticks(20));
    assert!(soon.starts_with("couple `a -> b`: takeover 20 must be at least 22 ticks"), "{soon}");
    let heartbeats = with(|c| {
        let other = c.port(PortDecl::new("else", A, Usage::Send, &[B], Ticks(9)));
        c.couples[0].via = other;
    });
    assert!(
        heartbeats.starts_with("port `else` cannot carry heartbeats: it must join the two tasks"),
        "{heartbeats}"
    );
    let guarded = with(|c| {
        let third = c.task("c", NodeId(0));
        c.port(PortDecl::new("arm", A, Usage::Receive, &[third], Ticks(9)).guard(0));
    });
    assert!(guarded.starts_with("port `arm` acts under a couple's lease: only the two tasks"), "{guarded}");
}

#[test]
fn thirty_two_bytes_that_are_no_packet_are_told_why() {
    let said = |error: PacketError| error.to_string();
    assert_eq!(said(PacketError::Version(3)), "packet format 3, this node speaks 1");
    assert_eq!(said(PacketError::UnknownPort(PortId(9))), "port P9 is not in this cell");
    assert_eq!(said(PacketError::Checksum), "checksum is wrong (damaged, or made for another cell)");
    assert_eq!(said(PacketError::Malformed), "malformed packet");
}

#[test]
fn a_usage_is_the_papers_word() {
    let usages = [Usage::Send, Usage::Receive, Usage::Reply, Usage::Query, Usage::Response, Usage::Waitfor];
    let words = usages.map(|usage| usage.to_string());
    assert_eq!(words, ["send", "receive", "reply", "query", "response", "waitfor"]);
    let others = usages.map(|usage| usage.counterpart().to_string());
    assert_eq!(others, ["receive", "send", "receive", "response", "query", "waitfor"]);
}

#[test]
fn a_broken_invariant_is_told_with_what_breaks_it() {
    use invariants::Violation;
    let (port, id) = (PortId(1), MessageId::default());
    let named = [
        Violation::Overfull(port),
        Violation::HoldsExpired(port, A, id),
        Violation::HoldsForeign(port, A, id),
        Violation::NotRemembered(port, A, id),
        Violation::WaitsForNothing(port),
        Violation::MeetingAndWaitDiffer(port),
        Violation::ResendInstant(port),
        Violation::Rounds(port),
        Violation::HoldsBarred(port, A, Round(3)),
        Violation::OwesConfirm(port),
        Violation::NotOffered(port, A, id),
        Violation::RejectedTooOften(port, A, id),
        Violation::HoldsFragments(port, A),
    ];
    let mut told: Vec<String> = named.iter().map(ToString::to_string).collect();
    assert!(told.iter().all(|words| words.contains("P1")), "{told:#?}");
    told.push(Violation::MemoryTooShort(A, id).to_string());
    assert!(told.last().is_some_and(|words| words.contains("T0")), "{told:#?}");
    told.extend([Violation::Overdue(Instant(77)), Violation::PastLease(Instant(77))].map(|v| v.to_string()));
    assert!(told[told.len() - 2..].iter().all(|words| words.contains("77")), "{told:#?}");
    told.extend(
        [
            Violation::Levels(4),
            Violation::WrongCall,
            Violation::WrongDeadline,
            Violation::OutOfOrder(PortId(3)),
        ]
        .map(|v| v.to_string()),
    );
    let all = told.len();
    told.sort();
    told.dedup();
    assert_eq!(told.len(), all, "two say the same");
    assert_eq!(Overflow.to_string(), "a state does not fit its packed form");
}
