//! Network namespaces that belong to one test.

use nix::sched::{CloneFlags, unshare};
use std::process::Command;

/// Runs `work` in a network namespace that has only what these commands of `ip` make. Without the right to make a
/// namespace, it reports that the test is skipped; with `IMRS_REQUIRE_ALL=1` it fails.
pub fn in_a_network(commands: &[&str], work: impl FnOnce() + Send) {
    let ran = std::thread::scope(|scope| {
        let own = move || {
            let made =
                unshare(CloneFlags::CLONE_NEWNET).is_ok() && commands.iter().all(|command| ip(command));
            if made {
                work();
            }
            made
        };
        // The namespace belongs to this thread, and ends with the thread.
        scope.spawn(own).join().expect("the test passes")
    });
    if !ran {
        skip("no network namespace (root and `ip`)");
    }
}

/// Reports that a test was skipped, and why; with `IMRS_REQUIRE_ALL=1` it fails.
pub fn skip(missing: &str) {
    let required = std::env::var_os("IMRS_REQUIRE_ALL").is_some_and(|value| value == "1");
    assert!(!required, "{missing}, and IMRS_REQUIRE_ALL=1 requires it");
    eprintln!("\n*** SKIPPED: {missing}: what it is for was NOT tried. ***\n");
}

/// Runs a command of `ip` that changes the network of the calling thread. Returns whether it succeeded.
pub fn ip(command: &str) -> bool {
    Command::new("ip").args(command.split(' ')).status().is_ok_and(|status| status.success())
}
