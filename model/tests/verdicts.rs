//! Verdicts that were once wrong: violations that the search missed, and findings to which no run leads.

use crate::cell_findings::all;
use crate::cells::Text;
use imrs_model::cell::Kind;

const TWO: &str = "cell two;\ntick 1 msec;\nnode na; node nb;\nlink na -- nb delay 1 msec;\n";
const ONE: &str = "cell one;\ntick 1 msec;\nnode na;\n";

fn kinds(text: &str) -> Vec<Kind> {
    all(&Text::new(text)).into_iter().map(|(kind, _)| kind).collect()
}

/// Nodes are not ordered within a tick: a check may see one node's value before the tick and another node's after it.
#[test]
fn a_check_that_reads_two_nodes_holds_in_either_order_of_a_tick() {
    let gate = |left: &str, right: &str, turn: &str| {
        format!(
            "{TWO}task left on {left}\nport go() usage = waitfor user_list = {{right}} time_out = 60 msec;\nvar inside: bool;\n\
             begin inside := true; waitfor go() on time_out do skip; end; run turn takes {turn}; inside := false; end left;\n\
             task right on {right}\nuse_port go() usage = waitfor;\nvar inside: bool;\n\
             begin waitfor go() on time_out do skip; end; run turn takes 10..12 msec; inside := true; end right;\n\
             check apart: never left.inside and right.inside;\n"
        )
    };
    for (left, right) in [("na", "nb"), ("nb", "na")] {
        assert_eq!(kinds(&gate(left, right, "5..10 msec")), [Kind::Check], "left on {left}");
        assert_eq!(kinds(&gate(left, right, "5..9 msec")), [], "left on {left}");
    }
    // In this cell, two delays end in one step of the search.
    let waits = |a: &str, b: &str| {
        format!(
            "{TWO}task a on {a}\nvar x: bool;\nbegin x := true; delay 5 msec; x := false; end a;\n\
             task b on {b}\nvar y: bool;\nbegin delay 5 msec; y := true; end b;\ncheck c: never a.x and b.y;\n"
        )
    };
    assert_eq!(kinds(&waits("na", "nb")), [Kind::Check]);
    assert_eq!(kinds(&waits("nb", "na")), [Kind::Check]);
    // In this cell both tasks are on one node, whose threads may run them in either order.
    assert_eq!(kinds(&waits("na", "na")), [Kind::Check]);
}

/// Two tasks of a node that have something to do in one tick run in either order, whichever the cell declares first.
#[test]
fn of_two_tasks_of_a_node_either_goes_on_first() {
    let gate = [
        "task a on na\nvar x: bool;\nbegin x := true; delay 400 msec; x := false; end a;\n",
        "task b on na\nvar y: bool;\nbegin delay 400 msec; y := true; end b;\n",
    ];
    for tasks in [gate, [gate[1], gate[0]]] {
        let text = format!("{ONE}{}check c: never a.x and b.y;\n", tasks.concat());
        assert_eq!(kinds(&text), [Kind::Check], "{text}");
    }
    // Either message may also arrive first, so every statement is reached.
    let says = |name: &str, port: &str| {
        format!(
            "task {name} on na\nport {port}() usage = send user_list = {{c}} time_out = 50 msec;\nbegin delay 5 msec; send {port}(); end {name};\n"
        )
    };
    let hears = "task c on na\nuse_port p() usage = receive; use_port q() usage = receive;\nvar first: int8;\nbegin\n\
        on receive p() do if first = 0 then first := 1; end; end;\non receive q() do if first = 0 then first := 2; end; end;\n\
        delay 20 msec;\nend c;\ncheck c1: never c.first = 1;\ncheck c2: never c.first = 2;\n";
    assert_eq!(
        kinds(&format!("{ONE}{}{}{hears}", says("a", "p"), says("b", "q"))),
        [Kind::Check, Kind::Check]
    );
}

