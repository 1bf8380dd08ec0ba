//! Tests who is kept out, and how this is reported. Nodes that do not fit each other name the reason on both sides.
//! Another user of the machine gets no key of a run.

use crate::run::Bench;
use crate::support::program::Program;
use crate::support::{imrs, is_here, is_quiet, number, own_address, run_in, wait_until};
use rustix::process::{Gid, Uid, getuid};
use rustix::thread::{set_thread_groups, set_thread_res_gid, set_thread_res_uid};
use std::fs::{self, OpenOptions};
use std::net::{Ipv4Addr, UdpSocket};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt, PermissionsExt};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// The position of the byte in a datagram that has the version of the envelope.
const VERSION_AT: usize = 2;
/// The position of the byte in a datagram with keys that says what kind of datagram it is, and the byte's value for
/// packets.
const KIND_AT: usize = 15;
const TRANSPORT: u8 = 0;

/// A process between two nodes: each node sends to it as if it were the other node.
pub struct Between {
    own: Ipv4Addr,
    nodes: [u16; 2],
    sockets: Arc<[UdpSocket; 2]>,
    /// For each node, the datagrams that were sent to it.
    passed: Arc<[Mutex<Vec<Vec<u8>>>; 2]>,
    is_over: Arc<AtomicBool>,
}

impl Between {
    /// Starts to forward datagrams. `change` changes each datagram first.
    pub fn new(own: Ipv4Addr, nodes: [u16; 2], change: fn(&mut [u8])) -> Self {
        let sockets = Arc::new([0, 1].map(|_| UdpSocket::bind((own, 0)).expect("a port")));
        let passed: Arc<[Mutex<Vec<Vec<u8>>>; 2]> = Arc::default();
        let is_over = Arc::new(AtomicBool::new(false));
        for at in [0, 1] {
            let (sockets, passed, is_over) =
                (Arc::clone(&sockets), Arc::clone(&passed), Arc::clone(&is_over));
            sockets[at].set_read_timeout(Some(Duration::from_millis(50))).expect("a time");
            thread::spawn(move || {
                let mut room = [0; 2_000];
                while !is_over.load(Ordering::Acquire) {
                    let Ok(length) = sockets[at].recv(&mut room) else { continue };
                    change(&mut room[..length]);
                    passed[1 - at].lock().expect("no panic").push(room[..length].to_vec());
                    let _ = sockets[1 - at].send_to(&room[..length], (own, nodes[1 - at]));
                }
            });
        }
        Self { own, nodes, sockets, passed, is_over }
    }

    /// The ports at which the nodes find each other: for each node, the port to which the other one sends.
    pub fn ports(&self) -> [u16; 2] {
        self.sockets.each_ref().map(|socket| socket.local_addr().expect("its address").port())
    }

    /// Sends a datagram to a node in the name of the other node.
    fn throw(&self, at: usize, bytes: &[u8]) {
        self.sockets[at].send_to(bytes, (self.own, self.nodes[at])).expect("it leaves");
    }
}

impl Drop for Between {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Release);
    }
}

/// The cell of [`Bench`], with its two nodes at addresses of this test, and keys for both nodes.
struct Pair {
    bench: Bench,
    own: Ipv4Addr,
    ports: [u16; 2],
    keys: String,
}

impl Pair {
    fn new(bench: Bench) -> Self {
        let (own, ports) = own_address();
        let keys = bench.0.path().join("keys").to_str().expect("UTF-8").to_owned();
        let pair = Self { bench, own, ports, keys };
        let cell = pair.cell("both.cell", ports, |text| text);
        pair.keygen(&cell, &pair.keys);
        pair
    }

    fn path(&self) -> &Path {
        self.bench.0.path()
    }

    fn keygen(&self, cell: &str, to: &str) {
        let made = run_in(self.path(), &["keygen", cell, "--out", to]);
        assert_eq!(made.code, Some(0), "{made:?}");
    }

