//! Two hosts: network namespaces, each with a network card. This process connects the cards, and drops a share of all
//! packets between them.

use crate::ends::{COMMANDER, EXECUTOR};
use nix::sched::{CloneFlags, unshare};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::ioctl::{Opcode, Updater, ioctl, opcode};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::thread::{self, JoinHandle};

/// How long a connection waits for a packet before it checks whether it is over, in nanoseconds.
const LOOK_EVERY: i64 = 20_000_000;

/// Starts an end of the stream on a host of its own. Returns its process and the other end of its network card.
pub fn start(is_executor: bool, program: &mut Command) -> io::Result<(Child, File)> {
    let address = if is_executor { EXECUTOR } else { COMMANDER };
    // Only this thread moves into the new namespace. The process that it starts stays there.
    thread::scope(|scope| {
        let made = scope.spawn(move || {
            unshare(CloneFlags::CLONE_NEWNET)?;
            let card = card()?;
            let address = format!("{}/24", address.ip());
            for args in [
                &["link", "set", "lo", "up"][..],
                &["addr", "add", &address, "dev", "duel"],
                &["link", "set", "duel", "up"],
            ] {
                if !Command::new("ip").args(args).status()?.success() {
                    return Err(io::Error::other(format!("ip {} failed", args.join(" "))));
                }
            }
            Ok((program.stdout(Stdio::piped()).spawn()?, card))
        });
        made.join().expect("no panic")
    })
}

/// `struct ifreq` of the kernel, as far as TUNSETIFF reads it.
#[repr(C)]
struct InterfaceRequest {
    name: [u8; 16],
    flags: u16,
    unused: [u8; 22],
}

/// Makes the network card `duel` in the namespace of this thread. Returns the other end of the card.
fn card() -> io::Result<File> {
    /// A card whose IP packets are read and written as they are, without a header before them (TUN, NO_PI).
    const PACKETS: u16 = 0x0001 | 0x1000;
    const TUNSETIFF: Opcode = opcode::write::<i32>(b'T', 202);
    let card = OpenOptions::new().read(true).write(true).open("/dev/net/tun")?;
    let mut request = InterfaceRequest { name: [0; 16], flags: PACKETS, unused: [0; 22] };
    request.name[..4].copy_from_slice(b"duel");
    // SAFETY: TUNSETIFF reads and writes one `struct ifreq`, which has 40 bytes, and `InterfaceRequest` has that layout.
    unsafe { ioctl(&card, Updater::<TUNSETIFF, InterfaceRequest>::new(&mut request))? };
    Ok(card)
}

/// The connection of the two cards: a thread for each direction.
pub struct Cable {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    /// How many of a hundred packets are lost.
    loss: AtomicU8,
    is_over: AtomicBool,
}

impl Cable {
    /// Connects two cards. The seed determines which packets are lost.
    pub fn new(cards: [File; 2], seed: u64) -> Self {
        let (cards, shared) = (cards.map(Arc::new), Arc::<Shared>::default());
        let one_way = |from: usize| {
            let draws = fastrand::Rng::with_seed(seed + from as u64);
            let (from, to, shared) =
                (Arc::clone(&cards[from]), Arc::clone(&cards[1 - from]), Arc::clone(&shared));
            thread::spawn(move || pass(&from, &to, &shared, draws))
        };
        let threads = vec![one_way(0), one_way(1)];
        Self { shared, threads }
    }

    /// Loses `percent` of a hundred packets from now on.
    pub fn lose(&self, percent: u8) {
        self.shared.loss.store(percent, Ordering::Relaxed);
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| drop(thread.join()));
    }
}

fn pass(mut from: &File, mut to: &File, shared: &Shared, mut draws: fastrand::Rng) {
    let mut packet = [0; 2_048];
    while !shared.is_over.load(Ordering::Relaxed) {
        let most = Timespec { tv_sec: 0, tv_nsec: LOOK_EVERY };
        if !poll(&mut [PollFd::new(&from, PollFlags::IN)], Some(&most)).is_ok_and(|ready| ready > 0) {
            continue;
        }
        // A card that is gone reports an error until the connection is over.
        let Ok(length) = from.read(&mut packet) else { continue };
        if draws.u8(..100) >= shared.loss.load(Ordering::Relaxed) {
            let _ = to.write(&packet[..length]);
        }
    }
}
