//! The baselines (`floor/..`): the least that a hand-over between threads can cost, written by hand without messages,
//! deadlines or order.

use crate::cores::{self, Core};
use crate::sample::{Sample, each, laps};
use crate::suite::{Effort, Suite};
use rustix::thread::futex;
use std::cell::Cell;
use std::collections::VecDeque;
use std::future::Future;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream, UdpSocket};
use std::pin::Pin;
use std::rc::Rc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::task::{Context, Poll, Waker};
use std::thread::{self, Thread};
use std::time::Duration;

/// How many operations share one reading of the clock, if one operation takes less time than the reading.
pub const GROUP: u32 = 32;
const FAR: Duration = Duration::from_secs(60);
const STOP: u32 = u32::MAX;

/// Two coroutines that pass a number to each other. They are boxed futures, and a queue holds the futures that are
/// ready.
pub fn coroutines(effort: Effort) -> Sample {
    struct Turn(Rc<Cell<u64>>, Rc<Cell<bool>>, bool);
    impl Future for Turn {
        type Output = u64;
        fn poll(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<u64> {
            if self.1.get() == self.2 { Poll::Ready(self.0.get()) } else { Poll::Pending }
        }
    }
    let (value, turn) = (Rc::new(Cell::new(0_u64)), Rc::new(Cell::new(false)));
    let ready = Rc::new(std::cell::RefCell::new(VecDeque::from([0_usize])));
    let one = |own: bool| -> Pin<Box<dyn Future<Output = ()>>> {
        let (value, turn, ready) = (Rc::clone(&value), Rc::clone(&turn), Rc::clone(&ready));
        Box::pin(async move {
            loop {
                let got = Turn(Rc::clone(&value), Rc::clone(&turn), own).await;
                value.set(got + 1);
                turn.set(!own);
                ready.borrow_mut().push_back(usize::from(!own));
            }
        })
    };
    let mut both = [one(false), one(true)];
    let mut context = Context::from_waker(Waker::noop());
    let mut round_trip = || {
        for _ in 0..2 {
            let next = ready.borrow_mut().pop_front();
            if let Some(next) = next {
                assert!(both[next].as_mut().poll(&mut context).is_pending());
            }
        }
    };
    let sample = each(effort.of(400_000), GROUP, &mut round_trip);
    assert!(value.get() >= 2);
    sample
}

/// The name of the case that measures how far apart the two cores are.
pub const LINE: &str = "floor/spinning line";

/// Adds the case [`LINE`] to a suite whose results depend on it, so that both are measured in the same
/// rounds.
pub fn line(suite: &mut Suite) {
    suite.case(LINE, "two hot threads on two cores, one cache line", spinning_line);
}

/// Two threads that pass a number in one cache line and never sleep.
pub fn spinning_line(effort: Effort) -> Sample {
    let line = AtomicU32::new(0);
    ping_pong(
        effort.of(100_000),
        GROUP,
        Core::Second,
        &line,
        |from| while_spinning(&line, from),
        |to| line.store(to, Ordering::Release),
    )
}

fn while_spinning(line: &AtomicU32, from: u32) -> u32 {
    loop {
        let value = line.load(Ordering::Acquire);
        if value != from {
            return value;
        }
        std::hint::spin_loop();
    }
}

/// As `spinning_line`, but a waiting thread sleeps on a futex after some spinning, and the other thread wakes it only
/// if it sleeps.
pub fn spin_then_futex(effort: Effort) -> Sample {
    const LOOKS: u32 = 2_000;
    const ASLEEP: u32 = 1 << 31;
    let line = AtomicU32::new(0);
    let wait = |from: u32| {
        for _ in 0..LOOKS {
            let value = line.load(Ordering::Acquire);
            if value != from {
                return value;
            }
            std::hint::spin_loop();
        }
        let asleep = from | ASLEEP;
        if line.compare_exchange(from, asleep, Ordering::AcqRel, Ordering::Acquire).is_ok() {
            while line.load(Ordering::Acquire) == asleep {
                let _ = futex::wait(&line, futex::Flags::PRIVATE, asleep, None);
            }
        }
        line.load(Ordering::Acquire)
    };
    let pass = |to: u32| {
        if line.swap(to, Ordering::AcqRel) & ASLEEP != 0 {
            let _ = futex::wake(&line, futex::Flags::PRIVATE, 1);
        }
    };
    // `STOP` contains the `ASLEEP` bit. So here 0 and 1 say which thread runs next, and 2 ends the loop.
    let (wait, pass) = (&wait, &pass);
    cores::pin(Core::First);
    let sample = thread::scope(|s| {
        s.spawn(move || {
            cores::pin(Core::Second);
            while wait(0) != 2 {
                pass(0);
            }
        });
        let sample = each(effort.of(100_000), GROUP, || {
            pass(1);
            wait(1);
        });
        pass(2);
        sample
    });
    cores::unpin();
    sample
}

/// Passes a number to and fro. This thread writes 1 and waits for 0; the other thread writes 0 and waits for 1.
fn ping_pong(
    times: u32,
    group: u32,
    other: Core,
    line: &AtomicU32,
    wait: impl Fn(u32) -> u32 + Sync,
    pass: impl Fn(u32) + Sync,
) -> Sample {
    let (wait, pass) = (&wait, &pass);
    cores::pin(Core::First);
    let sample = thread::scope(|s| {
        s.spawn(move || {
            cores::pin(other);
            while wait(0) != STOP {
                pass(0);
            }
        });
        let sample = each(times, group, || {
            pass(1);
            wait(1);
        });
        line.store(STOP, Ordering::Release);
        sample
    });
    cores::unpin();
    sample
}

/// A row of threads in which each wakes the next one, to the last thread and back. A waiting thread sleeps in `park` or
/// `park_timeout`.
pub fn relay(effort: Effort, full: u32, threads: usize, places: [Core; 2], timed: bool) -> Sample {
    let turn = AtomicU32::new(0);
    // a b c d c b: the thread of each step of a round trip.
    let row: Vec<usize> = (0..threads).chain((1..threads - 1).rev()).collect();
    let steps = u32::try_from(row.len()).expect("few threads");
    cores::pin(places[0]);
    cores::sleep_exactly();
    let nanos = thread::scope(|s| {
        let (turn, row) = (&turn, &row);
        let first = thread::current();
        let wait = move |own: usize| loop {
            let value = turn.load(Ordering::Acquire);
            if value == STOP || row[value as usize] == own {
                return value;
            }
            if timed { thread::park_timeout(FAR) } else { thread::park() }
        };
        let (tell, told) = std::sync::mpsc::channel::<Vec<Thread>>();
        let mut tellers = vec![tell];
        let mut all = vec![first];
        for own in 1..threads {
            let (tell, told) = std::sync::mpsc::channel::<Vec<Thread>>();
            tellers.push(tell);
            let handle = s.spawn(move || {
                cores::pin(places[own % 2]);
                cores::sleep_exactly();
                let all = told.recv().expect("all threads");
                loop {
                    let value = wait(own);
                    if value == STOP {
                        return;
                    }
                    pass(turn, value, steps, row, &all);
                }
            });
            all.push(handle.thread().clone());
        }
        tellers.iter().for_each(|tell| tell.send(all.clone()).expect("it listens"));
        let all = told.recv().expect("all threads");
        let mut round_trip = || {
            pass(turn, 0, steps, row, &all);
            wait(0);
        };
        laps(50, 1, &mut round_trip);
        let nanos = laps(effort.of(full), 1, &mut round_trip);
        turn.store(STOP, Ordering::Release);
        all.iter().for_each(Thread::unpark);
        nanos
    });
    cores::unpin();
    Sample::of(nanos, 1)
}

fn pass(turn: &AtomicU32, value: u32, steps: u32, row: &[usize], all: &[Thread]) {
    let next = (value + 1) % steps;
    turn.store(next, Ordering::Release);
    all[row[next as usize]].unpark();
}

/// Sends a datagram of 32 bytes there and back over the loopback. Both threads sleep in the socket with a time_out, or
/// spin.
pub fn udp(effort: Effort, full: u32, other: Core, spins: bool) -> Sample {
    let socket = || {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a socket");
        socket.set_nonblocking(spins).expect("an option");
        if !spins {
            socket.set_read_timeout(Some(Duration::from_millis(200))).expect("an option");
        }
        socket
    };
    let (a, b) = (socket(), socket());
    a.connect(b.local_addr().expect("bound")).expect("an address");
    b.connect(a.local_addr().expect("bound")).expect("an address");
    let receive = |socket: &UdpSocket, buffer: &mut [u8; 64]| loop {
        if let Ok(length) = socket.recv(buffer) {
            return length;
        }
        if spins {
            std::hint::spin_loop();
        }
    };
    cores::pin(Core::First);
    let sample = thread::scope(|s| {
        s.spawn(|| {
            cores::pin(other);
            let mut buffer = [0; 64];
            // A datagram of one byte ends the loop.
            while receive(&b, &mut buffer) > 1 {
                b.send(&buffer[..32]).expect("sent");
            }
        });
        let mut buffer = [0; 64];
        let mut round_trip = || {
            a.send(&[7; 32]).expect("sent");
            receive(&a, &mut buffer);
        };
        laps(50, 1, &mut round_trip);
        let nanos = laps(effort.of(full), 1, &mut round_trip);
        a.send(&[0]).expect("sent");
        Sample::of(nanos, 1)
    });
    cores::unpin();
    sample
}

/// A connection over the loopback, with TCP_NODELAY at both ends.
pub fn connected() -> [TcpStream; 2] {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a socket");
    let a = TcpStream::connect(listener.local_addr().expect("bound")).expect("it listens");
    let (b, _) = listener.accept().expect("a connection");
    [a, b].map(|stream| {
        stream.set_nodelay(true).expect("an option");
        stream
    })
}

/// Sends 32 bytes there and back over a TCP connection on the loopback. Both threads sleep in the socket with a
/// time_out.
pub fn tcp(effort: Effort, full: u32, other: Core) -> Sample {
    let [mut a, mut b] = connected();
    for stream in [&a, &b] {
        stream.set_read_timeout(Some(FAR)).expect("an option");
    }
    cores::pin(Core::First);
    let sample = thread::scope(|s| {
        s.spawn(move || {
            cores::pin(other);
            let mut buffer = [0; 32];
            // The loop ends when the other end closes the connection.
            while b.read_exact(&mut buffer).is_ok() {
                b.write_all(&buffer).expect("sent");
            }
        });
        let mut buffer = [0; 32];
        let mut round_trip = || {
            a.write_all(&[7; 32]).expect("sent");
            a.read_exact(&mut buffer).expect("an answer");
        };
        laps(50, 1, &mut round_trip);
        let nanos = laps(effort.of(full), 1, &mut round_trip);
        drop(a);
        Sample::of(nanos, 1)
    });
    cores::unpin();
    sample
}
