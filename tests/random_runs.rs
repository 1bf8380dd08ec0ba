//! Runs random cells on the real runtime. With real threads and clocks, each run must still be a path of the model.
//! The cells are those with which the search is tested (`model/tests/guard`).

#[path = "../model/tests/guard/cells.rs"]
#[expect(dead_code, reason = "bodies for tasks outside are of the checker's own tests")]
mod cells;
#[path = "../model/tests/guard/statements.rs"]
mod statements;

use crate::support::{bound, excused, run_in, runtime_dir};
use imrs_language::{Source, Unit, compile};
use std::path::Path;

/// The number of random bytes from which a cell is generated.
const TAPE: usize = 300;

fn tape(seed: u64) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut byte = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state.to_le_bytes()[4]
    };
    (0..TAPE).map(|_| byte()).collect()
}

/// The random cell of a seed; `None` if the compiler rejects it, or if it has an extern task.
fn random_cell(seed: u64) -> Option<String> {
    let text = cells::cell(&tape(seed));
    if text.contains(" extern") {
        return None;
    }
    let source = Source::new(text.as_bytes()).ok()?;
    compile(&source).lower(Unit::Ticks).map(|_| text)
}

/// The recordings of a run, one for each node.
fn recordings(folder: &Path) -> Vec<String> {
    let files = std::fs::read_dir(folder).expect("the folder").flatten().map(|entry| entry.path());
    let mut files: Vec<String> = files
        .filter(|path| path.extension().is_some_and(|extension| extension == "imrs"))
        .map(|path| path.to_str().expect("UTF-8").to_owned())
        .collect();
    files.sort();
    files
}

/// Runs `IMRS_RANDOM_RUNS` cells, beginning with seed `IMRS_SEED`.
#[test]
fn runs_of_random_cells_are_paths_of_the_model() {
    let (first, number) = (bound("IMRS_SEED", 1), bound("IMRS_RANDOM_RUNS", 4));
    let (mut paths, mut late, mut inputs) = (0, 0, 0);
    let cells = (first..).filter_map(|seed| Some((seed, random_cell(seed)?)));
    for (seed, text) in cells.take(usize::try_from(number).expect("a few")) {
        let folder = runtime_dir();
        let at = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
        let cell = at("random.cell");
        std::fs::write(&cell, &text).expect("the cell is written");
        let how =
            ["run", &cell, "--in-process", "--for", "500ms", "--seed", "1", "--record", &at("run.imrs")];
        let said = run_in(folder.path(), &how);
        // A task of a random cell may abort, and a check may be broken.
        assert!(matches!(said.code, Some(0 | 1 | 5)), "seed {seed}: {said:?}\n{text}");
        let files = recordings(folder.path());
        let files: Vec<&str> = files.iter().map(String::as_str).collect();
        let how = ["--cell", &cell, "--model", "--within", "300s", "--format", "json"];
        let said = run_in(folder.path(), &[&["replay"], &files[..], &how[..]].concat());
        let told = said.last_json();
        match said.code {
            Some(1 | 4 | 5) if told["path"] != true && told["complete"] == false => late += 1,
            // A packet took longer than the bound of its link, and then the model promises nothing.
            _ if told["within_assumptions"] == false => late += 1,
            Some(0 | 1 | 5) if told["path"] == true => paths += 1,
            _ => panic!("seed {seed}: {said:?}\n{text}"),
        }
        inputs += told["inputs"].as_u64().unwrap_or(0);
    }
    println!("{paths} runs are paths of the model, of {late} nobody knows; {inputs} inputs");
    if late > 0 {
        excused(&format!("of {late} of {number} random runs nobody knows whether they are paths"));
    }
}
