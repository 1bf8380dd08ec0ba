//! Findings in cells with extern tasks, whose bodies are outside the cell.

use crate::cell_findings::{all, found};
use crate::cells::{Text, within};
use imrs_model::cell::{Kind, Phase, Times};

#[test]
fn a_task_outside_makes_any_use_of_its_ports() {
    let text = "cell out;\ntick 1 msec;\nnode na;  node nb;\nlink na -- nb delay 1 msec;\n\
        type Num is record n: int8; end;\n\
        task a on na extern rate = 1/10 msec\n\
        port put(m: Num) usage = send message_format = Num user_list = {b} time_out = 20 msec class = 2 \
        rate = 1/10 msec;\nend a;\n\
        task b on nb\nuse_port put(m: Num) usage = receive;\nvar y: bool; var m: Num;\nbegin\n\
        loop receive put(m); y := true; reply(); y := false; run work takes 1..5 msec; end;\nend b;\n\
        check c: never b.y;\n";
    // An extern task may send any value of its format.
    for never in ["never b.m.n > 0", "never b.m.n > 7", "never b.m.n < -7"] {
        let cell = Text::new(&text.replace("never b.y", never));
        assert_eq!(cell.found(&cell.check()), [found(Kind::Check, "")], "{never}");
    }
    let cell = Text::new(&text.replace("never b.y", "never b.m.n > 127"));
    assert_eq!(all(&cell), []);
    let verdicts = cell.check();
    assert!(verdicts.statements[1].0 == verdicts.statements[1].1, "what a sends arrives");
}

/// An extern task may send to one of several receivers. The search tries one use of the port in each period, and no other
/// timings. So a statement that only other timings reach is not reported as superfluous, and a check that only other
/// timings decide is not reported as vacuous.
#[test]
fn a_task_outside_tells_one_of_several_and_may_come_at_other_times() {
    let takes = |name: &str| {
        format!(
            "task {name} on na\nuse_port go() usage = receive;\nvar n: int8;\nbegin\nloop receive go(); n := (n + 1) mod 3; end;\nend {name};\n"
        )
    };
    let head = "cell out;\ntick 1 msec;\nnode na;\n";
    let several = format!(
        "{head}task a on na extern rate = 1/10 msec\nport go() usage = send user_list = {{b, d}} time_out = 9 msec class = 1;\nend a;\n{}{}\
         check c: never b.n <> d.n;\n",
        takes("b"),
        takes("d")
    );
    let cell = Text::new(&several);
    assert_eq!(cell.found(&cell.check()), [found(Kind::Check, "")]);
    let between = format!(
        "{head}task a on na extern rate = 1/20 msec\nport go() usage = send user_list = {{b}} time_out = 4 msec class = 1;\nend a;\n\
         task b on na\nuse_port go() usage = receive;\nvar miss, got: bool;\nbegin\ndelay 8 msec;\n\
         loop miss := false; receive go() within 4 msec on time_out do miss := true; end;\n\
         if not miss then got := true; end; delay 16 msec; end;\nend b;\ncheck c: b.got leads b.miss within 30 msec;\n"
    );
    let cell = Text::new(&between);
    let verdicts = cell.check();
    assert_eq!(cell.found(&verdicts), []);
    assert_eq!(verdicts.not_tried.len(), 1, "{:?}", verdicts.not_tried);
}

/// The first statement that asks the extern task does not read the answer; the second statement does.
#[test]
fn a_task_outside_answers_in_the_format_that_any_statement_reads() {
    let text = "cell out;\ntick 1 msec;\nnode na;\ntype Num is record n: int8; end;\n\
        task a on na extern rate = 1/10 msec\nuse_port ask() -> Num usage = receive;\nend a;\n\
        task b on na\nport ask() -> Num usage = send user_list = {a} time_out = 30 msec class = 2;\n\
        var m: Num;\nbegin\nsend ask() on time_out do skip; end;\nsend ask() -> m on time_out do skip; end;\n\
        end b;\ncheck c: never b.m.n = 1;\n";
    let cell = Text::new(text);
    let said = cell.found(&cell.check());
    assert!(said.contains(&found(Kind::Check, "")), "{said:?}");
    assert!(said.iter().all(|(kind, _)| *kind != Kind::ScriptFault), "{said:?}");
}

/// An extern task may do anything next. So it is in no standstill, even if it asks again and again without an answer.
#[test]
fn a_task_outside_is_at_no_standstill() {
    let asks = |a: &str| {
        format!(
            "cell out;\ntick 1 msec;\nnode na;\ntask a on na {a}end a;\n\
             task b on na\nuse_port go() usage = receive;\nbegin\nreceive go();\nreply();\nloop delay 50 msec; end;\nend b;\n"
        )
    };
    let port = "port go() usage = send user_list = {b} time_out = 4 msec class = 2;\n";
    let still = |cell: &Text| cell.check().warnings.len();
    let inside =
        format!("\n{port}begin\nloop send go() on time_out do skip; end on refused do skip; end; end;\n");
    assert_eq!(still(&Text::new(&asks(&inside))), 1);
    assert_eq!(still(&Text::new(&asks(&format!("extern rate = 1/10 msec\n{port}")))), 0);
}

