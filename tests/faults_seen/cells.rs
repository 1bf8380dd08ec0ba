//! The cells of the fault matrix. They are slow, so that a busy machine causes no finding.

use crate::support::own_address;

/// A cell of three tasks that meet, and exchange queries and statuses. All time_outs are far longer than needed.
pub const WATCHED: &str = "\
cell watched;
tick 50 msec;
node na;  node nb;  node nc;
link na -- nb delay 50 msec;  link nb -- nc delay 50 msec;  link na -- nc delay 50 msec;
task a on na
  port ask(n: int16) -> int16  usage = query  user_list = {b}  time_out = 20 sec  class = 2;
  port news(n: int16)  usage = send  user_list = {c}  time_out = 40 sec  class = 1  bounded_buffer[8];
  port meet()  usage = waitfor  user_list = {b, c}  time_out = 20 sec  class = 2  retry = 4  resend = 100 msec;
  var n: int16;
begin
  loop
    query ask(n) -> n on time_out do n := 0; end on refused do n := 0; end;
    send news(n);
    waitfor meet() on time_out do skip; end;
    delay 200 msec;
  end;
end a;
task b on nb
  use_port ask(n: int16) -> int16  usage = response;
  use_port meet()  usage = waitfor  time_out = 20 sec;
begin
  order ask > self;
  on query ask(n) do response(n); end;
  loop
    waitfor meet() on time_out do skip; end;
    delay 200 msec;
  end;
end b;
task c on nc
  use_port news(n: int16)  usage = receive;
  use_port meet()  usage = waitfor  time_out = 20 sec;
begin
  order news > self;
  on receive news(n) do skip; end;
  loop
    waitfor meet() on time_out do skip; end;
    delay 200 msec;
  end;
end c;
";

/// A further task on the node of `b`. It sends statuses and waits for nothing.
pub const LIGHT: &str = "\
task d on nb
  port light(n: int16)  usage = send  user_list = {c}  time_out = 4 sec  class = 1  bounded_buffer[8];
  var n: int16;
begin
  loop send light(n); delay 200 msec; end;
end d;
";

/// A cell with two nodes and these tasks.
macro_rules! two_nodes {
    ($tasks:literal) => {
        concat!("cell two;\ntick 50 msec;\nnode na;  node nb;\nlink na -- nb delay 50 msec;\n", $tasks)
    };
}

/// A camera sends more statuses than a picker takes.
pub const FLOOD: &str = two_nodes!(
    "task camera on na
  port pose(n: int16)  usage = send  user_list = {picker}  time_out = 10 sec  class = 1  bounded_buffer[2];
  var n: int16;
begin
  delay 2 sec;
  loop send pose(n); delay 50 msec; end;
end camera;
task picker on nb
  use_port pose(n: int16)  usage = receive;
  var n: int16;
begin
  loop receive pose(n); run follow n takes 1 sec; end;
end picker;
"
);

/// Two tasks send commands to a press whose buffer has space for one, and which takes none.
pub const NO_SPACE: &str = two_nodes!(
    "task press on nb
  port put(n: int16)  usage = receive  user_list = {p, q}  time_out = 20 sec  class = 2  bounded_buffer[1];
  var n: int16;
begin
  run work n takes 600 sec;
  receive put(n); reply();
end press;
task p on na
  use_port put(n: int16)  usage = send;
begin
  run go takes 0..60 sec;
  use_send put(1) on time_out do skip; end on refused do skip; end;
end p;
task q on na
  use_port put(n: int16)  usage = send;
begin
  run go takes 0..60 sec;
  use_send put(2) on time_out do skip; end on refused do skip; end;
end q;
"
);

/// A task works for ten minutes while a message with a TTL of six seconds waits.
pub const SLOW: &str = two_nodes!(
    "task a on na
  port news(n: int16)  usage = send  user_list = {b}  time_out = 6 sec  class = 1  bounded_buffer[4];
begin
  run go takes 0..60 sec;
  send news(1);
  delay 100 sec;
end a;
task b on nb
  use_port news(n: int16)  usage = receive;
  var n: int16;
begin
  run dig n takes 600 sec;
  receive news(n);
end b;
"
);

