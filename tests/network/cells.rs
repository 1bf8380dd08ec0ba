//! The cells that run on the hosts. They are slow, so that a busy machine by itself causes few time_outs.

use super::hosts::Hosts;
use std::net::Ipv4Addr;

/// The UDP port of each node.
pub const PORT: u16 = 7_000;

/// A cell of three tasks that meet, and exchange queries and statuses. `b` counts the questions that come twice in a
/// row, and `a` counts wrong answers. Each start of `a` asks other questions, so that an answer to an earlier start
/// counts as wrong.
const TALK: &str = "\
cell hosts;
tick 10 msec;
node na at \"HOST1\" port PORT;  node nb at \"HOST2\" port PORT;  node nc at \"HOST3\" port PORT;
link na -- nb delay 10 msec;  link nb -- nc delay 10 msec;  link na -- nc delay 10 msec;
task a on na
  port ask(n: int32) -> int32  usage = query  user_list = {b}  time_out = 600 msec  class = 2  retry = 5  resend = 80 msec;
  port news(n: int32)  usage = send  user_list = {c}  time_out = 300 msec  class = 1  bounded_buffer[8];
  port meet()  usage = waitfor  user_list = {b, c}  time_out = 1 sec  class = 2  retry = 5  resend = 50 msec;
  var n, got, wrong: int32;
begin
  run draw -> n in 1..1000000 takes 1 msec;
  loop
    n := n + 1;
    query ask(n) -> got on time_out do got := n + 1; end on refused do got := n + 1; end;
    if got <> n + 1 then wrong := wrong + 1; end;
    send news(n);
    waitfor meet() on time_out do skip; end;
    delay 20 msec;
  end;
end a;
task b on nb
  use_port ask(n: int32) -> int32  usage = response;
  use_port meet()  usage = waitfor;
  var did, again: int32;
begin
  order ask > self;
  on query ask(n) do
    if n = did then again := again + 1; end;
    did := n;
    response(n + 1);
  end;
  loop
    waitfor meet() on time_out do skip; end;
    delay 20 msec;
  end;
end b;
task c on nc
  use_port news(n: int32)  usage = receive;
  use_port meet()  usage = waitfor;
  var last, older: int32;
begin
  order news > self;
  on receive news(n) do
    if n <= last then older := older + 1; end;
    last := n;
  end;
  loop
    waitfor meet() on time_out do skip; end;
    delay 20 msec;
  end;
end c;
faults loss 30 dup 10;
faults cut na -- nb;
faults crash nb;
check once: never b.again > 0;
check right: never a.wrong > 0;
";

/// The cell of three tasks, at the addresses of the hosts.
pub fn talk() -> String {
    placed(TALK)
}

/// Writes the addresses of the hosts into a cell.
pub fn placed(text: &str) -> String {
    at(text, |host| (Hosts::address(host), PORT))
}

/// The cell of three tasks, with all nodes on the loopback, each at a port of its own.
#[cfg(feature = "zenoh")]
pub fn talk_on_loopback() -> String {
    at(TALK, |host| (Ipv4Addr::LOCALHOST, PORT + u16::try_from(host).expect("a few hosts")))
}

/// Writes the address of each node into a cell.
fn at(text: &str, address: impl Fn(usize) -> (Ipv4Addr, u16)) -> String {
    (0..3).fold(text.to_owned(), |text, host| {
        let (ip, port) = address(host);
        text.replace(&format!("\"HOST{}\" port PORT", host + 1), &format!("\"{ip}\" port {port}"))
    })
}
