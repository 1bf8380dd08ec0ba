//! A soak test (D114): three nodes over loopback UDP use every primitive at half of their full rate. Every class-2 request
//! must get its outcome, and memory, descriptors and threads must not grow. `IMRS_SOAK` sets the number of seconds.

mod process;
mod rig;

use crate::alone;
use crate::common::until;
use imrs_protocol::Reason;
use imrs_runtime::link::udp::UdpCount;
use imrs_runtime::record::{RecordingReader, Verdict, replay_recording};
use process::{Held, threads, trend, worked};
use rig::{Asked, Plan, Ran, THREADS, Tally, run};
use std::time::{Duration, Instant};

/// How many KiB more memory the process may hold at the end than at the beginning, however long the run takes. The
/// allocator's caches may grow by that much.
const FLAT: f64 = 512.0;
/// The least number of measurements of memory, descriptors and threads, however busy the machine is.
const LOOKS: usize = 8;
/// How long after its time_out an outcome may come, on a machine that also does other work.
const LATE: Duration = Duration::from_secs(60);

fn wanted() -> Duration {
    let seconds = std::env::var("IMRS_SOAK").ok().map_or(5, |number| number.parse().expect("seconds"));
    Duration::from_secs(seconds)
}

#[test]
fn at_half_load_every_request_has_its_outcome_and_nothing_grows() {
    let _alone = alone();
    let pause = || {
        std::thread::sleep(Duration::from_millis(20));
        true
    };
    let (flat_out, flat_busy) =
        busy(|| run(Plan { length: Duration::from_secs(2), ..Plan::default() }, pause));
    let flat_rate = judge(&flat_out);
    let pace = Duration::from_secs_f64(3.0 * 2.0 / flat_rate);
    let period = Some(pace);
    println!("flat out: {flat_rate:.0} cycles/s, {flat_busy:.2} cores busy");
    println!("at half load each driver begins a cycle every {pace:.3?}");

    let (begin, length) = (Instant::now(), wanted());
    let every = (length / 400).max(Duration::from_millis(50));
    // The vector is filled and cleared, so that all its memory is in RAM before the first measurement.
    let mut series = vec![Held::default(); 1_000];
    series.clear();
    let others = threads();
    let look = || {
        std::thread::sleep(every);
        // The drivers begin their last meeting only after this loop, because the cost of that meeting belongs to the end.
        let is_enough = begin.elapsed() > length && series.len() >= LOOKS;
        // The first tenth of the run warms up, and is not measured.
        if !is_enough && begin.elapsed() > length / 10 && series.len() < series.capacity() {
            if series.is_empty() {
                // A thread has its name only once it runs, so this waits until all threads are counted.
                until(|| Held::now(begin, &others).threads == THREADS);
            }
            series.push(Held::now(begin, &others));
        }
        is_enough
    };
    let (soaked, half_busy) = busy(|| run(Plan { length, period, recorded: false }, look));
    let rate = judge(&soaked);
    println!("half load: {rate:.0} cycles/s, {:.2} of flat out, {half_busy:.2} cores busy", rate / flat_rate);
    tell(&soaked);
    nothing_grows(&series);

    let second = Duration::from_secs(1);
    replays(&run(Plan { length: second, period, recorded: true }, pause));
}

/// The result of `work`, and how many cores it kept busy.
fn busy<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let (begin, used) = (Instant::now(), worked());
    let done = work();
    (done, (worked() - used).as_secs_f64() / begin.elapsed().as_secs_f64())
}

/// Checks the properties that must hold in every run. Returns how many cycles per second all drivers made together.
fn judge(ran: &Ran) -> f64 {
    assert_eq!(ran.tallies.len(), 3);
    let mut copies = 0;
    for tally in &ran.tallies {
        copies += tally.copies;
        assert!(tally.released > 0, "{tally:?}");
        for (port, asked) in &tally.asked {
            let name = &ran.table.cell().ports[port.index()].name;
            let Asked { replies, refused, unsent, unknown, restarted, .. } = *asked;
            assert_eq!(asked.outcomes, asked.expected, "`{name}`: {asked:?}");
            assert_eq!(
                replies + refused + unsent + unknown + restarted,
                asked.outcomes,
                "`{name}`: {asked:?}"
            );
            assert_eq!(restarted, 0, "`{name}`: {asked:?}");
            assert!(asked.latest < LATE, "`{name}`: {asked:?}");
            assert_eq!(replies == 0, name == "unheard", "`{name}`: {asked:?}");
        }
    }
    counters_agree(ran);
    let never = [
        Reason::NotAllowed,
        Reason::Unroutable,
        Reason::HopLimit,
        Reason::StaleIncarnation,
        Reason::Incomplete,
        Reason::StaleEpoch,
    ];
    for reason in never {
        assert_eq!(discarded(ran, reason), 0, "{}", reason.name());
    }
    assert!(discarded(ran, Reason::Expired) > 0, "what nobody reads expires");
    assert!(copies > 0);
    let took = ran.tallies.iter().map(|tally| tally.took).max().unwrap_or_default();
    let cycles: u64 = ran.tallies.iter().map(|tally| tally.cycles).sum();
    cycles as f64 / took.as_secs_f64()
}

