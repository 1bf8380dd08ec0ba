//! Measures channels of other libraries between threads: crossbeam, flume, kanal, rtrb.

use crate::cases::urgent::{BEHIND, Message, stream_through, urgent_through};
use crate::cores::{self, Core};
use crate::sample::{Sample, laps};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use std::time::Duration;

const LONG: Duration = Duration::from_secs(60);
const ROOM: usize = 1_024;

/// Adds these libraries to a suite.
pub fn join(suite: &mut Suite) {
    match suite.name {
        "threads" => threads(suite),
        "urgent" => urgent(suite),
        "streams" => streams(suite),
        _ => {}
    }
}

fn threads(suite: &mut Suite) {
    for (name, other) in [("one core", Core::First), ("two cores", Core::Second)] {
        suite.case(
            format!("crossbeam/recv_timeout {name}"),
            "there and back through two bounded channels, each wait with a time_out",
            move |effort| {
                ping_pong(effort, other, || {
                    let (tell, told) = crossbeam_channel::bounded::<Message>(ROOM);
                    (move |m| tell.send(m).is_ok(), move || told.recv_timeout(LONG).ok())
                })
            },
        );
        suite.case(format!("flume/recv_timeout {name}"), "the same", move |effort| {
            ping_pong(effort, other, || {
                let (tell, told) = flume::bounded::<Message>(ROOM);
                (move |m| tell.send(m).is_ok(), move || told.recv_timeout(LONG).ok())
            })
        });
        suite.case(format!("kanal/recv_timeout {name}"), "the same", move |effort| {
            ping_pong(effort, other, || {
                let (tell, told) = kanal::bounded::<Message>(ROOM);
                (move |m| tell.send(m).is_ok(), move || told.recv_timeout(LONG).ok())
            })
        });
    }
    let (each, peer) = ("runtime/threads as they are, each trip", "crossbeam/recv_timeout two cores");
    suite.row(Row::new("P2", each, peer, Stat::P50, Goal::AtMost(0.75)));
}

fn ping_pong<S, R>(effort: Effort, other: Core, make: impl Fn() -> (S, R)) -> Sample
where
    S: FnMut(Message) -> bool + Send,
    R: FnMut() -> Option<Message> + Send,
{
    let ((mut ask, mut asked), (mut answer, mut answered)) = (make(), make());
    cores::pin(Core::First);
    let nanos = std::thread::scope(|s| {
        s.spawn(move || {
            cores::pin(other);
            while let Some(message) = asked() {
                answer(message);
            }
        });
        let mut round_trip = || {
            assert!(ask([7; 4]), "it listens");
            answered().expect("an answer");
        };
        laps(50, 1, &mut round_trip);
        // Each round trip is timed by itself, as for the runtime, because the slowest round trips are compared, too.
        let nanos = laps(effort.of(1_500), 1, &mut round_trip);
        drop(ask);
        nanos
    });
    cores::unpin();
    Sample::of(nanos, 1)
}

fn urgent(suite: &mut Suite) {
    let room = usize::from(BEHIND) + 1;
    let about = "the same through one bounded channel of it: the urgent one comes last";
    suite.case("crossbeam/FIFO behind 1024", about, move |effort| {
        urgent_through(effort, || {
            let (tell, told) = crossbeam_channel::bounded(room);
            (move |is| tell.send(is).expect("it listens"), move || told.recv().ok())
        })
    });
    suite.case("flume/FIFO behind 1024", about, move |effort| {
        urgent_through(effort, || {
            let (tell, told) = flume::bounded(room);
            (move |is| tell.send(is).expect("it listens"), move || told.recv().ok())
        })
    });
    suite.case("kanal/FIFO behind 1024", about, move |effort| {
        urgent_through(effort, || {
            let (tell, told) = kanal::bounded(room);
            (move |is| tell.send(is).expect("it listens"), move || told.recv().ok())
        })
    });
    suite.case(
        "crossbeam/two channels behind 1024",
        "two bounded channels under select_biased!, the urgent one first",
        move |effort| {
            urgent_through(effort, || {
                let (urgent, first) = crossbeam_channel::bounded::<bool>(room);
                let (other, second) = crossbeam_channel::bounded::<bool>(room);
                let send = move |is: bool| if is { &urgent } else { &other }.send(is).expect("it listens");
                let receive = move || {
                    crossbeam_channel::select_biased! {
                        recv(first) -> is => is.ok(),
                        recv(second) -> is => is.ok(),
                    }
                };
                (send, receive)
            })
        },
    );
    let own = "runtime/urgent behind 1024";
    for peer in ["crossbeam", "flume", "kanal"] {
        let peer = format!("{peer}/FIFO behind 1024");
        suite.row(Row::new("P7", own, &peer, Stat::P50, Goal::AtLeast(1_000.0)));
    }
    let select = "crossbeam/two channels behind 1024";
    suite.row(Row::new("P7", own, select, Stat::P50, Goal::AtMost(4.0)).was("<= 1.2"));
}

fn streams(suite: &mut Suite) {
    for senders in [1, 4] {
        let about = "through a bounded channel of 1,024: no order";
        suite.case(format!("crossbeam/FIFO {senders}->1"), about, move |effort| {
            stream_through(effort, senders, || {
                let (tell, told) = crossbeam_channel::bounded::<Message>(ROOM);
                (move |m| tell.send(m).expect("it listens"), move || told.recv().expect("a message"))
            })
        });
        suite.case(format!("flume/FIFO {senders}->1"), about, move |effort| {
            stream_through(effort, senders, || {
                let (tell, told) = flume::bounded::<Message>(ROOM);
                (move |m| tell.send(m).expect("it listens"), move || told.recv().expect("a message"))
            })
        });
        suite.case(format!("kanal/FIFO {senders}->1"), about, move |effort| {
            stream_through(effort, senders, || {
                let (tell, told) = kanal::bounded::<Message>(ROOM);
                (move |m| tell.send(m).expect("it listens"), move || told.recv().expect("a message"))
            })
        });
        let (own, peer) = (format!("runtime/stream {senders}->1"), format!("crossbeam/FIFO {senders}->1"));
        let (times, was) = if senders == 1 { (0.6, ">= 0.4") } else { (0.5, ">= 0.9") };
        suite.row(Row::new("P6", own, &peer, Stat::Mean, Goal::AtLeast(times)).was(was));
    }
    suite.case("rtrb/FIFO 1->1", "a ring of 1,024 for one sender and one receiver, both spinning", ring);
    let (own, ring) = ("runtime/stream 1->1", "rtrb/FIFO 1->1");
    suite.row(Row::new("P6", own, ring, Stat::Mean, Goal::AtLeast(0.15)).was(">= 0.4"));
}

fn ring(effort: Effort) -> Sample {
    let (mut tell, mut told) = rtrb::RingBuffer::<Message>::new(ROOM);
    let times = effort.of(60_000);
    cores::pin(Core::First);
    let begins = std::time::Instant::now();
    std::thread::scope(|s| {
        s.spawn(move || {
            cores::pin(Core::Second);
            for n in 0..u64::from(times) {
                while tell.push([n; 4]).is_err() {
                    std::hint::spin_loop();
                }
            }
        });
        let mut taken = 0;
        while taken < times {
            match told.pop() {
                Ok(message) => {
                    std::hint::black_box(message);
                    taken += 1;
                }
                Err(rtrb::PopError::Empty) => std::hint::spin_loop(),
            }
        }
    });
    cores::unpin();
    Sample::of_all(begins.elapsed(), u64::from(times))
}