/// Each of two tasks of a node enters, unless the other has reported that it entered. Both tasks may send that report
/// before either receives one.
#[test]
fn what_two_tasks_of_a_node_send_each_other_may_cross() {
    let enters = |name: &str, (own, other): (&str, &str), takes: &str| {
        let peer = if name == "a" { "b" } else { "a" };
        format!(
            "task {name} on na\nport {own}() usage = send user_list = {{{peer}}} time_out = 50 msec; use_port {other}() usage = receive;\n\
             var inside, heard: bool;\nbegin\non receive {other}() do heard := true; end;\norder {other} > self;\n\
             run look takes {takes};\nif not heard then send {own}(); inside := true; run work takes 3 msec; inside := false; end;\nend {name};\n"
        )
    };
    let zone = |takes: &str| {
        let tasks = [enters("a", ("p", "q"), "5 msec"), enters("b", ("q", "p"), takes)].concat();
        kinds(&format!("{ONE}{tasks}check apart: never a.inside and b.inside;\n")).contains(&Kind::Check)
    };
    assert!(zone("5 msec"));
    assert!(!zone("6 msec"), "what was said a tick ago was heard");
}

/// A message may arrive before or after an event of its receiver in the same tick: the end of a delay or timer, or the
/// success or failure of an action.
#[test]
fn a_message_of_a_tick_comes_before_or_after_what_its_receiver_does_by_itself() {
    let ends = |wait: &str, faults: &str| {
        let timer = if wait.contains("start t") { " var t: timer;" } else { "" };
        let text = format!(
            "{ONE}task a on na\nport m() usage = send user_list = {{e}} time_out = 50 msec;\nbegin delay 5 msec; send m(); end a;\n\
             task e on na\nuse_port m() usage = receive;\nvar heard, before, after: bool;{timer}\nbegin\non receive m() do heard := true; end;\n\
             {wait}\nend e;\n{faults}check not_before: never e.before;\ncheck not_after: never e.after;\n"
        );
        kinds(&text).into_iter().filter(|kind| *kind == Kind::Check).count()
    };
    let told = "if heard then before := true; else after := true; end;";
    assert_eq!(ends(&format!("order m > self; delay 5 msec; {told}"), ""), 2);
    assert_eq!(ends(&format!("order m > self; run look takes 5 msec; {told}"), ""), 2);
    let timer = format!("on expiry t do {told} end; order m > timers > self; start t 5 msec; delay 20 msec;");
    assert_eq!(ends(&timer, ""), 2);
    let fails = format!("order m > self; run look takes 5 msec on failed do {told} end; delay 20 msec;");
    assert_eq!(ends(&fails, "faults fail 1;\n"), 2);
    assert_eq!(ends(&format!("order m > self; delay 6 msec; {told}"), ""), 1, "a tick later it was heard");
    assert_eq!(ends(&format!("order m > self; delay 4 msec; {told}"), ""), 1);
}

/// A held-back script may begin before or after the steps of other scripts in the same tick.
#[test]
fn a_script_that_was_held_back_begins_before_or_after_the_others() {
    let x = "task x on na\nport p() usage = send user_list = {z} time_out = 10 msec class = 2;\nvar begun: bool;\nbegin begun := true; delay 500 msec;\n\
        send p() on time_out do skip; end on refused do skip; end; end x;\n";
    let z = "task z on nb\nuse_port p() usage = receive;\nbegin order p > self; on receive p() do reply(); end; delay 100 msec; end z;\n";
    let broken = |delay: u8, x_first: bool| {
        let y = format!(
            "task y on na\nvar done: bool;\nbegin delay {delay} msec; done := true; delay 30 msec; end y;\n"
        );
        let tasks = if x_first { format!("{x}{y}") } else { format!("{y}{x}") };
        let check = "faults crash na;\ncheck after: never y.done and not x.begun;\n";
        kinds(&format!("{TWO}{tasks}{z}{check}")).contains(&Kind::Check)
    };
    for x_first in [true, false] {
        assert_eq!(
            [10, 11, 12].map(|delay| broken(delay, x_first)),
            [true, true, false],
            "x first: {x_first}"
        );
    }
}

