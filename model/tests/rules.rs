//! Tests of the cells in `examples/rules`. Each states one rule of the system by its assertions and checks, which must
//! hold.
//!
//! A rule about something that goes wrong without a fault has a finding: `(* verify finds: .. *)`, as in `examples/faulty`.

use crate::cells::{Text, within};
use crate::faulty_cells::{all, comment, told};
use std::path::Path;

#[test]
fn each_rule_holds() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/rules");
    let mut rules = 0;
    for entry in std::fs::read_dir(folder).expect("the rules").flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if !name.ends_with(".cell") {
            continue;
        }
        let text = std::fs::read_to_string(entry.path()).expect("a cell file");
        assert!(text.contains("assert ") || text.contains("\ncheck "), "{name} says nothing");
        let finds = text.lines().take(2).find_map(|line| comment(line, "verify finds")).unwrap_or_default();
        let mut cell = Text::new(&text);
        cell.plan.budget = within(20_000);
        let verdicts = cell.check();
        assert!(verdicts.is_complete(), "{name}: {:?}", verdicts.phases);
        // An unreached statement is a finding, too, so this also shows that each assertion is reached.
        let found: Vec<String> = all(&verdicts).map(|finding| told(&cell, finding, finds)).collect();
        assert_eq!(found.join(", "), finds, "{name}");
        rules += 1;
    }
    assert!(rules >= 20, "{rules} rules");
}