/// A member of a rendezvous digs for a minute, and the other one waits for it.
pub const LATE: &str = two_nodes!(
    "task a on na
  port meet()  usage = waitfor  user_list = {b}  time_out = 12 sec  class = 2  retry = 4  resend = 200 msec;
begin
  waitfor meet() on time_out do skip; end;
end a;
task b on nb
  use_port meet()  usage = waitfor  time_out = 12 sec;
begin
  run dig takes 60 sec;
  waitfor meet() on time_out do skip; end;
end b;
"
);

/// Two tasks ask each other at the same time, and answer only afterwards.
pub const CIRCLE: &str = two_nodes!(
    "task left on na
  port free() -> bool  usage = query  user_list = {right}  time_out = 30 sec;
  use_port clear() -> bool  usage = response;
  var ok: bool;
begin
  order clear > self;
  on query clear() do response(not ok); end;
  atomic run look takes 2 sec; query free() -> ok on time_out do ok := false; end; end;
end left;
task right on nb
  port clear() -> bool  usage = query  user_list = {left}  time_out = 30 sec;
  use_port free() -> bool  usage = response;
  var ok: bool;
begin
  order free > self;
  on query free() do response(not ok); end;
  atomic run look takes 2 sec; query clear() -> ok on time_out do ok := false; end; end;
end right;
"
);

/// An arm that welds rejects a question by its rank.
pub const STARVED: &str = two_nodes!(
    "task inspector on na
  port weld()  usage = send  user_list = {arm}  time_out = 10 sec  class = 1;
  port stop()  usage = send  user_list = {arm}  time_out = 10 sec  class = 1;
  port halt()  usage = send  user_list = {arm}  time_out = 10 sec  class = 1;
  port look() -> bool  usage = query  user_list = {arm}  time_out = 30 sec  penalty = 200 msec;
  var ok: bool;
begin
  delay 1 sec;
  send weld();
  delay 1 sec;
  query look() -> ok on time_out do ok := false; end on refused do ok := false; end;
  if ok then send stop(); send halt(); end;
end inspector;
task arm on nb
  use_port weld()  usage = receive;
  use_port stop()  usage = receive;
  use_port halt()  usage = receive;
  use_port look() -> bool  usage = response;
begin
  order weld > stop > halt > self > look;
  on receive weld() do run weld_it takes 20 sec; end;
  on receive stop() do skip; end;
  on receive halt() do skip; end;
  on query look() do response(true); end;
  loop delay 20 sec; end;
end arm;
"
);

/// A task that never pauses between its statements.
pub const CRASH: &str = two_nodes!(
    "task a on na
  port news(n: int16)  usage = send  user_list = {b}  time_out = 2 sec  class = 1  bounded_buffer[4];
  var n: int16;
begin
  delay 2 sec;
  loop send news(n); end;
end a;
task b on na
  use_port news(n: int16)  usage = receive;
  var n: int16;
begin
  loop receive news(n); end;
end b;
"
);

/// Two texts of a cell that differ in the size of a buffer. Each node has an address of its own.
pub fn two_texts() -> [String; 2] {
    let (host, [a, b]) = own_address();
    let text = |buffer: u8| {
        format!(
            "cell texts;\ntick 50 msec;\nnode na at \"{host}\" port {a};  node nb at \"{host}\" port {b};\nlink na -- nb delay 50 msec;
task a on na
  port news(n: int16)  usage = send  user_list = {{b}}  time_out = 2 sec  class = 1  bounded_buffer[{buffer}];
  var n: int16;
begin
  loop send news(n); delay 500 msec; end;
end a;
task b on nb
  use_port news(n: int16)  usage = receive;
begin
  order news > self;
  on receive news(n) do skip; end;
  loop delay 1 sec; end;
end b;
"
        )
    };
    [text(4), text(5)]
}