/// Two scripts that were held back equally long begin one by one: other scripts run in between, and the time_out of an
/// unrelated task comes before or after.
#[test]
fn scripts_that_were_held_back_begin_one_by_one() {
    let held = |name: &str, port: &str, (hello, say): (&str, &str)| {
        format!(
            "task {name} on na\nport {port}() usage = send user_list = {{z}} time_out = 10 msec class = 2;{hello}\nvar begun: bool;\n\
             begin {say}begun := true; delay 500 msec;\nsend {port}() on time_out do skip; end on refused do skip; end; end {name};\n"
        )
    };
    let hello = (" port hello() usage = send user_list = {y} time_out = 10 msec;", "send hello(); ");
    let (x, v) = (held("x", "p", hello), held("v", "r", ("", "")));
    // Task `y` gets no `hello` after a restart: `x` is then held back. So `y` knows its second incarnation.
    let y = |ports: &str, then: &str| {
        format!(
            "task y on na\nuse_port hello() usage = receive;{ports}\nvar second, done: bool;\nbegin\n\
             receive hello() within 1 msec on time_out do second := true; end;\n{then} done := true; delay 500 msec; end y;\n"
        )
    };
    let z = "task z on nb\nuse_port p() usage = receive; use_port r() usage = receive;\nbegin order p > r > self;\n\
        on receive p() do reply(); end; on receive r() do reply(); end; delay 800 msec; end z;\nfaults crash na;\n";
    let broken = |tasks: &[&str], check: &str| {
        kinds(&format!("{TWO}{}{z}check c: never {check};\n", tasks.concat())).contains(&Kind::Check)
    };
    let delays = y("", "delay 10 msec;");
    let between = "x.begun and y.second and y.done and not v.begun";
    assert!(broken(&[&x, &v, &delays], between), "the delay of y ends between the two");
    assert!(!broken(&[&v, &x, &delays], between), "v begins first");
    assert!(broken(&[&v, &x, &delays], "v.begun and y.second and not x.begun"));
    let ask = " port q() usage = send user_list = {w} time_out = 10 msec class = 2;";
    let times_out = y(ask, "send q() on time_out do skip; end on refused do skip; end;");
    let w =
        "task w on na\nuse_port q() usage = receive;\nbegin delay 300 msec; receive q(); reply(); end w;\n";
    assert!(broken(&[&x, &v, &times_out, w], "x.begun and y.second and not y.done"));
    assert!(broken(&[&x, &v, &times_out, w], "y.second and y.done and not x.begun"));
}

/// After a lost packet, the next packet of the link may arrive in the same tick, before or after a task's own event.
#[test]
fn a_packet_behind_one_that_is_lost_comes_among_what_tasks_do_by_themselves() {
    let cell = |faults: &str| {
        format!(
            "{TWO}task s on nb\nport p() usage = send user_list = {{b}} time_out = 50 msec; port q() usage = send user_list = {{c}} time_out = 50 msec;\n\
             begin delay 4 msec; send p(); send q(); delay 100 msec; end s;\n\
             task b on na\nuse_port p() usage = receive;\nvar got: bool;\nbegin receive p(); got := true; delay 100 msec; end b;\n\
             task c on na\nuse_port q() usage = receive;\nvar got: bool;\nbegin receive q(); got := true; delay 100 msec; end c;\n\
             task d on na\nvar done: bool;\nbegin delay 5 msec; done := true; delay 100 msec; end d;\n\
             {faults}check c1: never c.got and not b.got and not d.done;\n"
        )
    };
    for faults in ["faults loss 1;\n", "faults cut na -- nb;\n"] {
        assert!(kinds(&cell(faults)).contains(&Kind::Check), "{faults}");
    }
    assert!(!kinds(&cell("")).contains(&Kind::Check));
}

