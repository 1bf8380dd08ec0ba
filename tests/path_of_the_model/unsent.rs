//! A run in which commands never leave their node, because the neighbour has not started yet.

use super::recorded::is_path;
use crate::support::live::{Seen, figure};
use crate::support::program::Program;
use crate::support::{imrs, number, own_address, run_in, runtime_dir};

/// A task asks another one until it has three answers.
const ASKS: &str = "\
cell asks;
tick 10 msec;
node na at \"HOST\" port FIRST;  node nb at \"HOST\" port SECOND;
link na -- nb delay 10 msec;
task a on na
  port ask(n: int8) -> int8  usage = query  user_list = {b}  time_out = 300 msec  class = 2  retry = 1  resend = 100 msec;
  var n: int8;  var missed: int16;
begin
  while n < 3 do
    query ask(n) -> n on time_out do missed := missed + 1; end;
    delay 20 msec;
  end;
end a;
task b on nb
  use_port ask(n: int8) -> int8  usage = response;
begin
  on query ask(n) do response(n + 1); end;
  loop delay 1 sec; end;
end b;
";

#[test]
fn a_command_that_never_left_its_node_is_no_lost_command() {
    let dir = runtime_dir();
    let (host, [first, second]) = own_address();
    let text = ASKS.replace("HOST", &host.to_string());
    let text = text.replace("FIRST", &first.to_string()).replace("SECOND", &second.to_string());
    let [cell, record] = ["asks.cell", "run.imrs"].map(|name| dir.path().join(name).display().to_string());
    std::fs::write(&cell, text).expect("the cell is written");
    let made = run_in(dir.path(), &["keygen", &cell]);
    assert_eq!(made.code, Some(0), "{made:?}");
    let start = |node: &str| {
        let args = ["run", &cell, "--node", node, "--for", "10m", "--record", &record, "--format", "json"];
        Program::start(imrs(dir.path(), &args))
    };
    let a = start("na");
    let missed = |sample: &_| figure(sample, "a", "ask", "timed_out") >= 2;
    Seen::by_monitor(dir.path()).until("questions have timed out", missed);
    let mut b = start("nb");
    let _started = b.json();
    let a = a.finish();
    assert_eq!(a.code, Some(0), "{a:?}");
    b.interrupt();
    let b = b.finish();
    assert_eq!(b.code, Some(0), "{b:?}");
    let unsent = number(&a.last_json()["commands"]["timed_out_unsent"]);
    assert!(unsent >= 2, "{a:?}");
    let files = ["na", "nb"].map(|node| dir.path().join(format!("run.{node}.imrs")).display().to_string());
    let how = ["--cell", &cell, "--model", "--format", "json"];
    let told = is_path(&run_in(dir.path(), &[&["replay", &files[0], &files[1]], &how[..]].concat()));
    // The links count no lost packets, because the commands never left their node.
    let breaches = told["breaches"].as_array().expect("breaches");
    let lost =
        breaches.iter().find(|breach| breach["kind"] == "loss").map_or(0, |breach| number(&breach["times"]));
    let resolved = number(&a.last_json()["commands"]["timed_out_unknown"]);
    assert!(lost <= 2 * resolved + 2, "{told}");
}
