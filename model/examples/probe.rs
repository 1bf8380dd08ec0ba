//! probe
use imrs_model::*;
struct P;
impl Progress for P {
    fn finished(&self, v: &Verdict) {
        println!(
            "{:24} {:28} n{} {:?}/{:?} {} states {} trans {} depth {} {}B {:.2}s found {:?} cx {:?}",
            v.name,
            v.rule,
            v.parties,
            v.outcome,
            v.expect,
            if v.as_expected { "ok" } else { "UNEXPECTED" },
            v.states,
            v.transitions,
            v.depth,
            v.longest_state,
            v.seconds,
            (
                v.found.least_losses_to_strand,
                v.found.least_losses_with_resending,
                v.found.least_safe_margin,
                v.found.closed_form_margin,
                v.found.attempts
            ),
            v.counterexample.as_ref().map(|c| c.length)
        );
        if std::env::var("CHART").is_ok() {
            if let Some(c) = &v.counterexample {
                println!("{}", c.chart);
            }
        }
    }
}
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let t = std::time::Instant::now();
    let r = verify(
        &Options { full: std::env::var("FULL").is_ok(), claim: a.get(1).cloned(), jobs: 2, memory: 8 << 30 },
        &P,
    );
    println!(
        "{} claims, as expected {} in {:.1}s",
        r.claims.len(),
        r.as_expected(),
        t.elapsed().as_secs_f64()
    );
}
