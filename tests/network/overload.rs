//! Tests a link to which ten times as many statuses are sent as it can carry, beside commands. The commands go on, and
//! only statuses are lost.

use super::bounds::shown;
use super::cells::placed;
use super::hosts::{are_possible, command};
use super::net::{How, Net};
use crate::support::live::named;
use crate::support::{bound, excused, number, wait_until};
use serde_json::Value;
use std::thread;
use std::time::{Duration, Instant};

/// The host whose link has a small capacity.
const SENDER: usize = 0;
/// The capacity of the link, in bytes a second.
const CAPACITY: f64 = 32_000.0;
/// The least number of bytes of one picture on the link: 16 packets of 32 bytes.
const PICTURE: f64 = 512.0;
/// The most by which the memory of a node may grow after its first seconds, in kB. The kernel counts whole pages.
const GROWTH: u64 = 1_024;

/// How many tasks give commands.
const BOSSES: u8 = 8;

/// A cell of tasks that give commands, and of three cameras, each of which sends one picture in each period `PACE`.
const CELL: &str = "\
cell flood;
tick 1 msec;
node na at \"HOST1\" port PORT;  node nb at \"HOST2\" port PORT;
link na -- nb delay 10 msec;
type Picture is record FIELDS: int32; end;
CAMERAS\
BOSSES\
task worker on nb
  port work(n: int32) -> int32  usage = response  user_list = {BOSS}  time_out = 3 sec  class = 2  retry = 2  resend = 1 sec
    bounded_buffer[8];
begin
  on query work(n) do response(n); end;
  loop delay 1 sec; end;
end worker;
task screen on nb
SCREEN\
  var all: int32;
begin
TAKEN\
  loop delay 1 sec; end;
end screen;
";

/// The cell in which each camera sends one picture in each period `pace`.
fn cell(pace: &str) -> String {
    let fields: Vec<String> = (1..=48).map(|number| format!("f{number}")).collect();
    let of = |text: fn(u8) -> String| (1..=3).map(text).collect::<String>();
    let cameras = of(|n| {
        format!(
            "task camera{n} on na\n  port seen{n}(p: Picture)  usage = send  message_format = Picture  user_list = {{screen}}  \
             time_out = 4 sec  class = 1  bounded_buffer[4];\n  var p: Picture;\nbegin\n  loop send seen{n}(p); delay PACE; end;\nend camera{n};\n"
        )
    });
    let bosses = (1..=BOSSES).map(|n| {
        format!(
            "task boss{n} on na\n  use_port work(n: int32) -> int32  usage = query;\n  var n, got: int32;\nbegin\n  loop\n    n := n + 1;\n    \
             query work(n) -> got on time_out do got := 0; end on refused do got := 0; end;\n    delay 20 msec;\n  end;\nend boss{n};\n"
        )
    });
    let names: Vec<String> = (1..=BOSSES).map(|n| format!("boss{n}")).collect();
    let text = CELL.replace("BOSSES", &bosses.collect::<String>()).replace("BOSS", &names.join(", "));
    let text = text.replace("FIELDS", &fields.join(", ")).replace("CAMERAS", &cameras).replace("PACE", pace);
    let text = text.replace("SCREEN", &of(|n| format!("  use_port seen{n}(p: Picture)  usage = receive;\n")));
    placed(&text.replace("TAKEN", &of(|n| format!("  on receive seen{n}(p) do all := all + p.f1; end;\n"))))
}

/// The result of a run.
#[derive(Debug)]
struct Load {
    seconds: f64,
    /// The number of commands that ended. The next field is the number of those that were answered.
    commands: u64,
    answered: u64,
    pictures: u64,
    shown: u64,
    /// By how much the memory of the sending node grew in the last two thirds of the run, in kB.
    growth: u64,
    /// What the sending node dropped, by reason.
    dropped: Value,
}

impl Load {
    /// The sent bytes divided by the bytes that the link can carry.
    fn overload(&self) -> f64 {
        self.pictures as f64 * PICTURE / self.seconds / CAPACITY
    }
}

/// The memory of a process, in kB.
fn memory(pid: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).expect("a process");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("its memory");
    line.trim().trim_end_matches(" kB").parse().expect("kilobytes")
}

/// Runs the cell for the time `length`, over a link that carries [`CAPACITY`].
fn run(pace: &str, length: Duration) -> Load {
    let mut net = Net::new(&cell(pace), &["na", "nb"], 1);
    net.hosts.on(SENDER, || {
        let queue = ["limit", "200000", "burst", "1600"];
        command(
            "tc",
            &[&["qdisc", "add", "dev", "eth0", "root", "tbf", "rate", "256kbit"][..], &queue].concat(),
        );
    });
    let how = How { is_unrecorded: true, ..How::default() };
    net.start(1, &how);
    net.start(SENDER, &how);
    let begun = Instant::now();
    thread::sleep(length / 3);
    let before = memory(net.pid(SENDER));
    wait_until("the time is over", || begun.elapsed() >= length);
    let after = memory(net.pid(SENDER));
    let [sent, received] = [SENDER, 1].map(|host| net.stop(host)).map(|said| {
        assert!(said.is_well(), "{said:?}");
        said.last_json()
    });
    let pictures = |summary: &Value, what: &str| -> u64 {
        (1..=3).map(|n| number(&named(&summary["ports"], &format!("seen{n}"))[what])).sum()
    };
    let outcomes = sent["commands"].as_object().expect("outcomes");
    Load {
        seconds: sent["seconds"].as_f64().expect("a time"),
        commands: outcomes.values().map(number).sum(),
        answered: number(&outcomes["replies"]),
        pictures: pictures(&sent, "sent"),
        shown: pictures(&received, "delivered"),
        growth: after.saturating_sub(before),
        dropped: sent["nodes"][0]["discards"].clone(),
    }
}

#[test]
fn commands_go_on_beside_ten_times_too_many_statuses() {
    if !are_possible() {
        return;
    }
    // `.ci/long` runs this for a minute.
    let length = Duration::from_secs(bound("IMRS_OVERLOAD", 10));
    let (normal, flooded) = thread::scope(|scope| {
        let normal = scope.spawn(|| run("100 msec", length));
        let flooded = run("3 msec", length);
        (normal.join().expect("a run"), flooded)
    });
    for load in [&normal, &flooded] {
        println!(
            "total: {:.1} times what the link carries, for {:.0} s: {} of {} commands answered (unanswered {}), {} of {} pictures shown, memory + {} kB; dropped {}",
            load.overload(),
            load.seconds,
            load.answered,
            load.commands,
            shown(load.commands - load.answered, load.commands),
            load.shown,
            load.pictures,
            load.growth,
            load.dropped,
        );
    }
    if flooded.overload() < 10.0 {
        excused(&format!("the cameras sent only {:.1} times what the link carries", flooded.overload()));
    }
    let share = |load: &Load| load.answered as f64 / load.commands as f64;
    assert!(normal.answered > 0 && flooded.answered > 0);
    assert!(share(&flooded) >= 0.999 * share(&normal), "{normal:#?} {flooded:#?}");
    // The statuses bear the loss.
    assert!(flooded.shown < flooded.pictures / 2, "{flooded:#?}");
    assert!(normal.shown as f64 > 0.9 * normal.pictures as f64, "{normal:#?}");
    assert!(flooded.growth <= GROWTH, "{flooded:#?}");
}
