//! Measures the checker's speed and size, in interleaved rounds, as medians and ratios. Run it with `cargo bench -p
//! imrs-model`.
//!
//! Figures that are compared are measured in turns within one round, so that a slow moment of the computer affects all
//! of them.

#[path = "../tests/support/mod.rs"]
#[allow(dead_code, reason = "the benchmark uses a part of what the tests share")]
mod support;

use imrs_model::worlds::Meeting;
use imrs_model::{Budget, Exploration, Limits, Reductions, Watch, WorldModel, explore};
use imrs_protocol::{CommTask, Input, Observation, Outbox, Packet, Request, Signal, Ticks, TimeId};
use stateright::{Checker, Model};
use std::hint::black_box;
use std::time::{Duration, Instant};
use support::reference::ReferenceModel;
use support::worlds::{scenario, timed, with};

const ROUNDS: usize = 7;

fn main() {
    // `cargo test --benches` only checks that the bench runs, so it gets the smallest bounds.
    let quick = std::env::args().any(|argument| argument == "--test");
    let rounds = if quick { 1 } else { ROUNDS };
    packed_against_cloned(rounds, if quick { 2_000 } else { 60_000 });
    share_of_the_machine(rounds, if quick { 500 } else { 20_000 });
    reductions(if quick { 20_000 } else { 4_000_000 });
    sizes(quick);
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Compares how many transitions a second a search makes with packed states and with cloned structs, in a world of
/// three members with one loss and no reduction.
fn packed_against_cloned(rounds: usize, states: u64) {
    let scenario = with(Reductions::NONE, &timed(3, Watch::FalseRelease, 1, 3, 6));
    let (mut packed, mut cloned) = (Vec::new(), Vec::new());
    for _ in 0..rounds {
        let model = WorldModel::new(&scenario, Limits { states, ..Limits::default() });
        let start = Instant::now();
        let checker = model.checker().threads(1).spawn_bfs().join();
        packed.push(checker.state_count() as f64 / start.elapsed().as_secs_f64());
        let start = Instant::now();
        let checker = ReferenceModel::new(&scenario, states).checker().threads(1).spawn_bfs().join();
        cloned.push(checker.state_count() as f64 / start.elapsed().as_secs_f64());
    }
    let ratio = median(packed.iter().zip(&cloned).map(|(packed, cloned)| packed / cloned).collect());
    println!(
        "raw, 3 members, 1 loss: packed {:.0} transitions/s, cloned {:.0}/s, ratio {ratio:.2} (goal >= 2.5)",
        median(packed),
        median(cloned)
    );
}

/// How much of a transition is the state machine itself: the remaining time goes into packing, hashing and the set of
/// visited states.
fn share_of_the_machine(rounds: usize, states: u64) {
    let scenario = with(Reductions::NONE, &timed(3, Watch::FalseRelease, 1, 3, 6));
    let mut shares = Vec::new();
    for _ in 0..rounds {
        let model = WorldModel::new(&scenario, Limits { states, ..Limits::default() });
        let start = Instant::now();
        let checker = model.checker().threads(1).spawn_bfs().join();
        let transition = start.elapsed().as_secs_f64() / checker.state_count() as f64;
        shares.push(handle() / transition);
    }
    println!("`handle` takes {:.1} % of a transition (goal <= 15 %)", 100.0 * median(shares));
}

#[derive(Default)]
struct Sent(Vec<Packet>);

impl Outbox for Sent {
    fn transmit(&mut self, packet: Packet) {
        self.0.push(packet);
    }
    fn signal(&mut self, signal: Signal) {
        black_box(signal);
    }
    fn arm(&mut self, _: TimeId, _: u8, _: Ticks) {}
    fn disarm(&mut self, _: TimeId) {}
    fn observe(&mut self, observation: Observation) {
        black_box(observation);
    }
}

/// Seconds that one call of `handle` takes on average over whole meetings of three members, including inputs of passing
/// time.
fn handle() -> f64 {
    const MEETINGS: u32 = 4_000;
    let scenario = scenario(&Meeting { attempts: None, ..timed(3, Watch::FalseRelease, 1, 3, 6) });
    let tables: Vec<_> = (0..3).map(|i| scenario.table(imrs_protocol::NodeId(i))).collect();
    let mut tasks: Vec<CommTask> = (0..3)
        .map(|i| {
            let at = usize::from(i);
            CommTask::new(&tables[at], imrs_protocol::TaskId(i), imrs_protocol::Incarnation(0), false)
        })
        .collect();
    let (mut sent, mut handled) = (Sent::default(), 0_u32);
    let port = imrs_protocol::PortId(0);
    let mut spent = Duration::ZERO;
    for _ in 0..MEETINGS {
        let start = Instant::now();
        for (task, table) in tasks.iter_mut().zip(&tables) {
            let request = Request::Arrive { port, arguments: [0; 8], time_out: None };
            task.handle(table, task.now(), &Input::Request(request), &mut sent);
            handled += 1;
        }
        while let Some(packet) = sent.0.pop() {
            let to = packet.destination.index();
            let task = &mut tasks[to];
            task.handle(&tables[to], task.now(), &Input::Packet(packet), &mut sent);
            handled += 1;
        }
        for (task, table) in tasks.iter_mut().zip(&tables) {
            task.handle(table, task.now() + Ticks(1), &Input::Time, &mut sent);
            handled += 1;
        }
        spent += start.elapsed();
    }
    spent.as_secs_f64() / f64::from(handled)
}

/// By which factor the reductions lower the number of states, in a world that can also be searched without them.
fn reductions(most: u64) {
    let worlds =
        [("3 members, no loss, sent once", patient(0)), ("3 members, 1 loss, sent once", patient(1))];
    for (name, meeting) in worlds {
        let run = |reductions| {
            explore(&with(reductions, &meeting), Limits { states: most, ..Limits::default() }, None)
        };
        let (all, none) = (run(Reductions::ALL), run(Reductions::NONE));
        let at_least = if none.complete { "" } else { "more than " };
        println!(
            "{name}: {} states with the reductions, {at_least}{} without, ratio {at_least}{:.1} (goal >= 20)",
            all.states,
            none.states,
            none.states as f64 / all.states as f64
        );
    }
}

fn sizes(quick: bool) {
    let limits = |states| Limits { states, ..Limits::default() };
    let show = |name: &str, found: &Exploration, goal: u64| {
        println!(
            "{name}: {} states, {} transitions, {} in {:.1} s, {:.0} transitions/s, longest state {} bytes (goal <= {goal})",
            found.states,
            found.transitions,
            if found.complete { "complete" } else { "cut" },
            found.seconds,
            found.transitions as f64 / found.seconds,
            found.longest_state
        );
    };
    let most = if quick { 5_000 } else { 1_000_000 };
    let three = explore(&scenario(&timed(3, Watch::FalseRelease, 1, 3, 5)), limits(most), None);
    show("3 members, 1 loss", &three, 96);
    for (name, meeting) in four() {
        let found = explore(&scenario(&meeting), limits(most), None);
        show(name, &found, 128);
    }
}

/// A meeting of three members that send every packet once. The time_out is the least one with which they can be released.
fn patient(loss: u8) -> Meeting {
    let budget = Budget { loss, dup: 0, crash: 0 };
    Meeting { resend: None, budget, ..timed(3, Watch::FalseRelease, 0, 1, 3) }
}

/// A meeting of members that never give up and send every packet once. One packet is lost.
fn once(members: usize) -> Meeting {
    let budget = Budget { loss: 1, dup: 0, crash: 0 };
    Meeting { delay: Some(1), budget, ..Meeting::new(members, Watch::FalseRelease) }
}

/// Meetings of four members with one lost packet: without time, with every packet sent once, and with time_outs and
/// retransmission.
fn four() -> [(&'static str, Meeting); 3] {
    [
        ("4 members, 1 loss, no time", Meeting { delay: None, ..once(4) }),
        ("4 members, 1 loss, sent once (goal <= 15 s)", once(4)),
        ("4 members, 1 loss, re-sending (goal <= 15 s)", timed(4, Watch::FalseRelease, 1, 3, 5)),
    ]
}
