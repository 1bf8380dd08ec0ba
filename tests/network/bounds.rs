//! The upper bound of a probability, given how often an event was seen in independent trials.

/// The upper end of the 95 % confidence interval (one-sided, Clopper-Pearson) for an event that was seen `seen` times in
/// `trials`. Without an event this is close to the rule of three, 3 / `trials`.
pub fn upper(seen: u64, trials: u64) -> f64 {
    if seen >= trials {
        return 1.0;
    }
    // The probability of at most `seen` events falls as `share` rises. The bound is the share at which it is 5 %.
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let share = (low + high) / 2.0;
        if at_most(seen, trials, share) > 0.05 { low = share } else { high = share }
    }
    high
}

/// The probability of at most `seen` events in `trials`, if each trial has one with the probability `share`.
fn at_most(seen: u64, trials: u64, share: f64) -> f64 {
    let (n, odds) = (trials as f64, (share / (1.0 - share)).ln());
    // The logarithm of the probability of exactly `k` events, from that of `k - 1`.
    let mut of_k = n * (-share).ln_1p();
    let mut sum = of_k.exp();
    for k in 1..=seen {
        let k = k as f64;
        of_k += odds + ((n - k + 1.0) / k).ln();
        sum += of_k.exp();
    }
    sum
}

/// An upper bound as text.
pub fn shown(seen: u64, trials: u64) -> String {
    let bound = upper(seen, trials);
    let text = if bound >= 0.001 { format!("{:.2} %", bound * 100.0) } else { format!("{bound:.1e}") };
    format!("{seen} of {trials}, at most {text}")
}

#[test]
fn upper_bounds_are_those_of_the_tables() {
    for (seen, trials, expected) in [
        (0, 10, 0.2589),
        (1, 10, 0.3942),
        (2, 20, 0.2826),
        (0, 100, 0.02951),
        (5, 100, 0.1022),
        (10, 10, 1.0),
        (0, 1_000_000, 3.0e-6),
    ] {
        let bound = upper(seen, trials);
        assert!((bound / expected - 1.0).abs() < 0.002, "{seen} of {trials}: {bound}, not {expected}");
    }
    assert_eq!(shown(0, 100), "0 of 100, at most 2.95 %");
}
