//! Measures tasks and actors of other libraries on one thread: tokio, kameo, ractor, actix.

use super::posts::{Actix, Kameo, Note, Post, Ractor, Tokio, Took};
use crate::cases::floors::GROUP;
use crate::cases::urgent::BEHIND;
use crate::cores::{self, Core};
use crate::sample::{Sample, each, nanos_of};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use std::time::{Duration, Instant};
use tokio::task::{LocalSet, spawn_local};

/// Adds these libraries to a suite.
pub fn join(suite: &mut Suite) {
    match suite.name {
        "awake" => awake(suite),
        "urgent" => urgent(suite),
        "streams" => streams(suite),
        "timers" => timers(suite),
        "meetings" => meetings(suite),
        _ => {}
    }
}

fn block_on<T>(work: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    LocalSet::new().block_on(&runtime, work)
}

/// Starts the receiver of the library with this name, runs `work` with it, and ends it.
fn with<W: Work>(peer: &str, work: W) -> Sample {
    cores::pin(Core::First);
    let sample = match peer {
        "tokio mpsc+oneshot" => block_on(async { work.run(Tokio::start()).await }),
        "kameo" => block_on(async { work.run(Kameo::start()).await }),
        "ractor" => block_on(async {
            let actor = Ractor::start().await;
            let sample = work.run(actor.clone()).await;
            actor.stop();
            sample
        }),
        _ => actix::System::new().block_on(async { work.run(Actix::start()).await }),
    };
    cores::unpin();
    sample
}

const PEERS: [&str; 4] = ["tokio mpsc+oneshot", "kameo", "ractor", "actix"];

/// A measurement that works with the receiver of every library.
trait Work {
    async fn run<P: Post>(self, post: P) -> Sample;
}

struct Asks(u32);

impl Work for Asks {
    async fn run<P: Post>(self, post: P) -> Sample {
        for _ in 0..100 {
            post.ask().await;
        }
        let mut nanos = Vec::new();
        for _ in 0..self.0 / GROUP {
            let begins = Instant::now();
            for _ in 0..GROUP {
                post.ask().await;
            }
            nanos.push(nanos_of(begins.elapsed()));
        }
        Sample::of(nanos, GROUP)
    }
}

fn awake(suite: &mut Suite) {
    let about = "ask and answer between two coroutines of one thread: no deadline, no order";
    for peer in PEERS {
        suite.case(format!("{peer}/ask"), about, move |effort| with(peer, Asks(effort.of(60_000))));
    }
    suite.case(
        "kameo/ask from a thread",
        "blocking_send from a plain thread, the actor on a runtime of another one, two cores",
        kameo_from_a_thread,
    );
    for (own, bound) in [("runtime/scripts ask", 0.5), ("runtime/futures ask", 0.6)] {
        let tokio = "tokio mpsc+oneshot/ask";
        suite.row(Row::new("P1", own, tokio, Stat::P50, Goal::AtMost(bound)).was("<= 0.75"));
        for peer in ["ractor/ask", "kameo/ask", "actix/ask"] {
            suite.row(Row::new("P1", own, peer, Stat::P50, Goal::AtLeast(2.5)));
        }
    }
    let thread = "runtime/thread asks script";
    suite.row(Row::new("P4", thread, "kameo/ask from a thread", Stat::P50, Goal::AtMost(0.8)));
}

fn kameo_from_a_thread(effort: Effort) -> Sample {
    let (tell, told) = std::sync::mpsc::channel();
    let (end, ended) = tokio::sync::oneshot::channel::<()>();
    let sample = std::thread::scope(|s| {
        s.spawn(move || {
            cores::pin(Core::Second);
            block_on(async {
                tell.send(Kameo::start().0).expect("it listens");
                let _ = ended.await;
            });
        });
        let actor = told.recv().expect("it starts");
        cores::pin(Core::First);
        let sample = each(effort.of(1_500), 1, || {
            actor.ask(Took).blocking_send().expect("an answer");
        });
        drop(end);
        sample
    });
    cores::unpin();
    sample
}

struct Behind(u32);

impl Work for Behind {
    async fn run<P: Post>(self, post: P) -> Sample {
        let mut nanos = Vec::new();
        for _ in 0..self.0 {
            // All messages must wait before any is served. Otherwise the library would run the receiver in between.
            let fill = async {
                for _ in 0..BEHIND {
                    post.tell(Note::Work).await;
                }
                post.tell(Note::Urgent(Instant::now())).await;
            };
            tokio::task::unconstrained(fill).await;
            nanos.push(post.ask().await);
        }
        Sample::of(nanos, 1)
    }
}

fn urgent(suite: &mut Suite) {
    for peer in PEERS {
        let name = format!("{peer}/FIFO behind 1024");
        suite.row(Row::new("P7", "runtime/urgent behind 1024", &name, Stat::P50, Goal::AtLeast(1_000.0)));
        suite.case(name, "the same through its mailbox: the urgent one comes last", move |effort| {
            with(peer, Behind(crate::cases::urgent::times(effort)))
        });
    }
}

struct Stream(u32, u32);

impl Work for Stream {
    async fn run<P: Post>(self, post: P) -> Sample {
        let Self(senders, times) = self;
        let each = times / senders;
        let begins = Instant::now();
        let send = |post: P| async move {
            for n in 0..u64::from(each) {
                post.tell(Note::Plain([n; 4])).await;
            }
        };
        let senders: Vec<_> = (0..senders).map(|_| spawn_local(send(post.clone()))).collect();
        let count = senders.len() as u64;
        for sender in senders {
            sender.await.expect("no panic");
        }
        // The receiver answers this question when it has served all earlier messages.
        post.ask().await;
        Sample::of_all(begins.elapsed(), u64::from(each) * count)
    }
}

