//! A run in which a node stops in order while a task of another node waits for its answer.

use super::recorded::is_path;
use crate::support::live::{Seen, figure};
use crate::support::program::Program;
use crate::support::{imrs, number, own_address, run_in, runtime_dir};

/// `b` thinks about each question for longer than this test takes. `a` repeats its question, because `b` may start so late that the
/// first one is lost.
const THINKS: &str = "\
cell thinks;
tick 10 msec;
node na at \"HOST\" port FIRST;  node nb at \"HOST\" port SECOND;
link na -- nb delay 10 msec;
task a on na
  port ask(n: int8) -> int8  usage = query  user_list = {b}  time_out = 90 sec  class = 2
    retry = 100  resend = 500 msec;
  var n: int8;
begin
  query ask(n) -> n on time_out do skip; end;
  loop delay 1 sec; end;
end a;
task b on nb
  use_port ask(n: int8) -> int8  usage = response;
begin
  on query ask(n) do delay 80 sec; response(n + 1); end;
  loop delay 1 sec; end;
end b;
";

#[test]
fn a_run_is_judged_up_to_the_stop_of_a_node_that_owes_an_answer() {
    let dir = runtime_dir();
    let (host, [first, second]) = own_address();
    let text = THINKS.replace("HOST", &host.to_string());
    let text = text.replace("FIRST", &first.to_string()).replace("SECOND", &second.to_string());
    let [cell, record] = ["thinks.cell", "run.imrs"].map(|name| dir.path().join(name).display().to_string());
    std::fs::write(&cell, text).expect("the cell is written");
    let made = run_in(dir.path(), &["keygen", &cell]);
    assert_eq!(made.code, Some(0), "{made:?}");
    let start = |node: &str| {
        let args = ["run", &cell, "--node", node, "--for", "10m", "--record", &record, "--format", "json"];
        Program::start(imrs(dir.path(), &args))
    };
    let [a, b] = ["na", "nb"].map(start);
    let is_asked = |sample: &_| figure(sample, "b", "ask", "delivered") == 1;
    Seen::by_monitor(dir.path()).until("b has the question", is_asked);
    for node in [b, a] {
        node.interrupt();
        let said = node.finish();
        assert_eq!(said.code, Some(0), "{said:?}");
    }
    let files = ["na", "nb"].map(|node| dir.path().join(format!("run.{node}.imrs")).display().to_string());
    let how = ["--cell", &cell, "--model", "--format", "json"];
    let told = is_path(&run_in(dir.path(), &[&["replay", &files[0], &files[1]], &how[..]].concat()));
    // The question left `a`, and came to `b`.
    assert!(number(&told["inputs"]) >= 1 && told["unknown"].is_null(), "{told}");
}