    /// Writes the cell with these ports of its nodes. `change` changes the cell's text.
    fn cell(&self, name: &str, [a, b]: [u16; 2], change: impl Fn(String) -> String) -> String {
        let own = self.own;
        let text = fs::read_to_string(self.bench.cell()).expect("the cell");
        let text = text
            .replace(
                "node na;  node nb;  node nm;",
                &format!("node na at \"{own}\" port {a}; node nb at \"{own}\" port {b};"),
            )
            .replace(
                "link na -- nm delay 1 msec;  link nb -- nm delay 1 msec;",
                "link na -- nb delay 1 msec;",
            );
        let file = self.path().join(name);
        fs::write(&file, change(text)).expect("the cell is written");
        file.to_str().expect("UTF-8").into()
    }

    fn start(&self, cell: &str, node: &str, args: &[&str]) -> Program {
        let args = [&["run", cell, "--node", node, "--for", "10m"], args].concat();
        Program::start(imrs(self.path(), &args))
    }
}

/// Waits until each of two nodes has reported that they cannot communicate, and why. Returns how long that took after
/// both nodes ran.
fn refused(mut nodes: [Program; 2], words: &str) -> Duration {
    let running = nodes.each_mut().map(|node| node.line().0);
    let said = nodes.each_mut().map(|node| {
        loop {
            let (at, line) = node.line();
            if line.contains("do not talk") {
                assert!(line.contains(words), "{line}");
                return at;
            }
        }
    });
    for node in nodes {
        node.interrupt();
        assert_eq!(node.finish().code, Some(1));
    }
    let [running, said] = [running, said].map(|at| at.into_iter().max().unwrap_or_else(Instant::now));
    said.saturating_duration_since(running)
}

#[test]
fn nodes_that_do_not_fit_say_why_on_both_sides_within_a_second() {
    let pair = Pair::new(Bench::new());
    let [cell, declared, stated] = [
        pair.cell("cell.cell", pair.ports, |text| text),
        pair.cell("declared.cell", pair.ports, |text| text.replace("delay 1 msec", "delay 2 msec")),
        pair.cell("stated.cell", pair.ports, |text| text.replace("q.n + 1);", "q.n + 2);")),
    ];
    let others = format!("{}.others", pair.keys);
    pair.keygen(&cell, &others);
    let between = Between::new(pair.own, pair.ports, |bytes| bytes[VERSION_AT] ^= 0x40);
    let [to_nb, to_na] = between.ports();
    let [apart_a, apart_b] = [
        pair.cell("apart-a.cell", [pair.ports[0], to_nb], |text| text),
        pair.cell("apart-b.cell", [to_na, pair.ports[1]], |text| text),
    ];
    let keys = ["--keys", &pair.keys];
    for (na, nb, how, words) in [
        (&cell, &declared, &keys[..], "their declarations differ"),
        (&cell, &stated, &keys, "their statements differ"),
        (&cell, &cell, &["--keys", &others], "their keys differ"),
        (&cell, &cell, &["--insecure"], "one of them has keys and the other has none"),
        (&apart_a, &apart_b, &keys, "different versions of the protocol"),
    ] {
        let within = refused([pair.start(nb, "nb", how), pair.start(na, "na", &keys)], words);
        println!("{within:>10.3?} {words}");
        assert!(!is_quiet() || within < Duration::from_secs(1), "{words}: {within:?}");
    }
}

