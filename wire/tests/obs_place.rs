//! Tests of socket paths: private folders, the search for sockets, and stale sockets.

use imrs_wire::obs::place::{
    MAX_PATH, PlaceError, pid_of, prepare_in, remove_if_stale, sockets_in, sockets_of,
};
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::net::UnixListener;

#[test]
fn sockets_of_all_cells_are_found_and_nothing_else() {
    let temp = tempfile::tempdir().unwrap();
    let base = temp.path().join("imrs");
    assert!(sockets_in(&base).unwrap().is_empty(), "a missing folder has none");
    let a = prepare_in(&base, "cell b", "left", 812).unwrap();
    let b = prepare_in(&base, "cell a", "right-arm", 7).unwrap();
    let _listeners = [&a, &b].map(|path| UnixListener::bind(path).unwrap());
    fs::write(a.with_file_name("notes.txt"), "").unwrap();
    assert_eq!(sockets_of(b.parent().unwrap()), std::slice::from_ref(&b));
    assert!(sockets_of(&base.join("none")).is_empty(), "a missing folder has none");
    assert_eq!(sockets_in(&base).unwrap(), [b.clone(), a]);
    assert_eq!(pid_of(&b), Some(7));
    let mode = fs::metadata(b.parent().unwrap()).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o700);
}

#[test]
fn a_folder_that_others_may_enter_is_refused() {
    let temp = tempfile::tempdir().unwrap();
    let base = temp.path().join("open");
    fs::create_dir(&base).unwrap();
    fs::set_permissions(&base, fs::Permissions::from_mode(0o755)).unwrap();
    assert!(matches!(prepare_in(&base, "c", "n", 1), Err(PlaceError::NotPrivate(p)) if p == base));
    let real = temp.path().join("real");
    fs::create_dir(&real).unwrap();
    fs::set_permissions(&real, fs::Permissions::from_mode(0o700)).unwrap();
    let link = temp.path().join("link");
    symlink(&real, &link).unwrap();
    assert!(matches!(prepare_in(&link, "c", "n", 1), Err(PlaceError::NotPrivate(_))));
}

#[test]
fn a_path_too_long_for_a_socket_is_refused_with_a_way_out() {
    let temp = tempfile::tempdir().unwrap();
    let base = temp.path().join("d".repeat(MAX_PATH));
    let error = prepare_in(&base, "c", "n", 1).unwrap_err();
    assert!(error.to_string().contains("XDG_RUNTIME_DIR"), "{error}");
}

#[test]
fn only_a_socket_that_nothing_can_be_behind_is_removed() {
    let temp = tempfile::tempdir().unwrap();
    let base = temp.path().join("imrs");
    let own = std::process::id();
    let live = prepare_in(&base, "c", "live", own).unwrap();
    let _listener = UnixListener::bind(&live).unwrap();
    let closed = prepare_in(&base, "c", "closed", own).unwrap();
    drop(UnixListener::bind(&closed).unwrap());
    // Linux never assigns a process id above 2^22.
    let dead = prepare_in(&base, "c", "dead", 4_194_305).unwrap();
    drop(UnixListener::bind(&dead).unwrap());
    assert!(!remove_if_stale(&live), "somebody listens");
    assert!(!remove_if_stale(&closed), "its process lives: it may be about to listen");
    assert!(remove_if_stale(&dead) && !dead.exists());
    assert!(!remove_if_stale(&dead), "gone already");
}
