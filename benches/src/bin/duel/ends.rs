//! The two ends of a stream, each in a process of its own: the commander sends, the executor executes.

use imrs_bench::duel::{Command, EXECUTION, PERIOD, WARM_UP};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::thread::{park, sleep};
use std::time::{Duration, Instant};

/// The addresses of the two ends, each in a network namespace of its own.
pub const COMMANDER: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(10, 78, 0, 1), 7400);
pub const EXECUTOR: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(10, 78, 0, 2), 7400);

/// The lines that the ends print for the parent process.
pub const LISTENS: &str = "listens";
pub const BEGINS: &str = "begins";

/// How long the commander warms up, so that both ends know each other before the first command.
const WARM_FOR: Duration = Duration::from_secs(1);
const WARM_EVERY: Duration = Duration::from_millis(20);

/// Tells the parent process that the executor listens.
pub fn listens() {
    println!("{LISTENS}");
}

/// Executes a command: reports its number and its age, and acts.
pub fn execute(bytes: &[u8]) {
    let command = Command::decode(bytes).expect("a command");
    if command.number == WARM_UP {
        return;
    }
    println!("{} {}", command.number, command.age());
    sleep(EXECUTION);
}

/// Sends the stream and reports how many commands were sent. Each command has its own slot of [`PERIOD`]; slots that
/// pass while a command waits for its answer are skipped. Then waits until the parent process ends this process,
/// because a library sends its queued messages only while its process lives.
pub fn command(length: Duration, mut send: impl FnMut(&[u8; Command::BYTES])) -> ! {
    let warm = Instant::now();
    while warm.elapsed() < WARM_FOR {
        send(&Command::now(WARM_UP).encode());
        sleep(WARM_EVERY);
    }
    println!("{BEGINS}");
    let (begins, mut slot, mut sent) = (Instant::now(), 0, 0);
    while slot * PERIOD < length {
        sleep((begins + slot * PERIOD).saturating_duration_since(Instant::now()));
        send(&Command::now(slot).encode());
        sent += 1;
        let passed = begins.elapsed().as_nanos() / PERIOD.as_nanos();
        slot = u32::try_from(passed).expect("a short stream").max(slot) + 1;
    }
    println!("{sent}");
    loop {
        park();
    }
}
