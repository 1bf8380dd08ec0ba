//! Hosts: network namespaces, each with one network card whose other end is the switch in this process.
//!
//! The namespaces have no names. They end with the last process or file descriptor that uses them, so that nothing is
//! left behind, however a test ends.

use super::frames::hardware_address;
use super::switch::{Counts, Decisions, Departure, Faults};
use crate::support::is_here;
use nix::sched::{CloneFlags, unshare};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::ioctl::{Opcode, Updater, ioctl, opcode};
use rustix::process::getuid;
use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::net::Ipv4Addr;
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// The longest time until the switch notices that its hosts are gone.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// The size of the largest frame: a network card takes 1500 bytes behind the Ethernet header.
const LARGEST: usize = 1_600;

/// Whether this process may make hosts. If not, this function prints what is not tested.
pub fn are_possible() -> bool {
    let missing = if !getuid().is_root() {
        Some("the right to make network namespaces (root)")
    } else if !Path::new("/dev/net/tun").exists() {
        Some("/dev/net/tun")
    } else if !Command::new("ip").arg("-V").stdout(Stdio::null()).status().is_ok_and(|ended| ended.success())
    {
        Some("ip (iproute2)")
    } else {
        None
    };
    is_here(missing, "no faults of a network between hosts were tried")
}

/// Several hosts at one switch.
pub struct Hosts {
    namespaces: Vec<File>,
    cards: Arc<Vec<File>>,
    shared: Arc<Shared>,
    switch: Option<JoinHandle<()>>,
}

struct Shared {
    decisions: Mutex<Decisions>,
    is_over: AtomicBool,
}

impl Hosts {
    /// Makes hosts at a switch. The switch draws its faults from this seed.
    pub fn new(count: usize, seed: u64) -> Self {
        let (namespaces, cards): (Vec<File>, Vec<File>) = (0..count).map(|host| host_of(host, count)).unzip();
        let (cards, decisions) = (Arc::new(cards), Mutex::new(Decisions::new(seed, count)));
        let shared = Arc::new(Shared { decisions, is_over: AtomicBool::new(false) });
        let switch = Some(thread::spawn({
            let (cards, shared) = (Arc::clone(&cards), Arc::clone(&shared));
            move || Switching { cards, waiting: BinaryHeap::new(), number: 0 }.run(&shared)
        }));
        Self { namespaces, cards, shared, switch }
    }

    /// The address of a host.
    pub fn address(host: usize) -> Ipv4Addr {
        Ipv4Addr::new(10, 77, 0, u8::try_from(host + 1).expect("a few hosts"))
    }

    /// Runs `work` on a host. Sockets that `work` opens and processes that it starts stay on that host.
    pub fn on<T: Send>(&self, host: usize, work: impl FnOnce() -> T + Send) -> T {
        let namespace = self.namespaces[host].as_fd();
        thread::scope(|scope| {
            let thread = scope.spawn(move || {
                move_into_link_name_space(namespace, Some(LinkNameSpaceType::Network)).expect("its network");
                work()
            });
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    }

    fn decisions(&self) -> MutexGuard<'_, Decisions> {
        self.shared.decisions()
    }

    /// Subjects all datagrams to these faults from now on.
    pub fn set(&self, faults: Faults) {
        self.decisions().set(faults);
    }

    /// Cuts the link from one host to another, in this direction only.
    pub fn cut(&self, from: usize, to: usize) {
        self.decisions().cut(from, to);
    }

    /// Cuts this host off from all others, in both directions.
    pub fn isolate(&self, host: usize) {
        let mut decisions = self.decisions();
        for other in (0..self.namespaces.len()).filter(|other| *other != host) {
            decisions.cut(host, other);
            decisions.cut(other, host);
        }
    }

    /// Ends all cuts.
    pub fn heal(&self) {
        self.decisions().heal();
    }

    /// Sends the first datagrams of all hosts once more to their receivers, as an attacker does who has recorded them.
    /// Returns the number of these datagrams.
    pub fn repeat(&self) -> usize {
        let seen = self.decisions().seen.clone();
        for (to, frame) in &seen {
            let _ = (&self.cards[*to]).write(frame);
        }
        seen.len()
    }

    pub fn counts(&self) -> Counts {
        self.decisions().counts
    }

    /// Sets the network card of a host up or down.
    pub fn link(&self, host: usize, state: &str) {
        self.on(host, || {
            ip(&["link", "set", "eth0", state]);
            // While a card is down, the kernel forgets the addresses of the other hosts. So they are entered again.
            if state == "up" {
                know_others(host, self.namespaces.len());
            }
        });
    }
}

impl Drop for Hosts {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::Release);
        if let Some(switch) = self.switch.take() {
            let _ = switch.join();
        }
    }
}