/// The values of extern tasks include the constants with which branches compare them. A branch that no tried value reaches
/// is not reported as superfluous.
#[test]
fn a_task_outside_says_what_others_ask_for() {
    let text = |condition: &str| {
        format!(
            "cell out;\ntick 1 msec;\nnode na;  node nb;\nlink na -- nb delay 1 msec;\n\
             type Num is record n: int8; k: int16; end;\n\
             task a on na\nport ask() -> Num usage = query user_list = {{b}} time_out = 20 msec class = 2;\n\
             var m: Num; var x: bool;\nbegin\n\
             loop query ask() -> m on time_out do m.n := 0; end; if {condition} then x := true; end; delay 30 msec; end;\n\
             end a;\n\
             task b on nb extern rate = 1/10 msec\nuse_port ask() -> Num usage = response;\nend b;\ncheck c: never a.x;\n"
        )
    };
    let checked = |condition: &str| Text::new(&text(condition)).check();
    let reached = checked("m.n = 7");
    assert!(reached.findings.iter().any(|finding| finding.kind == Kind::Check), "{:?}", reached.findings);
    assert_eq!(reached.outside.whole[..3], [0, 1, 7]);
    let beyond = checked("m.n > 9 and m.n < 12 and m.k < 5");
    assert!(beyond.findings.iter().all(|finding| finding.kind == Kind::TimeOut), "{:?}", beyond.findings);
    let [(task, _)] = beyond.not_tried[..] else { panic!("{:?}", beyond.not_tried) };
    assert_eq!(task.index(), 0);
    // If a value is compared with a constant by order, the neighbours of that constant are tried, too.
    let beside = checked("m.n > 9 and m.n < 12");
    assert!(beside.findings.iter().any(|finding| finding.kind == Kind::Check), "{:?}", beside.findings);
    assert_eq!(
        (&beside.outside.whole[..], &beside.outside.left_out[..]),
        (&[0, 1, 9, 12, 8, 10, 11, 13][..], &[][..])
    );
    assert!(beside.outside.real.is_empty());
}

/// The reals that are tried for an extern task: constants, and the adjacent floats on both sides.
#[test]
fn reals_of_a_task_outside_come_on_both_sides_of_what_they_are_compared_with() {
    let checked = |condition: &str| {
        let text = format!(
            "cell out;\ntick 1 msec;\nnode na;  node nb;\nlink na -- nb delay 1 msec;\n\
             task a on na\nuse_port height(h: real) usage = receive;\nvar h: real; var x: bool;\nbegin\n\
             loop receive height(h); if {condition} then x := true; end; end;\nend a;\n\
             task b on nb extern rate = 1/10 msec\n\
             port height(h: real) usage = send user_list = {{a}} time_out = 20 msec class = 1;\nend b;\n\
             check c: never a.x;\n"
        );
        Text::new(&text).check()
    };
    for reached in ["h > 2.5", "h < 2.5 and h > 2.4", "h = 2.5", "h = 1.0"] {
        let verdicts = checked(reached);
        assert!(verdicts.findings.iter().any(|finding| finding.kind == Kind::Check), "{reached}");
    }
    let many: Vec<String> = (2..16).map(|n| format!("h = {n}.5")).collect();
    let tried = checked(&many.join(" or ")).outside;
    assert_eq!((tried.real.len(), &tried.real[..3]), (12, &[0.0, 1.0, 2.5][..]));
    assert_eq!(tried.real_left_out, [12.5, 13.5, 14.5, 15.5]);
}

/// The communication task sends heartbeats by itself: an extern task does not use their port. The extern task takes over as
/// any other task does, and goes on when it has the lease again.
#[test]
fn a_task_outside_takes_over_and_leaves_the_heartbeats_alone() {
    let text = "cell out;\ntick 1 msec;\nnode na; node nb; node nc;\n\
        link na -- nb delay 1 msec; link na -- nc delay 1 msec; link nb -- nc delay 1 msec;\n\
        task first on na extern rate = 1/40 msec\n\
        port alive(n: int8) usage = response user_list = {second} time_out = 8 msec class = 2;\n\
        port weld() usage = send user_list = {gun} time_out = 10 msec class = 2;\nend first;\n\
        task second on nb standby of first extern rate = 1/40 msec\n\
        use_port alive(n: int8) usage = query;\n\
        port reweld() usage = send user_list = {gun} time_out = 10 msec class = 2;\nend second;\n\
        task gun on nc\nuse_port weld() usage = receive; use_port reweld() usage = receive;\n\
        var new: bool;\nbegin\n\
        on receive weld() do reply(); end;\non receive reweld() do new := true; reply(); end;\n\
        order reweld > weld > self;\nloop delay 50 msec; end;\nend gun;\n\
        couple work first -> second lease 20 msec takeover 35 msec every 5 msec via alive;\n\
        faults pause first up to 60 msec;\n\
        check by_one: never gun.new;\n";
    let mut cell = Text::new(text);
    cell.plan.times = Times::Ends;
    cell.plan.budget = within(20_000);
    let verdicts = cell.check();
    assert_eq!(verdicts.of(Kind::ScriptFault).count(), 0, "{:?}", verdicts.findings);
    assert_eq!(verdicts.of(Kind::TwoOwners).count(), 0);
    // The second task acts only while the first one is paused, so the finding needs a fault.
    let check = verdicts.of(Kind::Check).next().expect("the second one welds");
    assert_eq!(check.phase, Phase::Faults);
}
