//! Random cells that are too large to be searched: many tasks send to one task, the *middle*. The middle's buffers fill,
//! its order of service matters, relays hold packets of several tasks, duplicates come late and long messages are
//! fragmented. The tests only make random runs of these cells, and judge the history of each run.

use super::cells::Tape;
use std::fmt::Write;

/// How the callers of a crowd use one port of the task in the middle.
struct Port {
    /// The types of the fields of the port's messages.
    carries: &'static str,
    /// The values of one message of the port.
    values: &'static str,
    command: bool,
    handled: bool,
}

const CARRIES: [(&str, &str); 4] =
    [("u: int8", "i"), ("", ""), ("v: Long", "l"), ("u: word, w: int16", "7, 3")];

/// The text of the crowd cell that these random bytes make.
pub fn cell(bytes: &[u8]) -> String {
    let mut tape = Tape::new(bytes);
    let callers = 2 + tape.below(4);
    let ports: Vec<Port> = (0..1 + tape.below(4)).map(|_| port(&mut tape)).collect();
    let mut text = String::from("cell crowd;\ntick 1 msec;\n");
    let nodes = 2 + tape.below(3);
    for node in 0..nodes {
        let _ = writeln!(text, "node n{node};");
    }
    // The nodes form a row, so that packets of the farther nodes wait in the relays between these nodes and the task
    // `middle`.
    for node in 1..nodes {
        let delay = tape.one(&["1 msec", "1 msec", "2 msec"]);
        let _ = writeln!(text, "link n{} -- n{node} delay {delay};", node - 1);
    }
    text.push_str("type Long is record a: word; b: word; c: word; d: int32; e: int32; end;\n");
    middle(&mut tape, &mut text, &ports, callers);
    for caller in 0..callers {
        let node = tape.below(nodes);
        call(&mut tape, &mut text, &ports, (caller, node));
    }
    let faults = [
        "loss 2",
        "dup 2",
        "loss 1 dup 2",
        "crash middle",
        "crash c0 dup 1",
        "drift 1",
        "cut n0 -- n1",
        "fail 1",
    ];
    let _ = writeln!(text, "faults {};", tape.one(&faults));
    if tape.chance(30) {
        let _ = writeln!(text, "faults {};", tape.one(&["pause middle", "pause c0 up to 9 msec", "dup 3"]));
    }
    text
}

fn port(tape: &mut Tape<'_>) -> Port {
    let (carries, values) = CARRIES[tape.below(CARRIES.len())];
    Port { carries, values, command: tape.chance(50), handled: tape.chance(50) }
}

/// The parameters of a port, with the names that a handler gives them.
fn names(port: &Port) -> String {
    let fields = port.carries.split(", ").filter_map(|field| field.split(':').next());
    fields.filter(|name| !name.is_empty()).map(|name| format!("h{name}")).collect::<Vec<_>>().join(", ")
}

/// Writes the task to which all callers send.
fn middle(tape: &mut Tape<'_>, text: &mut String, ports: &[Port], callers: usize) {
    let users: Vec<String> = (0..callers).map(|caller| format!("c{caller}")).collect();
    text.push_str("task middle on n0\n");
    for (at, port) in ports.iter().enumerate() {
        let class = if port.command { 2 } else { 1 };
        // The time_outs are often equal, so that messages are equally urgent.
        let time_out = tape.one(&["40 msec", "40 msec", "60 msec"]);
        let _ = write!(
            text,
            "  port p{at}({}) usage = receive user_list = {{{}}}",
            port.carries,
            users.join(", ")
        );
        let _ = write!(text, " time_out = {time_out} class = {class} bounded_buffer[{}]", 1 + tape.below(8));
        if port.command && tape.chance(40) {
            text.push_str(" retry = 2 resend = 9 msec");
        }
        if port.handled && tape.chance(60) {
            let _ = write!(text, " penalty = {} msec", 1 + tape.below(4));
        }
        if !port.command && port.carries != "v: Long" && tape.chance(10) {
            text.push_str(" latest");
        }
        text.push_str(";\n");
    }
    let timer = tape.chance(30);
    text.push_str("  var i: int8; var l: Long; var w: word; var k: int16;");
    text.push_str(if timer { " var t: timer;\nbegin\n" } else { "\nbegin\n" });
    ranks(tape, text, ports, timer);
    for (at, port) in ports.iter().enumerate().filter(|(_, port)| port.handled) {
        let _ = writeln!(text, "  on receive p{at}({}) do", names(port));
        text.push_str(tape.one(&["    skip;\n", "    delay 2 msec;\n", "    run serve takes 1..6 msec;\n"]));
        text.push_str(if port.command { "    reply();\n  end;\n" } else { "    skip;\n  end;\n" });
    }
    if timer {
        let _ =
            writeln!(text, "  on expiry t do start t {} msec; end;\n  start t 6 msec;", 4 + tape.below(5));
    }
    text.push_str("  loop\n");
    serve(tape, text, ports, callers);
    if tape.chance(30) {
        ranks(tape, text, ports, timer);
    }
    let _ = writeln!(text, "    delay {} msec;\n  end;\nend middle;", 1 + tape.below(12));
}