impl Shared {
    fn decisions(&self) -> MutexGuard<'_, Decisions> {
        self.decisions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Makes a host. Returns its namespace and the other end of its network card.
fn host_of(host: usize, count: usize) -> (File, File) {
    let made = thread::spawn(move || {
        // This call moves only the present thread into the new namespace.
        unshare(CloneFlags::CLONE_NEWNET).expect("a network namespace");
        let card = card().expect("a network card");
        // Without IPv6 the kernel sends nothing by itself.
        let _ = std::fs::write("/proc/sys/net/ipv6/conf/all/disable_ipv6", "1");
        let address = format!("{}/24", Hosts::address(host));
        ip(&["link", "set", "lo", "up"]);
        ip(&["link", "set", "eth0", "address", &hardware_address(host)]);
        ip(&["addr", "add", &address, "dev", "eth0"]);
        ip(&["link", "set", "eth0", "up"]);
        know_others(host, count);
        (File::open("/proc/thread-self/ns/net").expect("its namespace"), card)
    });
    made.join().expect("a host")
}

/// Tells a host the hardware addresses of all other hosts, so that no ARP frame is needed, which could be lost.
fn know_others(host: usize, count: usize) {
    for other in (0..count).filter(|other| *other != host) {
        let (address, card) = (Hosts::address(other).to_string(), hardware_address(other));
        ip(&["neigh", "replace", &address, "lladdr", &card, "dev", "eth0", "nud", "permanent"]);
    }
}

fn ip(args: &[&str]) {
    command("ip", args);
}

/// Runs a program of iproute2 on the host of this thread.
pub fn command(program: &str, args: &[&str]) {
    let said = Command::new(program).args(args).output().expect(program);
    assert!(said.status.success(), "{program} {args:?}: {}", String::from_utf8_lossy(&said.stderr));
}

/// `struct ifreq` of the kernel, as far as TUNSETIFF reads it.
#[repr(C)]
struct InterfaceRequest {
    name: [u8; 16],
    flags: u16,
    unused: [u8; 22],
}

/// Makes the network card `eth0` in the namespace of this thread. Returns the other end of the card.
fn card() -> io::Result<File> {
    /// A card whose frames are read and written as they are, without a header before them (TAP, NO_PI).
    const FRAMES: u16 = 0x0002 | 0x1000;
    const TUNSETIFF: Opcode = opcode::write::<i32>(b'T', 202);
    let nonblocking = i32::try_from(rustix::fs::OFlags::NONBLOCK.bits()).expect("a flag");
    let card = OpenOptions::new().read(true).write(true).custom_flags(nonblocking).open("/dev/net/tun")?;
    let mut request = InterfaceRequest { name: [0; 16], flags: FRAMES, unused: [0; 22] };
    request.name[..4].copy_from_slice(b"eth0");
    // SAFETY: TUNSETIFF reads and writes one `struct ifreq`, which has 40 bytes, and `InterfaceRequest` has that layout.
    unsafe { ioctl(&card, Updater::<TUNSETIFF, InterfaceRequest>::new(&mut request))? };
    Ok(card)
}

/// A frame that the switch holds: when the frame leaves, its number, its receiver, and its bytes. The number keeps the
/// order of frames that leave at the same time.
type Held = (Instant, u64, usize, Vec<u8>);

/// The thread of the switch.
struct Switching {
    cards: Arc<Vec<File>>,
    /// The frames that are held, the next one to leave first.
    waiting: BinaryHeap<Reverse<Held>>,
    number: u64,
}

impl Switching {
    fn run(mut self, shared: &Shared) {
        let mut room = [0; LARGEST];
        while !shared.is_over.load(Ordering::Acquire) {
            self.let_go();
            self.wait();
            for from in 0..self.cards.len() {
                while let Ok(length) = (&self.cards[from]).read(&mut room) {
                    let departures = shared.decisions().decide(from, room[..length].to_vec());
                    self.keep(departures);
                }
                self.let_go();
            }
        }
    }

    fn keep(&mut self, departures: Vec<Departure>) {
        let now = Instant::now();
        for Departure { to, after, frame } in departures {
            self.number += 1;
            self.waiting.push(Reverse((now + after, self.number, to, frame)));
        }
    }

    /// Passes on all frames whose time to leave has come.
    fn let_go(&mut self) {
        let now = Instant::now();
        while self.waiting.peek().is_some_and(|Reverse((at, ..))| *at <= now) {
            let Some(Reverse((.., to, frame))) = self.waiting.pop() else { return };
            // If the receiver's network card is down, the frame is lost.
            let _ = (&self.cards[to]).write(&frame);
        }
    }

    /// Waits for the next frame, or until a held frame must leave.
    fn wait(&self) {
        let next = self.waiting.peek().map(|Reverse((at, ..))| at.saturating_duration_since(Instant::now()));
        let most =
            Timespec::try_from(next.map_or(LOOK_EVERY, |next| next.min(LOOK_EVERY))).expect("a short time");
        let mut cards: Vec<PollFd<'_>> =
            self.cards.iter().map(|card| PollFd::new(card, PollFlags::IN)).collect();
        // A signal or an error ends the wait, too.
        let _ = poll(&mut cards, Some(&most));
    }
}
