//! Checks of a declared cell. Each fault becomes a [`CellError`].

use super::{Hop, Port, farthest};
use crate::cell::{Cell, CellError, MAX_FRAGMENTS, MAX_MEMBERS, MAX_NODES, Usage};
use crate::ids::{NodeId, Seq24, TaskId};
use crate::packet::{Class, MAX_HOPS};
use crate::ticks::Ticks;
use alloc::collections::BTreeSet;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

pub(super) fn names(cell: &Cell, errors: &mut Vec<CellError>) {
    fn unique<'a>(
        (what, most): (&'static str, usize),
        names: impl Iterator<Item = &'a String>,
        errors: &mut Vec<CellError>,
    ) {
        let mut seen = BTreeSet::new();
        let mut count = 0_usize;
        for name in names {
            count += 1;
            if !seen.insert(name) {
                errors.push(CellError::DuplicateName(what, name.clone()));
            }
        }
        if count > most {
            errors.push(CellError::TooMany(what, most));
        }
    }
    unique(("nodes", MAX_NODES), cell.nodes.iter().map(|n| &n.name), errors);
    let most = usize::from(u16::MAX);
    unique(("tasks", most), cell.tasks.iter().map(|t| &t.name), errors);
    unique(("ports", most), cell.ports.iter().map(|p| &p.name), errors);
}

pub(super) fn references(cell: &Cell, errors: &mut Vec<CellError>) {
    let node = |id: NodeId| id.index() < cell.nodes.len();
    let task = |id: TaskId| id.index() < cell.tasks.len();
    for link in &cell.links {
        if !node(link.a) || !node(link.b) {
            errors.push(CellError::Dangling(format!("link {}--{}", link.a, link.b)));
        } else if link.a == link.b {
            errors.push(CellError::LinkToItself(cell.nodes[link.a.index()].name.clone()));
        }
    }
    for t in &cell.tasks {
        if !node(t.node) {
            errors.push(CellError::Dangling(format!("task `{}`", t.name)));
        }
    }
    for p in &cell.ports {
        if !task(p.owner) || p.users.iter().any(|u| !task(u.task)) {
            errors.push(CellError::Dangling(format!("port `{}`", p.name)));
        }
    }
}

pub(super) fn port(cell: &Cell, port: &Port, routes: &[Option<Hop>], errors: &mut Vec<CellError>) {
    let decl = &port.decl;
    let name = || decl.name.clone();
    let unknown = |m: &&String| cell.tasks.iter().all(|t| t.module.as_ref() != Some(m));
    errors.extend(
        decl.modules.iter().filter(unknown).map(|module| CellError::UnknownModule(name(), module.clone())),
    );
    if port.parties.len() < 2 && !decl.modules.iter().any(|m| unknown(&m)) {
        errors.push(CellError::NoUsers(name()));
    }
    let mut seen = BTreeSet::new();
    for party in &port.parties {
        if !seen.insert(party.task) {
            errors.push(CellError::ListedTwice(name(), cell.tasks[party.task.index()].name.clone()));
        }
        if party.time_out.is_zero() {
            errors.push(CellError::NoTimeOut(name()));
        }
    }
    if decl.usage == Usage::Waitfor && port.parties.len() > MAX_MEMBERS {
        errors.push(CellError::TooManyMembers(name()));
    }
    if decl.bounded_buffer == 0 {
        errors.push(CellError::NoBuffer(name()));
    }
    if decl.class == Class::Status {
        let answered = match decl.usage {
            Usage::Query | Usage::Response | Usage::Reply | Usage::Waitfor => true,
            Usage::Send | Usage::Receive => port.parties.iter().any(|party| party.retry > 0),
        };
        if answered {
            errors.push(CellError::NeedsClass2(name()));
        }
    }
    let heartbeats = matches!(decl.usage, Usage::Query | Usage::Response)
        && cell.couples.iter().any(|couple| couple.via == port.id);
    if decl.guard.is_some() && (decl.fragments > 1 || decl.usage == Usage::Reply || heartbeats) {
        errors.push(CellError::NoRoomForEpoch(name()));
    }
    check_sizes(port, errors);
    check_users(cell, port, errors);
    check_ways(cell, port, routes, errors);
}