/// The test records all datagrams, restarts one of the nodes, and then sends the old datagrams to both nodes again.
#[test]
fn datagrams_of_an_ended_session_are_dropped_by_name_on_both_sides_within_a_second() {
    let pair = Pair::new(Bench::that_waits(120));
    let between = Between::new(pair.own, pair.ports, |_| ());
    let [to_nb, to_na] = between.ports();
    let [a, b] = [
        pair.cell("apart-a.cell", [pair.ports[0], to_nb], |text| text),
        pair.cell("apart-b.cell", [to_na, pair.ports[1]], |text| text),
    ];
    let args = ["--keys", &pair.keys];
    let nb = pair.start(&b, "nb", &args);
    let first = pair.start(&a, "na", &args).finish();
    assert_eq!(first.code, Some(0), "{first:?}");
    let is_transport = |bytes: &&Vec<u8>| bytes[KIND_AT] == TRANSPORT;
    let old = [0, 1].map(|at| std::mem::take(&mut *between.passed[at].lock().expect("no panic")));
    let mut again = pair.start(&a, "na", &args);
    let _started = again.line();
    // The task of `nb` waits, and repeats its announcement. The task of `na` is held back as long as messages to its
    // earlier incarnation may still arrive.
    let talk_on = || {
        let passed = || between.passed[0].lock().expect("no panic").iter().filter(is_transport).count();
        let before = passed();
        wait_until("nb has sent more", || passed() > before + 5);
    };
    talk_on();
    for (at, old) in old.iter().enumerate() {
        let old: Vec<_> = old.iter().filter(is_transport).collect();
        assert!(!old.is_empty());
        old.iter().for_each(|bytes| between.throw(at, bytes));
    }
    let thrown = Instant::now();
    // When the nodes have received these newer datagrams, they have also received the old ones that were sent before.
    talk_on();
    for mut node in [again, nb] {
        let said_at = loop {
            let (at, line) = node.line();
            if line.contains("has dropped datagrams of an ended session (") {
                break at;
            }
        };
        let within = said_at.saturating_duration_since(thrown);
        assert!(!is_quiet() || within < Duration::from_secs(1), "{within:?}");
        node.interrupt();
        let said = node.finish();
        assert!(said.out.contains("stale_session"), "{said:?}");
        assert!(!said.out.contains("replayed"), "none came near the counters of the new session: {said:?}");
    }
}

/// The ids of the user who runs the nodes, and of another user. Neither needs an entry in the system's list of users.
const OWNER: u32 = 61_001;
const OTHER: u32 = 61_002;

/// Runs `work` as this user, in a thread of its own.
fn as_user<T: Send + 'static>(user: u32, work: impl FnOnce() -> T + Send + 'static) -> T {
    let thread = thread::spawn(move || {
        let (uid, gid) = (Uid::from_raw(user), Gid::from_raw(user));
        set_thread_groups(&[]).expect("no groups");
        set_thread_res_gid(gid, gid, gid).expect("its group");
        // From here on this thread, and only this thread, lacks the rights of root.
        set_thread_res_uid(uid, uid, uid).expect("its user");
        work()
    });
    thread.join().expect("no panic")
}

fn can_read(user: u32, file: PathBuf) -> bool {
    // The file may be a pipe, so opening it must not wait for a writer.
    let nonblocking = i32::try_from(rustix::fs::OFlags::NONBLOCK.bits()).expect("a flag");
    as_user(user, move || OpenOptions::new().read(true).custom_flags(nonblocking).open(file).is_ok())
}

fn can_connect(user: u32, socket: PathBuf) -> bool {
    as_user(user, move || UnixStream::connect(socket).is_ok())
}

/// All files in a folder and in its subfolders.
fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    entries.flat_map(|path| if path.is_dir() { files_in(&path) } else { vec![path] }).collect()
}

/// The command for a run of the owner in this folder. It executes a copy of the program that the owner may execute.
fn run_of_owner(folder: &Path, args: &[&str]) -> Command {
    let plain = imrs(folder, args);
    let mut command = Command::new(folder.join("imrs"));
    command.args(plain.get_args()).envs(plain.get_envs().filter_map(|(name, value)| Some((name, value?))));
    // A node refuses a folder for its sockets that other users may enter.
    command.env("XDG_RUNTIME_DIR", folder.join("run"));
    command.current_dir(folder).uid(OWNER).gid(OWNER);
    command
}

