//! Tables pushed to the nodes of random cells at random moments (D184).

use crate::support::reply;
use imrs_protocol::*;
use imrs_testkit::VirtualCell;
use proptest::prelude::*;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// A random cell of three to five nodes. On each node one task asks and one task serves.
#[derive(Clone, Debug)]
struct Random {
    tree: Vec<(u16, u64)>,
    more: Vec<(u16, u16, u64)>,
    retry: u8,
}

impl Random {
    fn cell(&self) -> Cell {
        let mut cell = Cell::new("random", Ticks(1));
        let count = u16::try_from(self.tree.len()).unwrap() + 1;
        for i in 0..count {
            let node = cell.node(&format!("n{i}"));
            cell.task(&format!("sends{i}"), node);
            cell.task(&format!("serves{i}"), node);
        }
        for (node, &(to, delay)) in (1..).zip(&self.tree) {
            cell.link(NodeId(node), NodeId(to % node), Ticks(delay));
        }
        for &(a, b, delay) in self.more.iter().filter(|(a, b, _)| a % count != b % count) {
            cell.link(NodeId(a % count), NodeId(b % count), Ticks(delay));
        }
        for owner in 0..count {
            let users: Vec<_> = (0..count).map(|user| TaskId(2 * user)).collect();
            let port =
                PortDecl::new(&format!("p{owner}"), TaskId(2 * owner + 1), Usage::Receive, &users, LONGEST);
            let port = port.command().bounded_buffer(6);
            cell.port(if self.retry > 0 { port.retry(self.retry, Ticks(40)) } else { port });
        }
        cell
    }
}

const LONGEST: Ticks = Ticks(200);

fn randoms(retry: u8) -> impl Strategy<Value = Random> {
    let tree = proptest::collection::vec((any::<u16>(), 1..4_u64), 2..5);
    let more = proptest::collection::vec((any::<u16>(), any::<u16>(), 1..4_u64), 1..6);
    (tree, more).prop_map(move |(tree, more)| Random { tree, more, retry })
}

/// A number that decides what happens in a tick.
type Draw = (u8, u16, u16);

fn draws() -> impl Strategy<Value = Vec<Draw>> {
    proptest::collection::vec(any::<Draw>(), 300)
}

/// A run of the random cell: its requests, and how each of them ended.
struct Run {
    net: VirtualCell,
    tables: Vec<Arc<CellTable>>,
    count: u16,
    /// For each asking task, the latest instant at which its request must have an outcome.
    asks: BTreeMap<TaskId, u64>,
    ran: HashMap<(TaskId, MessageId), usize>,
    outcomes: Vec<Outcome>,
}

impl Run {
    fn new(random: &Random, avoided: &[(u16, u16)]) -> Self {
        let net = VirtualCell::with_transit(random.cell(), 64);
        let (table, count) = (net.table(), u16::try_from(random.tree.len()).unwrap() + 1);
        let links = &table.cell().links;
        let avoid = |&(link, relay): &(u16, u16)| {
            let link = &links[usize::from(link) % links.len()];
            Avoid { links: vec![(link.a, link.b)], relays: vec![NodeId(relay % count)] }
        };
        let tables = (1..).zip(avoided).map(|(epoch, it)| Arc::new(table.around(epoch, avoid(it)).unwrap()));
        let tables = tables.collect();
        let mut run =
            Self { net, tables, count, asks: BTreeMap::new(), ran: HashMap::new(), outcomes: Vec::new() };
        (0..count).for_each(|task| run.get(TaskId(2 * task + 1)));
        run
    }

    fn nodes(&self) -> impl Iterator<Item = NodeId> + use<> {
        (0..self.count).map(NodeId)
    }

    fn get(&mut self, task: TaskId) {
        self.net.ask(task, Request::Get { port: None, source: None, time_out: None });
    }

    /// Lets a task ask another task, unless its last request has no outcome yet.
    fn ask(&mut self, from: u16, to: u16) {
        let (task, port) = (TaskId(2 * (from % self.count)), PortId(to % self.count));
        if !self.asks.contains_key(&task) {
            self.asks.insert(task, self.net.now() + LONGEST.0);
            self.net.ask(
                task,
                Request::Send { port, to: Target::All, contents: Contents::EMPTY, time_out: None },
            );
        }
    }