fn check_sizes(port: &Port, errors: &mut Vec<CellError>) {
    let decl = &port.decl;
    for fragments in [decl.fragments, decl.answer_fragments] {
        if !(1..=MAX_FRAGMENTS).contains(&fragments) {
            errors.push(CellError::Fragments(decl.name.clone(), fragments));
        }
    }
    let owner_asks = matches!(decl.usage, Usage::Send | Usage::Query) && decl.class == Class::Command;
    if owner_asks && port.parties.len() > MAX_MEMBERS {
        errors.push(CellError::TooManyAsked(decl.name.clone()));
    }
    for party in &port.parties {
        let Some(rate) = party.rate else { continue };
        // Within one TTL a sender must use less than half of the range of sequence numbers (D53).
        let incarnation = port.parties.iter().map(|p| p.time_out).max().unwrap_or_default();
        let sent =
            u128::from(rate.count) * port.peers(party.task).count() as u128 * u128::from(incarnation.0);
        if rate.per.is_zero() || sent / u128::from(rate.per.0) >= u128::from(Seq24::MODULUS / 2) {
            errors.push(CellError::SequenceWraps(decl.name.clone()));
            break;
        }
    }
}

/// The class and the format that a user declares must equal the owner's (D9).
fn check_users(cell: &Cell, port: &Port, errors: &mut Vec<CellError>) {
    let decl = &port.decl;
    for user in &decl.users {
        let names = || (decl.name.clone(), cell.tasks[user.task.index()].name.clone());
        if user.class.is_some_and(|class| class != decl.class) {
            let (port, task) = names();
            errors.push(CellError::OtherClass(port, task));
        }
        if user.format.as_ref().is_some_and(|format| *format != decl.format) {
            let (port, task) = names();
            errors.push(CellError::OtherFormat(port, task));
        }
    }
}