#[test]
fn two_checks_that_one_step_breaks_are_two_findings() {
    let text = format!(
        "{ONE}task a on na\nvar x: bool;\nbegin delay 3 msec; x := true; end a;\ncheck c1: never a.x;\ncheck c2: always not a.x;\n"
    );
    assert_eq!(kinds(&text), [Kind::Check, Kind::Check]);
}

/// Two tasks have lost a token, and wait for each other for ever, whatever a third task does.
#[test]
fn a_deadlock_is_found_beside_a_task_that_goes_on() {
    let ring = |other: &str| {
        format!(
            "{TWO}task a on na\nport p() usage = send user_list = {{b}} time_out = 20 msec;\nuse_port q() usage = receive;\n\
             begin loop send p(); receive q(); run work takes 5 msec; end; end a;\n\
             task b on nb\nuse_port p() usage = receive;\nport q() usage = send user_list = {{a}} time_out = 20 msec;\n\
             begin loop receive p(); send q(); end; end b;\n{other}faults loss 1;\n"
        )
    };
    let idle = "task c on na\nbegin loop delay 50 msec; end; end c;\n";
    let acts = "task c on na\nbegin loop run blink takes 5 msec; end; end c;\n";
    for other in ["", idle, acts] {
        assert_eq!(kinds(&ring(other)), [Kind::Deadlock], "{other}");
    }
    // A task that has a handler for messages of a third task may still be helped by that task.
    let helps = "task c on na\nport r() usage = send user_list = {a} time_out = 20 msec;\n\
        begin loop delay 50 msec; send r(); end; end c;\n";
    let heard = ring(helps).replace(
        "begin loop send p();",
        "use_port r() usage = receive;\nbegin on receive r() do skip; end; loop send p();",
    );
    assert_eq!(kinds(&heard), []);
}

/// Two tasks have only handlers, and the first one sends to the second. When both rest, neither waits for the other.
#[test]
fn servers_at_rest_are_no_deadlock() {
    let text = format!(
        "{TWO}task panel on na\nport go() usage = send user_list = {{a}} time_out = 20 msec;\nbegin send go(); end panel;\n\
         task a on na\nuse_port go() usage = receive;\nport note() usage = send user_list = {{b}} time_out = 20 msec;\n\
         begin order go > self; on receive go() do send note(); end; end a;\n\
         task b on nb\nuse_port note() usage = receive;\n\
         begin order note > self; on receive note() do skip; end; end b;\n"
    );
    assert_eq!(kinds(&text), []);
}

/// An action gives a real result as its bits. The adjacent floats on both sides of a constant are tried.
#[test]
fn a_real_result_comes_on_both_sides_of_what_it_is_compared_with() {
    let text = |range: &str, when: &str| {
        format!(
            "{ONE}task a on na\nvar r: real; var y: bool;\n\
             begin loop run look -> r {range} takes 1 msec; y := {when}; delay 1 msec; y := false; end; end a;\ncheck c: never a.y;\n"
        )
    };
    assert_eq!(kinds(&text("", "r >= 2.5")), [Kind::Check]);
    assert_eq!(kinds(&text("in 0 .. 100", "r > 2.2 and r < 2.8")), [Kind::Check]);
    assert_eq!(kinds(&text("in 0 .. 2", "r > 2.2")), []);
    assert_eq!(kinds(&text("in -3 .. -1", "r < -1.5")), [Kind::Check]);
}

