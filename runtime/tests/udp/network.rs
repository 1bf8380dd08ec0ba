//! Networks of a test's own.

use nix::sched::{CloneFlags, unshare};
use std::process::Command;

/// Runs `work` where nothing of the machine's network is, but what these commands of `ip` make. Without the right to make that
/// it says so; where everything is required it fails.
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
        // The namespace is this thread's, and goes with it.
        scope.spawn(own).join().expect("the test passes")
    });
    if !ran {
        skip("no network namespace (root and `ip`)");
    }
}

/// Says that a test was not tried, and why; where everything is required it fails.
pub fn skip(missing: &str) {
    let required = std::env::var_os("IMRS_REQUIRE_ALL").is_some_and(|value| value == "1");
    assert!(!required, "{missing}, and IMRS_REQUIRE_ALL=1 requires it");
    eprintln!("\n*** SKIPPED: {missing}: what it is for was NOT tried. ***\n");
}

/// Changes the network of the calling thread.
pub fn ip(command: &str) -> bool {
    Command::new("ip").args(command.split(' ')).status().is_ok_and(|status| status.success())
}