fn check_ways(cell: &Cell, port: &Port, routes: &[Option<Hop>], errors: &mut Vec<CellError>) {
    let decl = &port.decl;
    let n = cell.nodes.len();
    for party in &port.parties {
        let mut farthest = Ticks::ZERO;
        for peer in port.peers(party.task) {
            let (a, b) = (cell.tasks[party.task.index()].node, cell.tasks[peer.index()].node);
            let hop = routes[a.index() * n + b.index()];
            let route = if a == b { Some((Ticks::ZERO, 1)) } else { hop.map(|h| (h.bound, h.links)) };
            let reachable = route.filter(|&(_, links)| links <= MAX_HOPS + 1);
            let Some((bound, _)) = reachable else {
                if party.task < peer {
                    let names = (&cell.tasks[party.task.index()].name, &cell.tasks[peer.index()].name);
                    errors.push(CellError::Unreachable(decl.name.clone(), names.0.clone(), names.1.clone()));
                }
                continue;
            };
            let least = match party.usage {
                Usage::Send | Usage::Query if decl.class == Class::Command => bound + bound,
                Usage::Reply => bound,
                Usage::Send | Usage::Query | Usage::Receive | Usage::Response | Usage::Waitfor => continue,
            };
            farthest = farthest.max(least);
            if party.time_out <= least {
                let (port, time_out) = (decl.name.clone(), party.time_out);
                errors.push(CellError::DeadlineTooShort { port, time_out, least });
            }
        }
        // A sender of commands waits for the answer before it sends the next one (D53).
        let asks = matches!(party.usage, Usage::Send | Usage::Query) && decl.class == Class::Command;
        if let Some(rate) = party.rate.filter(|_| asks) {
            let least = Ticks(farthest.0.saturating_mul(u64::from(rate.count)));
            if rate.per < least {
                let (port, per) = (decl.name.clone(), rate.per);
                errors.push(CellError::CannotBeServed { port, per, least });
            }
        }
    }
    if decl.usage == Usage::Waitfor && errors.is_empty() {
        let least = port.margin + farthest(cell, &port.parties, routes);
        let time_out = port.parties.iter().map(|p| p.time_out).min().unwrap_or(Ticks::ZERO);
        if time_out <= least {
            errors.push(CellError::MarginTooLong { port: decl.name.clone(), time_out, least });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::{CoupleDecl, PortDecl, Rate, TaskDecl, UserDecl};
    use crate::table::CellTable;

    const X: TaskId = TaskId(0);
    const Y: TaskId = TaskId(1);
    const Z: TaskId = TaskId(2);

    fn three(delay: u64) -> Cell {
        let mut cell = Cell::new("three", Ticks(1));
        let nodes: Vec<_> = ["a", "b", "c"].map(|n| cell.node(n)).into();
        for i in 0..3 {
            cell.task(["x", "y", "z"][i], nodes[i]);
        }
        cell.link(nodes[0], nodes[1], Ticks(delay));
        cell.link(nodes[1], nodes[2], Ticks(delay));
        cell
    }

    fn errors(change: impl FnOnce(&mut Cell)) -> Vec<CellError> {
        let mut cell = three(1);
        change(&mut cell);
        CellTable::new(cell).map(|_| ()).unwrap_err()
    }

    fn name(s: &str) -> String {
        String::from(s)
    }

    #[test]
    fn every_fault_of_a_declaration_is_found() {
        let found = errors(|c| {
            c.node("a");
            c.task("x", NodeId(7));
            c.link(NodeId(1), NodeId(1), Ticks(1));
        });
        assert_eq!(
            found,
            [
                CellError::DuplicateName("nodes", name("a")),
                CellError::DuplicateName("tasks", name("x")),
                CellError::LinkToItself(name("b")),
                CellError::Dangling(name("task `x`")),
            ]
        );
        let found = errors(|c| {
            c.port(PortDecl::new("p", X, Usage::Send, &[], Ticks(0)).bounded_buffer(0));
            c.port(PortDecl::new("q", X, Usage::Send, &[Y, Y], Ticks(5)));
            c.port(PortDecl::new("r", X, Usage::Send, &[Y], Ticks(2)).command());
            c.port(PortDecl::new("s", X, Usage::Reply, &[Y], Ticks(1)));
            c.port(PortDecl::new("t", X, Usage::Send, &[Y], Ticks(9)).retry(2, Ticks(3)));
        });
        assert_eq!(
            found,
            [
                CellError::NoUsers(name("p")),
                CellError::NoTimeOut(name("p")),
                CellError::NoBuffer(name("p")),
                CellError::ListedTwice(name("q"), name("y")),
                CellError::DeadlineTooShort { port: name("r"), time_out: Ticks(2), least: Ticks(2) },
                CellError::DeadlineTooShort { port: name("s"), time_out: Ticks(1), least: Ticks(1) },
                CellError::NeedsClass2(name("t")),
            ]
        );
        let found = errors(|c| {
            c.port(PortDecl::new("m", X, Usage::Waitfor, &[Y, Z], Ticks(9)).resend(Ticks(4), 2));
        });
        assert!(matches!(found[..], [CellError::MarginTooLong { time_out: Ticks(9), .. }]), "{found:?}");
        let found = errors(|c| {
            let far = c.node("far");
            let w = c.task("w", far);
            c.port(PortDecl::new("p", X, Usage::Send, &[w], Ticks(9)));
        });
        assert_eq!(found, [CellError::Unreachable(name("p"), name("x"), name("w"))]);
    }

    #[test]
    fn a_module_stands_for_its_tasks_but_the_owner() {
        let mut cell = three(1);
        let tag = |cell: &mut Cell, t: usize| cell.tasks[t].module = Some(name("arms"));
        (0..3).for_each(|t| tag(&mut cell, t));
        let all = cell.port(PortDecl::new("p", X, Usage::Send, &[], Ticks(9)).module("arms"));
        let named = cell.port(PortDecl::new("q", X, Usage::Send, &[Z], Ticks(9)).module("arms"));
        let table = CellTable::new(cell).unwrap();
        let peers = |port| table.port(port).unwrap().peers(X).collect::<Vec<_>>();
        assert_eq!((peers(all), peers(named)), ([Y, Z].into(), [Z, Y].into()));
        let unknown = errors(|c| {
            c.port(PortDecl::new("p", X, Usage::Send, &[], Ticks(9)).module("legs"));
        });
        assert_eq!(unknown, [CellError::UnknownModule(name("p"), name("legs"))]);
    }

    #[test]
    fn formats_rates_and_sets_have_limits() {
        let port = || PortDecl::new("p", X, Usage::Send, &[Y], Ticks(100));
        for (fragments, answers, wrong) in [(0, 1, 0), (17, 1, 17), (1, 99, 99)] {
            let found = errors(|c| {
                c.port(port().fragments(fragments, answers));
            });
            assert_eq!(found, [CellError::Fragments(name("p"), wrong)]);
        }
        // The limit: 2^23 messages of one sender within one TTL of 100 ticks.
        for (count, per, ports) in [(65_535, 1, 0), (1, 0, 1)] {
            let mut cell = three(1);
            cell.port(port().rate(count, Ticks(per)));
            assert_eq!(CellTable::new(cell).err().map_or(0, |errors| errors.len()), ports);
        }
        let wraps = errors(|c| {
            c.port(PortDecl { time_out: Ticks(129), ..port() }.rate(65_535, Ticks(1)));
        });
        assert_eq!(wraps, [CellError::SequenceWraps(name("p"))]);
        let crowd = |users: u16| {
            let mut cell = Cell::new("crowd", Ticks(1));
            let node = cell.node("n");
            let tasks: Vec<_> = (0..=users).map(|i| cell.task(&format!("t{i}"), node)).collect();
            cell.port(PortDecl::new("p", tasks[0], Usage::Query, &tasks[1..], Ticks(9)));
            cell.port(PortDecl::new("q", tasks[0], Usage::Response, &tasks[1..], Ticks(9)));
            CellTable::new(cell).map(|_| ())
        };
        assert_eq!((crowd(63), crowd(64)), (Ok(()), Err([CellError::TooManyAsked(name("p"))].into())));
    }

    #[test]
    fn a_user_says_of_the_message_what_the_owner_says() {
        let with = |change: fn(&mut UserDecl)| {
            let mut cell = three(1);
            let mut port = PortDecl::new("p", X, Usage::Receive, &[Y, Z], Ticks(90)).command().format("Ask");
            change(&mut port.users[1]);
            cell.port(port);
            CellTable::new(cell)
        };
        let fault = |change| with(change).map(|_| ()).unwrap_err();
        let names = || (name("p"), name("z"));
        assert_eq!(fault(|u| u.class = Some(Class::Status)), [CellError::OtherClass(names().0, names().1)]);
        assert_eq!(fault(|u| u.format = Some(name("Grant"))), [CellError::OtherFormat(names().0, names().1)]);
        let alike = with(|u| {
            (u.class, u.format) = (Some(Class::Command), Some(name("Ask")));
            u.retry = Some(3);
        });
        let table = alike.unwrap();
        let port = table.port(crate::ids::PortId(0)).unwrap();
        assert_eq!([Y, Z].map(|task| port.party(task).unwrap().retry), [0, 3]);
        assert_ne!(table.digest(), with(|_| ()).unwrap().digest(), "nodes that differ in it do not talk");
    }

    #[test]
    fn a_rate_must_leave_time_for_the_answers() {
        let of = |count, per, user: Option<Rate>| {
            let mut cell = three(1);
            let mut port = PortDecl::new("p", X, Usage::Receive, &[Z], Ticks(90)).command();
            port = port.rate(count, Ticks(per));
            port.users[0].rate = user;
            cell.port(port);
            CellTable::new(cell).map(|_| ())
        };
        // The route has two links there and two back, and each takes its bound.
        assert_eq!(of(3, 12, None), Ok(()));
        let fault = CellError::CannotBeServed { port: name("p"), per: Ticks(11), least: Ticks(12) };
        assert_eq!(of(3, 11, None), Err([fault].into()));
        assert_eq!(of(3, 11, Some(Rate { count: 2, per: Ticks(11) })), Ok(()), "the user's own rate counts");
        let mut cell = three(1);
        cell.port(PortDecl::new("r", X, Usage::Reply, &[Z], Ticks(90)).rate(9, Ticks(1)));
        assert_eq!(
            CellTable::new(cell).map(|_| ()),
            Ok(()),
            "who answers does not wait before it answers again"
        );
    }

    #[test]
    fn a_port_under_a_lease_has_room_for_the_epoch() {
        let guarded = |change: fn(PortDecl) -> PortDecl, usage| {
            let mut cell = three(1);
            let alive = cell.port(PortDecl::new("alive", X, Usage::Response, &[Y], Ticks(30)));
            let [lease, takeover, every] = [60, 200, 20].map(Ticks);
            let couple = CoupleDecl {
                primary: X,
                standby: Y,
                lease,
                takeover,
                every,
                via: alive,
                trusted: false,
                mutual: false,
            };
            cell.couples.push(couple);
            cell.port(change(PortDecl::new("p", X, usage, &[Z], Ticks(9))).guard(0));
            CellTable::new(cell).err().unwrap_or_default()
        };
        let refused = [CellError::NoRoomForEpoch(name("p"))];
        assert_eq!(guarded(|port| port, Usage::Send), []);
        assert_eq!(guarded(|port| port.fragments(2, 1), Usage::Send), refused);
        assert_eq!(guarded(|port| port, Usage::Reply), refused);
        let found = errors(|cell| {
            *cell = three(1);
            let alive = PortDecl::new("alive", X, Usage::Response, &[Y], Ticks(30)).guard(0);
            let via = cell.port(alive);
            let [lease, takeover, every] = [60, 200, 20].map(Ticks);
            let (primary, standby) = (X, Y);
            let (trusted, mutual) = (false, false);
            cell.couples.push(CoupleDecl { primary, standby, lease, takeover, every, via, trusted, mutual });
        });
        assert!(found.contains(&CellError::NoRoomForEpoch(name("alive"))), "{found:?}");
    }

    #[test]
    fn what_is_answered_needs_class_2() {
        for usage in [Usage::Query, Usage::Response, Usage::Reply, Usage::Waitfor] {
            let port = PortDecl::new("p", X, usage, &[Y], Ticks(90));
            let found = errors(|c| {
                c.port(PortDecl { class: Class::Status, ..port });
            });
            assert_eq!(found, [CellError::NeedsClass2(name("p"))]);
        }
        assert_eq!(TaskDecl { name: name("x"), node: NodeId(0), module: None }, three(1).tasks[0]);
    }
}