/// Writes an `order` for the handlers of the middle task.
fn ranks(tape: &mut Tape<'_>, text: &mut String, ports: &[Port], timer: bool) {
    let handled = ports.iter().enumerate().filter(|(_, port)| port.handled);
    let mut ranks: Vec<String> = handled.map(|(at, _)| format!("p{at}")).collect();
    if timer {
        ranks.push("t".into());
    }
    if ranks.is_empty() {
        return;
    }
    let by = tape.below(ranks.len());
    ranks.rotate_left(by);
    ranks.insert(tape.below(ranks.len() + 1), "self".into());
    let _ = writeln!(text, "  order {};", ranks.join(" > "));
}

/// Writes what the thread of the middle task does in one iteration.
fn serve(tape: &mut Tape<'_>, text: &mut String, ports: &[Port], callers: usize) {
    let open: Vec<(usize, &Port)> = ports.iter().enumerate().filter(|(_, port)| !port.handled).collect();
    let any = !open.is_empty() && open.iter().all(|(_, port)| !port.command);
    for &(at, port) in &open {
        for _ in 0..1 + tape.below(2) {
            if any && tape.chance(50) {
                text.push_str("    receive within 8 msec on time_out do skip; end;\n");
                continue;
            }
            let into = match port.carries {
                "u: int8" => "i",
                "v: Long" => "l",
                "" => "",
                _ => "w, k",
            };
            let from =
                if tape.chance(25) { format!(" from c{}", tape.below(callers)) } else { String::new() };
            // After a time_out there is no message to reply to.
            let (rest, leave) = if port.command { ("    reply();\n", "exit") } else { ("", "skip") };
            if port.command {
                let _ = writeln!(text, "    loop");
            }
            let _ =
                writeln!(text, "    receive p{at}({into}){from} within 8 msec on time_out do {leave}; end;");
            text.push_str(rest);
            if port.command {
                text.push_str("    exit; end;\n");
            }
        }
    }
}

/// Writes one of the tasks that send to the middle.
fn call(tape: &mut Tape<'_>, text: &mut String, ports: &[Port], (caller, node): (usize, usize)) {
    let _ = writeln!(text, "task c{caller} on n{node}");
    for (at, port) in ports.iter().enumerate() {
        let _ = writeln!(text, "  use_port p{at}({}) usage = send;", port.carries);
    }
    text.push_str("  var i: int8; var l: Long;\nbegin\n  loop\n");
    for (at, port) in ports.iter().enumerate() {
        let times = if port.command { 1 } else { 1 + tape.below(3) };
        for _ in 0..times {
            let within = if tape.chance(15) { " within 25 msec" } else { "" };
            let ends = if port.command { " on time_out do skip; end on refused do skip; end" } else { "" };
            let _ = writeln!(text, "    use_send p{at}({}){within}{ends};", port.values);
        }
        text.push_str("    i := (i + 1) mod 5;\n");
    }
    let _ = writeln!(text, "    delay {} msec;\n  end;\nend c{caller};", 1 + tape.below(15));
}
