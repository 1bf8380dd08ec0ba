//! Tests that secret files stay secret, and that existing files are not overwritten by accident.

use crate::support::{example, run_in, runtime_dir};
use std::fs::Permissions;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;

fn mode(path: &Path) -> u32 {
    path.metadata().expect("it is there").mode() & 0o777
}

#[test]
fn a_token_that_others_can_read_is_refused() {
    let folder = runtime_dir();
    let token = folder.path().join("token");
    std::fs::write(&token, "0123456789abcdef\n").expect("written");
    let name = token.to_str().expect("UTF-8");
    let cell = example("beam_lift.cell");
    let run = ["run", &cell, "--for", "100ms", "--observe", "127.0.0.1:0", "--observe-token", name];
    let monitor = ["monitor", "--once", "--connect", "tcp:127.0.0.1:1", "--token", name];
    for (mode, is_refused) in [(0o644, true), (0o640, true), (0o604, true), (0o600, false), (0o400, false)] {
        std::fs::set_permissions(&token, Permissions::from_mode(mode)).expect("changed");
        for args in [&run[..], &monitor] {
            let said = run_in(folder.path(), args);
            let refused = said.code == Some(2) && said.err.contains("chmod 600");
            assert_eq!(refused, is_refused, "{mode:o} {said:?}");
        }
    }
}

#[test]
fn a_run_does_not_write_over_recordings_unasked() {
    let folder = runtime_dir();
    let at = |name: &str| folder.path().join(name);
    let file = at("run.imrs").to_str().expect("UTF-8").to_owned();
    let cell = example("beam_lift.cell");
    let run = ["run", &cell, "--in-process", "--for", "200ms", "--seed", "1", "--record", &file];
    let recordings = ["nl", "nr", "nh"].map(|node| at(&format!("run.{node}.imrs")));
    assert!(matches!(run_in(folder.path(), &run).code, Some(0 | 1 | 5)));
    assert!(recordings.iter().all(|path| mode(path) == 0o600), "others can read what was recorded");
    let before = std::fs::read(&recordings[0]).expect("recorded");
    let said = run_in(folder.path(), &run);
    assert_eq!(said.code, Some(2), "{said:?}");
    assert!(said.err.contains("run.nl.imrs") && said.err.contains("--force"), "{said:?}");
    assert_eq!(std::fs::read(&recordings[0]).expect("recorded"), before);
    let forced = run_in(folder.path(), &[&run[..], &["--force"]].concat());
    assert!(matches!(forced.code, Some(0 | 1 | 5)), "{forced:?}");
    assert_ne!(std::fs::read(&recordings[0]).expect("recorded"), before);
}

#[test]
fn no_verb_writes_over_a_file_unasked() {
    let folder = runtime_dir();
    let at = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let (film, faulty) = (at("film.imrs"), example("faulty/feeder_and_press_wait_for_each_other.cell"));
    assert_eq!(run_in(folder.path(), &["verify", &faulty, "--save", &film]).code, Some(1));
    let verbs = [
        (&["verify", &faulty, "--save"][..], 1),
        (&["verify", &faulty, "--trace"], 1),
        (&["simulate", &faulty, "--seed", "1", "--seeds", "20", "--save"], 1),
        (&["export", &film, "--to", "jsonl", "--out"], 0),
    ];
    for (number, (verb, code)) in verbs.into_iter().enumerate() {
        let path = at(&format!("written-{number}"));
        let run = |more: &[&str]| run_in(folder.path(), &[verb, &[&path], more].concat());
        assert_eq!(run(&[]).code, Some(code), "{verb:?}");
        assert_eq!(mode(Path::new(&path)), 0o600, "{verb:?}");
        std::fs::write(&path, "somebody's").expect("written");
        let refused = run(&[]);
        let said =
            format!("{path}: there is a file of this name: name another one, or give --force to replace it");
        assert!(refused.code == Some(2) && refused.out.is_empty(), "{refused:?}");
        assert!(refused.err.contains(&said), "{refused:?}");
        assert_eq!(std::fs::read_to_string(&path).expect("text"), "somebody's");
        assert_eq!(run(&["--force"]).code, Some(code), "{verb:?}");
        assert_ne!(std::fs::read(&path).expect("written"), b"somebody's", "{verb:?}");
    }
}

#[test]
fn findings_and_what_monitors_saw_are_kept_unless_told_otherwise() {
    let folder = runtime_dir();
    let at = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let (found, seen) = (at("found.imrs"), at("seen.imrs"));
    let faulty = example("faulty/feeder_and_press_wait_for_each_other.cell");
    let verify = ["verify", &faulty, "--save", &found];
    let monitor = ["monitor", "--for", "100ms", "--record", &seen];
    assert_eq!(run_in(folder.path(), &verify).code, Some(1));
    assert_eq!(mode(Path::new(&found)), 0o600);
    std::fs::write(&seen, "somebody's").expect("written");
    for args in [&verify[..], &monitor] {
        let said = run_in(folder.path(), args);
        assert!(said.code == Some(2) && said.err.contains("--force"), "{said:?}");
    }
    assert_eq!(std::fs::read_to_string(&seen).expect("text"), "somebody's");
    let forced = run_in(folder.path(), &[&verify[..], &["--force"]].concat());
    assert_eq!(forced.code, Some(1), "{forced:?}");
}