/// Starts a run. Returns the run, and the ids of its processes: those of the nodes, and that of the launcher.
fn processes(folder: &Path, cell: &str, args: &[&str]) -> (Program, Vec<u64>) {
    let args = [&["run", cell, "--for", "10m", "--format", "json"], args].concat();
    let mut run = Program::start(run_of_owner(folder, &args));
    let started = run.json();
    let nodes = started["started"].as_array().expect("nodes");
    let pids = nodes.iter().map(|node| number(&node["pid"])).chain([u64::from(run.pid())]).collect();
    (run, pids)
}

#[test]
fn another_user_of_the_machine_gets_no_key_no_socket_and_no_pipe() {
    if !is_here((!getuid().is_root()).then_some("the right to be another user"), "no other user was tried") {
        return;
    }
    let bench = Bench::new();
    let folder = bench.0.path();
    // The folder is open to all users, so that only the modes of the files keep others out.
    fs::set_permissions(folder, fs::Permissions::from_mode(0o755)).expect("a mode");
    fs::copy(env!("CARGO_BIN_EXE_imrs"), folder.join("imrs")).expect("a copy");
    fs::create_dir(folder.join("run")).expect("a folder");
    fs::set_permissions(folder.join("run"), fs::Permissions::from_mode(0o700)).expect("a mode");
    for folder in [folder.to_owned(), folder.join("run")] {
        std::os::unix::fs::chown(folder, Some(OWNER), Some(OWNER)).expect("its owner");
    }
    let cell = bench.cell();
    let cell = cell.to_str().expect("UTF-8");
    let keygen = Program::start(run_of_owner(folder, &["keygen", cell])).finish();
    assert_eq!(keygen.code, Some(0), "{keygen:?}");
    let (run, pids) = processes(folder, cell, &[]);

    let keys: Vec<_> =
        files_in(folder).into_iter().filter(|file| file.extension().is_some_and(|e| e == "keys")).collect();
    assert_eq!(keys.len(), 3, "{keys:?}");
    fs::set_permissions(keys[0].parent().expect("a folder"), fs::Permissions::from_mode(0o755))
        .expect("a mode");
    for file in keys {
        assert!(can_read(OWNER, file.clone()), "{file:?}");
        assert!(!can_read(OTHER, file.clone()), "{file:?}");
    }
    let is_socket =
        |file: &PathBuf| fs::symlink_metadata(file).is_ok_and(|found| found.file_type().is_socket());
    let sockets: Vec<_> = files_in(folder).into_iter().filter(is_socket).collect();
    assert!(sockets.len() >= 3, "{sockets:?}");
    for socket in sockets {
        assert!(can_connect(OWNER, socket.clone()), "{socket:?}");
        assert!(!can_connect(OTHER, socket.clone()), "{socket:?}");
    }
    for pid in &pids {
        let of = |name: &str| PathBuf::from(format!("/proc/{pid}/{name}"));
        let command_line = fs::read(of("cmdline")).expect("a command line");
        let environment = fs::read(of("environ")).expect("an environment");
        for text in [command_line, environment] {
            assert!(!text.windows(64).any(|run| run.iter().all(u8::is_ascii_hexdigit)), "a key in clear");
        }
        let open: Vec<_> =
            fs::read_dir(of("fd")).expect("descriptors").flatten().map(|fd| fd.path()).collect();
        assert!(!open.is_empty());
        for file in open.into_iter().chain([of("mem"), of("environ"), of("maps")]) {
            assert!(!can_read(OTHER, file.clone()), "{file:?}");
            // Not even another process of the same user can read this file.
            assert!(!can_read(OWNER, file.clone()), "{file:?}");
        }
    }
    run.interrupt();
    run.finish();
    // The same attempt succeeds in a run without keys, so the attempt is able to find files that can be read.
    let (run, pids) = processes(folder, cell, &["--insecure"]);
    let memory = PathBuf::from(format!("/proc/{}/mem", pids[0]));
    assert!(can_read(OWNER, memory.clone()) && !can_read(OTHER, memory));
    run.interrupt();
    run.finish();
}