/// Each statement gets results of its own range and type, even if another statement runs an action of the same name.
#[test]
fn statements_of_one_action_have_their_own_results() {
    let text = |first: &str, second: &str, of: &str, check: &str| {
        format!(
            "{ONE}task a on na\nvar k: int16; var m: {of}; var y: bool;\n\
             begin loop y := false; run look -> k {first} takes 1 msec; assert k <= 10;\n\
             run look -> m {second} takes 1 msec; if m > 50 then y := true; end; delay 1 msec; end; end a;\n{check}"
        )
    };
    let breaks = [Kind::Check];
    assert_eq!(kinds(&text("in 0 .. 10", "in 0 .. 100", "int16", "check c: never a.y;\n")), breaks);
    assert_eq!(kinds(&text("in 0 .. 10", "", "int16", "check c: never a.y;\n")), breaks);
    assert_eq!(kinds(&text("in 0 .. 10", "", "int32", "")), []);
    let wide = text("in 0 .. 10", "", "int32", "check c: never a.y;\n").replace("m > 50", "m > 1000");
    assert_eq!(kinds(&wide), breaks);
}

/// A standstill in which every question is answered must not hide a standstill in which a question is not answered.
#[test]
fn one_standstill_does_not_hide_another() {
    let text = |k: &str| {
        format!(
            "{TWO}task a on na\nport p() usage = query user_list = {{b}} time_out = 9 msec;\nvar k: int8;\n\
             begin run look -> k in 0 .. 1 takes 1 msec; if k = {k} then loop delay 10 msec; end; end;\n\
             loop query p() on time_out do skip; end on refused do skip; end; end; end a;\n\
             task b on nb\nuse_port p() usage = response;\nbegin receive p(); reply(); loop delay 50 msec; end; end b;\n"
        )
    };
    for k in ["0", "1"] {
        let verdicts = Text::new(&text(k)).check();
        assert_eq!(verdicts.warnings.len(), 1, "{k}");
    }
}

/// A task answered a query long ago, and the asking task has gone on sending since then. The search must complete, and
/// report a standstill.
#[test]
fn an_answer_of_long_ago_ends_no_search() {
    let text = format!(
        "{TWO}task arm on na\nuse_port next() usage = query;\n\
         port done() usage = send user_list = {{feeder}} time_out = 2 sec class = 2;\nbegin loop\n\
         query next() on time_out do skip; end;\n\
         if outcome = answered then run pick takes 200..400 msec; send done() on time_out do skip; end; end;\nend; end arm;\n\
         task feeder on nb\nport next() usage = response user_list = {{arm}} time_out = 2 sec;\n\
         use_port done() usage = receive;\nbegin loop\n\
         receive next(); response(); receive done(); reply();\nend; end feeder;\nfaults loss 1;\n"
    );
    let verdicts = Text::new(&text).check();
    assert!(verdicts.is_complete() && verdicts.findings.is_empty());
    assert_eq!(verdicts.warnings.iter().map(|warning| warning.kind).collect::<Vec<_>>(), [Kind::Standstill]);
}

/// A branch for a time_out that no searched fault causes may lead to statements that need no fault themselves. Such
/// statements are not reported as unreached.
#[test]
fn what_only_an_untried_fault_leads_to_is_no_finding() {
    let asks = |first: &str, on_time_out: &str| {
        format!(
            "{TWO}task a on na\nuse_port next() usage = query;\nvar part: int8;\nbegin loop\n\
             query next() -> part on time_out do {on_time_out} end;\n\
             if part > 0 then run pick takes 5 msec; else run rest takes 5 msec; end;\nend; end a;\n\
             task b on nb\nport next() -> int8 usage = response user_list = {{a}} time_out = 50 msec retry = 2;\n\
             begin loop receive next(); response({first}); end; end b;\n"
        )
    };
    assert_eq!(kinds(&asks("1", "part := 0;")), []);
    assert_eq!(kinds(&asks("1", "abort \"late\";")), [Kind::Unreached]);
}

