//! Tasks without a branch for a bad outcome: the reason for which such a task ends names the statement and its line.

use super::{begun, whole};
use imrs_language::Unit;
use imrs_language::lower::Behaviour;

#[test]
fn a_reason_names_the_statement_and_its_line() {
    let text = "cell c; tick 1 msec; node na; node nb; link na -- nb delay 1 msec;
task a on na
  port q() usage = query user_list = {b} time_out = 20 msec;
begin
  run grip takes 1..2 msec;
  query q();
end a;
task b on nb use_port q() usage = response; begin delay 1 sec; receive q(); response(); end b;
";
    let lowered = whole(text).lower(Unit::Ticks).expect("a whole cell");
    let Behaviour::Script(script) = &lowered.tasks[0] else { panic!("a script") };
    assert_eq!(
        script.program.reasons,
        ["failure of `grip`, line 5", "time_out of `q`, line 6", "refusal of `q`, line 6"]
    );
    let mut virtual_cell = begun(&lowered);
    virtual_cell.run(30);
    assert_eq!(virtual_cell.log(), ["0 a: grip", "21 a: ended Aborted(1)"]);
}