fn discarded(ran: &Ran, reason: Reason) -> u64 {
    let all = ran.snapshots.iter().flat_map(|snapshot| &snapshot.discards);
    all.filter(|count| count.name == reason.name()).map(|count| count.count).sum()
}

/// Checks that the counters of the machines and the links agree with the programs' own counts.
fn counters_agree(ran: &Ran) {
    let tasks = || ran.snapshots.iter().flat_map(|snapshot| &snapshot.tasks);
    for (port, asked) in ran.tallies.iter().flat_map(|tally| &tally.asked) {
        let decl = &ran.table.cell().ports[port.index()];
        let owner = tasks().find(|task| task.view.task == decl.owner).expect("a task");
        let counters = owner.view.ports.iter().find(|view| view.port == *port).expect("its port").counters;
        assert_eq!(counters.sent, asked.expected, "`{}`: {asked:?}, {counters:?}", decl.name);
        assert_eq!(
            counters.timed_out,
            asked.unknown + asked.unsent,
            "`{}`: {asked:?}, {counters:?}",
            decl.name
        );
    }
    for failure in UdpCount::FAILURES.into_iter().filter(|count| *count != UdpCount::KernelDropped) {
        assert_eq!(ran.udp(failure), 0, "{}", failure.name());
    }
    let (sent, received) = (ran.udp(UdpCount::DatagramsSent), ran.udp(UdpCount::DatagramsReceived));
    assert!(received + ran.udp(UdpCount::KernelDropped) <= sent, "{received} of {sent} datagrams");
}

fn tell(ran: &Ran) {
    let sum = |of: &dyn Fn(&Tally) -> u64| ran.tallies.iter().map(of).sum::<u64>();
    println!(
        "  {} cycles, {} copies of news, {} releases, {} given up, {} meetings diverged",
        sum(&|tally| tally.cycles),
        sum(&|tally| tally.copies),
        sum(&|tally| tally.released),
        sum(&|tally| tally.gave_up),
        ran.diverged
    );
    for (port, asked) in ran.tallies.iter().flat_map(|tally| &tally.asked) {
        let Asked { requests, replies, refused, unsent, unknown, latest, .. } = asked;
        println!(
            "  `{}`: {requests} requests: {replies} replies, {refused} refused, {unsent} unsent, {unknown} unknown; the \
             latest outcome {latest:.1?} after its time_out",
            ran.table.cell().ports[port.index()].name
        );
    }
    let reasons = Reason::ALL.map(|reason| (reason.name(), discarded(ran, reason)));
    let dropped: Vec<String> = reasons
        .iter()
        .filter(|(_, count)| *count > 0)
        .map(|(name, count)| format!("{count} {name}"))
        .collect();
    println!("  dropped: {}", dropped.join(", "));
    let counts = [
        UdpCount::PacketsSent,
        UdpCount::DatagramsSent,
        UdpCount::DatagramsReceived,
        UdpCount::KernelDropped,
    ];
    let counts = counts.map(|count| format!("{} {}", ran.udp(count), count.name()));
    println!("  {}", counts.join(", "));
}

fn nothing_grows(series: &[Held]) {
    let (Some(first), Some(last)) = (series.first(), series.last()) else { panic!("nothing was measured") };
    let (begin, end, slope) = trend(series);
    println!(
        "  held: {begin:.0} KiB at the beginning, {end:.0} KiB at the end ({slope:+.0} KiB/h over {:.0} s), {} descriptors, {} threads",
        last.at - first.at,
        last.descriptors,
        last.threads
    );
    for held in series {
        assert_eq!((held.descriptors, held.threads), (first.descriptors, first.threads), "{held:?}");
    }
    assert!(end - begin <= FLAT, "{begin:.0} KiB became {end:.0} KiB");
}

fn replays(ran: &Ran) {
    judge(ran);
    assert_eq!(ran.recordings.len(), 3);
    for (here, bytes) in &ran.recordings {
        let mut reader = RecordingReader::new(&bytes[..]).expect("a recording");
        let replays = replay_recording(&mut reader, here).expect("whole");
        assert!(!replays.is_empty());
        for replay in replays {
            assert!(replay.judged() > 100, "{} steps", replay.judged());
            assert_eq!(replay.verdict(), Verdict::Same, "{}", replay.task());
        }
    }
}
