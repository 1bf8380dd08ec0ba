//! The cases that need no other library: hand-written baselines, and the subjects that are measured.

pub mod cells;
pub mod floors;
pub mod growth;
pub mod handoff;
pub mod heaps;
pub mod keys;
pub mod meet;
pub mod network;
pub mod observe;
pub mod queues;
pub mod recording;
#[cfg(feature = "screen")]
pub mod screen;
pub mod urgent;
pub mod wire;

use crate::suite::Suite;

/// All suites. A build with features such as `peers` also measures other libraries in them.
#[must_use]
pub fn all() -> Vec<Suite> {
    let mut suites = vec![
        handoff::awake(),
        handoff::threads(),
        urgent::urgent(),
        urgent::streams(),
        queues::queues(),
        queues::timers(),
        growth::growth(),
        growth::footprint(),
        meet::meetings(),
        network::network(),
        wire::wire(),
        recording::recording(),
        observe::observe(),
    ];
    #[cfg(feature = "screen")]
    suites.push(screen::screen());
    crate::peers::join(&mut suites);
    for suite in &mut suites {
        let name = suite.name;
        suite.cases.iter_mut().for_each(|case| case.on_two = is_on_two(name, &case.name));
    }
    suites
}

/// Whether threads of this case run on two processors at once.
fn is_on_two(suite: &str, case: &str) -> bool {
    match suite {
        "awake" => case == "kameo/ask from a thread",
        "threads" => !case.ends_with("one core"),
        "network" => !(case.ends_with("one core") || case.starts_with("refuse/")),
        "urgent" | "streams" => true,
        // The members of a meeting run on one thread if they are scripts or tasks of tokio.
        "meetings" => case.starts_with("floor/") || case.starts_with("runtime/waitfor"),
        "recording" => case.starts_with("threads ") || case.starts_with("UDP "),
        "observe" => case.starts_with("watched by "),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_case_that_names_two_cores_is_one_of_two_processors() {
        for suite in super::all() {
            for case in &suite.cases {
                let named = [case.name.as_str(), case.about].iter().any(|text| text.contains("two cores"));
                assert!(case.on_two || !named, "{}: {}", suite.name, case.name);
                let one = case.name.ends_with("one core") || case.name.starts_with("machine/");
                assert!(!(case.on_two && one), "{}: {}", suite.name, case.name);
            }
        }
    }
}