    /// Lets a tick pass. The tasks that serve carry out and answer each command at once.
    fn tick(&mut self) {
        self.net.run(1);
        for task in (0..self.count).map(|task| TaskId(2 * task + 1)) {
            for signal in self.net.told(task) {
                if let Signal::Message(message) = signal {
                    *self.ran.entry((message.from.source, message.from.id)).or_default() += 1;
                    self.net.ask(task, reply(&message, 7));
                    self.get(task);
                }
            }
        }
        for task in (0..self.count).map(|task| TaskId(2 * task)) {
            for signal in self.net.told(task) {
                if let Signal::Outcome(outcome) = signal {
                    self.asks.remove(&task).expect("one outcome for each request");
                    self.outcomes.push(outcome);
                }
            }
        }
        let late = self.asks.iter().find(|&(_, &until)| until < self.net.now());
        assert_eq!(late, None, "a request has no outcome");
        assert!(self.ran.values().all(|&times| times == 1), "a command ran twice");
    }

    fn discards(&self, reasons: &[Reason]) -> usize {
        reasons.iter().map(|&reason| self.net.count(Event::Discarded(reason))).sum()
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    /// If all nodes replace their tables at one instant, no message is lost: every command is answered without a
    /// retransmission, whatever was outstanding, waiting or on a link.
    #[test]
    fn a_switch_at_one_instant_loses_nothing(
        random in randoms(0),
        avoided in proptest::collection::vec(any::<(u16, u16)>(), 4),
        draws in draws(),
    ) {
        let mut run = Run::new(&random, &avoided);
        for (i, (what, from, to)) in draws.into_iter().enumerate() {
            if what % 2 == 0 { run.ask(from, to) }
            // Busy links let packets wait in the transit buffers.
            if what % 16 == 1 { run.net.block(&[NodeId(from % run.count)]) }
            if what % 8 == 3 { run.net.block(&[]) }
            if i % 60 == 59 && i / 60 < run.tables.len() {
                let next = Arc::clone(&run.tables[i / 60]);
                run.nodes().for_each(|node| run.net.replace_table(node, &next).unwrap());
            }
            run.tick();
        }
        run.net.block(&[]);
        (0..LONGEST.0).for_each(|_| run.tick());
        prop_assert!(run.asks.is_empty() && !run.outcomes.is_empty());
        prop_assert_eq!(run.discards(&[Reason::NotAllowed, Reason::HopLimit, Reason::Unroutable]), 0);
        let late = run.discards(&[Reason::Expired, Reason::ExpiredInTransit, Reason::ExpiredOnTheWay]);
        let replies = run.outcomes.iter().filter(|outcome| matches!(outcome, Outcome::Reply(_))).count();
        prop_assert!(replies + late >= run.outcomes.len(), "{:?}", run.outcomes);
    }

    /// Tables are pushed to the nodes one after the other, in any order, late, and again, while links lose packets. Each
    /// request has one outcome, no command runs twice, and nodes take no table that is not newer. If all nodes have learnt
    /// the table before, no packet is dropped for its route.
    #[test]
    fn a_switch_node_by_node_runs_nothing_twice(
        random in randoms(3),
        avoided in proptest::collection::vec(any::<(u16, u16)>(), 3),
        draws in draws(),
        (learns, losses) in (any::<bool>(), 0..40_u16),
    ) {
        let mut run = Run::new(&random, &avoided);
        let mut drawn = u64::from(losses) + 1;
        run.net.lose(move |_, _, _| {
            drawn = drawn.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (drawn >> 33) % 256 < u64::from(losses)
        });
        let mut held = vec![0; usize::from(run.count)];
        if learns {
            run.nodes().for_each(|node| run.net.learn_table(node, &run.tables[0]).unwrap());
        }
        for (what, from, to) in draws {
            if what % 2 == 0 { run.ask(from, to) }
            if what % 8 == 1 {
                let pushed = if learns { 0 } else { usize::from(to) % run.tables.len() };
                let (node, next) = (NodeId(from % run.count), Arc::clone(&run.tables[pushed]));
                let (own, given) = (held[node.index()], next.epoch());
                let expected = if given > own { Ok(()) } else { Err(TableError::NotNewer { held: own, given }) };
                prop_assert_eq!(run.net.replace_table(node, &next), expected);
                held[node.index()] = own.max(given);
            }
            run.tick();
        }
        (0..LONGEST.0).for_each(|_| run.tick());
        prop_assert!(run.asks.is_empty() && !run.outcomes.is_empty());
        prop_assert!(!learns || run.discards(&[Reason::NotAllowed]) == 0);
    }
}