fn streams(suite: &mut Suite) {
    for senders in [1, 4] {
        for peer in PEERS {
            let name = format!("{peer}/tell {senders}->1");
            if senders == 4 {
                let (least, was) = match peer {
                    "kameo" | "ractor" => (2.0, ">= 4"),
                    "actix" => (0.9, ">= 2"),
                    _ => (0.7, ">= 2"),
                };
                let own = "runtime/stream 4->1";
                suite.row(Row::new("P6", own, &name, Stat::Mean, Goal::AtLeast(least)).was(was));
            }
            suite.case(name, "told by coroutines of the same thread: nobody is woken", move |effort| {
                with(peer, Stream(senders, effort.of(60_000)))
            });
        }
    }
}

fn timers(suite: &mut Suite) {
    suite.case(
        "tokio/sleep",
        "make a tokio::time::sleep, poll it once and drop it, 1,000 others waiting",
        sleeps_of_tokio,
    );
    suite.case("tokio/DelayQueue", "insert and remove in a DelayQueue of 1,000 others", delay_queue);
    suite.case("tokio/sleep lateness", "lateness of tokio::time::sleep", |effort| {
        let times = effort.of(150);
        block_on(async move {
            let mut nanos = Vec::new();
            for n in 0..times {
                let length = Duration::from_micros(1_000 + u64::from(n) * 7_919 % 1_000);
                let begins = Instant::now();
                tokio::time::sleep(length).await;
                nanos.push(nanos_of(begins.elapsed().saturating_sub(length)));
            }
            Sample::of(nanos, 1)
        })
    });
    let own = "machine/timer 1k";
    suite.row(Row::new("P13", own, "tokio/sleep", Stat::P50, Goal::AtLeast(15.0)));
    suite.row(Row::new("P13", own, "tokio/DelayQueue", Stat::P50, Goal::AtLeast(4.0)));
    for own in ["runtime/delay", "runtime/time_out"] {
        suite.row(Row::new("P14", own, "tokio/sleep lateness", Stat::P50, Goal::AtMost(0.06)));
    }
}

fn sleeps_of_tokio(effort: Effort) -> Sample {
    use std::task::{Context, Waker};
    let times = effort.of(100_000);
    block_on(async move {
        let mut context = Context::from_waker(Waker::noop());
        let sleep = |n: u64| Box::pin(tokio::time::sleep(Duration::from_millis(1_000 + n % 1_000)));
        let mut others: Vec<_> = (0..1_000).map(sleep).collect();
        for other in &mut others {
            assert!(other.as_mut().poll(&mut context).is_pending());
        }
        let mut n = 0;
        each(times, GROUP, || {
            n += 1;
            let sleep = tokio::time::sleep(Duration::from_millis(1_000 + n % 1_000));
            let mut sleep = std::pin::pin!(sleep);
            assert!(sleep.as_mut().poll(&mut context).is_pending());
        })
    })
}

fn delay_queue(effort: Effort) -> Sample {
    let times = effort.of(100_000);
    block_on(async move {
        let mut queue = tokio_util::time::DelayQueue::new();
        let length = |n: u64| Duration::from_millis(1_000 + n * 7_919 % 1_000);
        for n in 0..1_000 {
            queue.insert(n, length(n));
        }
        let mut n = 1_000;
        each(times, GROUP, || {
            n += 1;
            let key = queue.insert(n, length(n));
            queue.remove(&key);
        })
    })
}

fn meetings(suite: &mut Suite) {
    for n in [2, 4, 8, 16_usize] {
        let name = format!("tokio/Barrier of {n}");
        suite.case(
            name.clone(),
            "coroutines of one thread meet again and again: no deadline",
            move |effort| {
                cores::pin(Core::First);
                let sample = block_on(barrier(effort.of(1_000), n));
                cores::unpin();
                sample
            },
        );
        let own = format!("runtime/scripts meet of {n}");
        suite.row(Row::new("P10", own, &name, Stat::P50, Goal::AtMost(3.0)));
    }
}

async fn barrier(times: u32, n: usize) -> Sample {
    let barrier = std::rc::Rc::new(tokio::sync::Barrier::new(n));
    let begins = Instant::now();
    let all: Vec<_> = (0..n)
        .map(|_| {
            let barrier = std::rc::Rc::clone(&barrier);
            spawn_local(async move {
                for _ in 0..times {
                    barrier.wait().await;
                }
            })
        })
        .collect();
    for one in all {
        one.await.expect("no panic");
    }
    Sample::of_all(begins.elapsed(), u64::from(times))
}

#[cfg(test)]
mod tests {
    use super::PEERS;
    use crate::cases::handoff;

    #[test]
    fn scripts_and_futures_are_compared_with_every_library_on_one_thread() {
        let mut suite = handoff::awake();
        super::join(&mut suite);
        for own in ["runtime/scripts ask", "runtime/futures ask"] {
            for peer in PEERS.map(|peer| format!("{peer}/ask")) {
                let rows = suite.rows.iter().filter(|row| row.subject == own && row.other() == Some(&peer));
                assert_eq!(rows.count(), 1, "{own} : {peer}");
            }
        }
    }
}