/// A task that waits in the middle of its work for a task that has ended is reported. A task that has done all its work,
/// and waits for the next message, is not reported.
#[test]
fn who_waits_for_ever_for_one_that_has_ended_is_told() {
    let told = |sends: &str, takes: &str, other: &str| {
        let text = format!(
            "{TWO}task a on na\nport p() usage = send user_list = {{b}} time_out = 50 msec class = 2;\n\
             begin {sends} end a;\n\
             task b on nb\nuse_port p() usage = receive;\nvar n: int8;\nbegin {takes} end b;\n{other}"
        );
        let verdicts = Text::new(&text).check();
        assert!(verdicts.is_complete(), "{text}");
        // The statements after an endless wait are never reached.
        assert!(
            verdicts.findings.iter().all(|found| found.kind == Kind::Unreached),
            "{:?}",
            verdicts.findings
        );
        let told = verdicts.warnings.iter().map(|warning| (warning.kind, warning.cause.clone()));
        told.collect::<Vec<_>>()
    };
    let waits = [(Kind::WaitsForEver, "b waits at receive `p` for ever: a has ended".to_owned())];
    let (once, twice) = ("receive p(); reply();", "receive p(); reply(); receive p(); reply();");
    let acts = "task c on na\nbegin loop run blink takes 5 msec; end; end c;\n";
    for other in ["", acts] {
        assert_eq!(told("send p();", twice, other), waits, "{other}");
        assert_eq!(told("send p();", once, other), [], "{other}");
        // The condition of the loop shows that the task expects two messages.
        assert_eq!(told("send p();", "while n < 2 do receive p(); reply(); n := n + 1; end;", other), waits);
        assert_eq!(
            told("send p(); send p();", "while n < 2 do receive p(); reply(); n := n + 1; end;", other),
            []
        );
        // A task whose loop has no `exit` serves for ever: its last wait is no finding in any form of the loop.
        for serves in [
            "while true do receive p(); reply(); end;",
            "loop if n > 0 then receive p(); reply(); else receive p(); reply(); n := 1; end; end;",
        ] {
            assert_eq!(told("send p();", serves, other), [], "{serves}");
        }
        let counts = "loop if n = 2 then exit; end; receive p(); reply(); n := n + 1; end;";
        assert_eq!(told("send p();", counts, other), waits);
        // Both forms of this task are servers: one takes single messages, the other takes messages in pairs.
        assert_eq!(told("send p();", "loop receive p(); reply(); end;", other), []);
        assert_eq!(
            told("send p();", "loop n := 0; receive p(); reply(); run pick takes 5 msec; end;", other),
            []
        );
        assert_eq!(told("send p();", &format!("loop {twice} end;"), other), waits);
        assert_eq!(told("send p(); send p();", &format!("loop {twice} end;"), other), []);
    }
}

/// A standby that goes on, or that ends after its primary got the lease, does not leave its primary waiting for ever.
#[test]
fn a_primary_whose_standby_has_ended_is_told() {
    let told = |standby: &str| {
        let text = format!(
            "{TWO}task a on na\nport alive() usage = response user_list = {{b}} time_out = 20 msec;\n\
             begin loop run weld takes 50 msec; end; end a;\n\
             task b on nb standby of a\nuse_port alive() usage = query;\nbegin {standby}\n\
             takeover loop run weld takes 50 msec; end; end b;\n\
             couple work a -> b lease 100 msec takeover 250 msec every 20 msec via alive;\n"
        );
        let verdicts = Text::new(&text).check();
        assert!(verdicts.is_complete(), "{text}");
        let all = verdicts.findings.iter().chain(&verdicts.warnings);
        all.filter(|found| found.kind != Kind::Unreached)
            .map(|found| (found.kind, found.cause.clone()))
            .collect::<Vec<_>>()
    };
    assert_eq!(told("loop delay 50 msec; end;"), []);
    let waits = (Kind::WaitsForEver, "a waits at its lease for ever: b has ended".to_owned());
    assert_eq!(told("skip;"), [waits]);
    let ends = (Kind::LeaseLost, "a lost its lease".to_owned());
    assert_eq!(told("delay 150 msec;"), [ends]);
}
