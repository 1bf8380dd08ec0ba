//! Tests of `imrs check --load`: the estimated traffic, compared with the traffic of a run.

use crate::support::{finish, imrs, number, run, runtime_dir};

/// Two tasks that send as often as their ports declare, and one whose port has only a time_out.
const LOADED: &str = "\
cell loaded;
tick 10 msec;
node na; node nb;
link na -- nb delay 10 msec capacity = 200/1 sec;
task eye on na
  port pose(x: int16) usage = send user_list = {hand} time_out = 100 msec class = 1 rate = 25/1 sec;
begin
  loop send pose(1); delay 40 msec; end;
end eye;
task mind on na
  port plan(n: int16) usage = send user_list = {hand} time_out = 500 msec class = 2;
begin
  loop send plan(1) on time_out do skip; end on refused do skip; end; delay 480 msec; end;
end mind;
task hand on nb
  use_port pose(x: int16) usage = receive;
  use_port plan(n: int16) usage = receive;
  var x, n: int16;
begin
  on receive plan(n) do reply(); end;
  loop receive pose(x); end;
end hand;
";

#[test]
fn the_estimated_load_is_what_a_run_puts_on_the_link() {
    let dir = runtime_dir();
    let cell = dir.path().join("loaded.cell");
    std::fs::write(&cell, LOADED).expect("the cell is written");
    let cell = cell.to_str().expect("UTF-8");
    let checked = run(&["check", "--load", cell, "--format", "json"]).last_json();
    let link = &checked["load"]["links"][0];
    // An answer counts as a packet, although it has no contents.
    assert_eq!((link["declared"].as_f64(), link["estimated"].as_f64()), (Some(25.0), Some(4.0)), "{checked}");
    assert_eq!(link["capacity"].as_f64(), Some(200.0), "{checked}");
    let table = run(&["check", "--load", cell]);
    assert!(table.out.contains("na -- nb") && table.out.contains("14.5 %"), "{}", table.out);

    let ran = finish(imrs(dir.path(), &["run", cell, "--for", "6s", "--format", "json"])).last_json();
    let left: u64 =
        ran["nodes"].as_array().expect("nodes").iter().map(|node| number(&node["forwarded"])).sum();
    let seconds = ran["seconds"].as_f64().expect("seconds");
    let measured = left as f64 / seconds;
    // On a busy machine the tasks send less often, and send copies.
    assert!((0.3..1.5).contains(&(measured / 29.0)), "{measured} packets a second: {ran}");
}
