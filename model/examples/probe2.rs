//! probe2
use imrs_model::worlds::*;
use imrs_model::*;
fn main() {
    let base = |n: usize, w: Watch, t: u64, l: u8, a: u8, m: u64| {
        let mut x = Meeting::new(n, w);
        x.time_out = Some(t);
        x.delay = Some(1);
        x.resend = Some(2);
        x.losses = l;
        x.margin = Some(m);
        x.attempts = Some(a);
        x.budget.loss = l;
        x
    };
    for red in [Reductions::ALL, Reductions::NONE] {
        let mut m = base(3, Watch::AllOrNone, 3, 0, 1, 1);
        m.reductions = red;
        let s = m.scenario().unwrap();
        let e = explore(&s, Limits { states: 3_000_000, memory: 6 << 30 }, None);
        println!(
            "{red:?} {:?} states {} trans {} depth {} {:.2}s {:.2}M/s",
            e.violation,
            e.states,
            e.transitions,
            e.depth,
            e.seconds,
            e.transitions as f64 / e.seconds / 1e6
        );
    }
}
