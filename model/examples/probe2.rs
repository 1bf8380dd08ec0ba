//! probe2
use imrs_model::worlds::*;
use imrs_model::*;
fn run(name: &str, s: std::sync::Arc<Scenario>) -> bool {
    let e = explore(&s, Limits { states: 3_000_000, memory: 6 << 30 }, None);
    println!(
        "{name:40} {:?} states {} trans {} depth {} len {:?} max {}B {:.2}s {:.2}M/s complete {}",
        e.violation,
        e.states,
        e.transitions,
        e.depth,
        e.path.as_ref().map(|p| p.len()),
        e.longest_state,
        e.seconds,
        e.transitions as f64 / e.seconds / 1e6,
        e.complete
    );
    if std::env::var("CHART").is_ok() {
        if let Some(c) = draw(&s, &e) {
            println!("{}", c.chart);
        } else {
            println!("no chart");
        }
    }
    e.violation.is_some()
}
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
    let mut m = base(2, Watch::FalseRelease, 5, 1, 2, 3);
    m.budget.crash = 1;
    run("crash", m.scenario().unwrap());
    let mut q = m.clone();
    q.rules.quarantine = false;
    run("crash no quarantine", q.scenario().unwrap());
    for t in 9..=8 {
        for k in 1..=3 {
            let mut m = base(3, Watch::MeetAgain { attempts: k }, t, 0, 1, 1);
            if !run(&format!("meet n3 t{t} k{k}"), m.scenario().unwrap()) {
                break;
            }
        }
    }
}
