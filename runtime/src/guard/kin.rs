//! Ends a command with all that it started.

use rustix::io::Errno;
use rustix::process::{
    Pid, PidfdFlags, Signal, WaitOptions, WaitStatus, getpid, kill_process_group, pidfd_open,
    pidfd_send_signal, wait,
};
use std::collections::BTreeMap;
use std::fs;

/// Kills the process group of the command and every other descendant of this process, and waits until none remains. Returns how
/// the command itself ended. This process must be a child subreaper, so that no descendant can leave it.
pub fn end_all(command: Pid) -> Option<WaitStatus> {
    // The command has not been reaped yet, so no other process group can have its number.
    let _ = kill_process_group(command, Signal::KILL);
    let mut status = None;
    let mut options = WaitOptions::NOHANG;
    loop {
        match wait(options) {
            Ok(Some((pid, how))) => {
                if pid == command {
                    status = Some(how);
                }
                options = WaitOptions::NOHANG;
            }
            // A descendant of this process remains. The children of a killed process become children of this process,
            // so the end of each of them ends the wait.
            Ok(None) => {
                kill_descendants();
                options = WaitOptions::empty();
            }
            Err(Errno::INTR) => {}
            // This process has no child left, so the command has no descendant left.
            Err(_) => return status,
        }
    }
}

/// Kills every descendant that exists now.
fn kill_descendants() {
    let own = getpid().as_raw_nonzero().get();
    let parents = parents();
    for (&pid, &parent) in parents.iter().filter(|&(&pid, _)| descends(&parents, pid, own)) {
        let Some(process) = Pid::from_raw(pid) else { continue };
        let Ok(handle) = pidfd_open(process, PidfdFlags::empty()) else { continue };
        // The process id may belong to another process by now. That process has another parent, too.
        if parent_of(pid).is_some_and(|now| now == parent || now == own) {
            // The kill fails if the process has already ended, or now belongs to another user.
            let _ = pidfd_send_signal(&handle, Signal::KILL);
        }
    }
}

fn descends(parents: &BTreeMap<i32, i32>, mut pid: i32, from: i32) -> bool {
    // The table of parents may have changed while it was read, and so may contain a cycle.
    for _ in 0..parents.len() {
        match parents.get(&pid) {
            Some(&parent) if parent == from => return true,
            Some(&parent) => pid = parent,
            None => return false,
        }
    }
    false
}

/// All processes, each with its parent.
fn parents() -> BTreeMap<i32, i32> {
    let entries = fs::read_dir("/proc").into_iter().flatten().flatten();
    let pids = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    pids.filter_map(|pid| Some((pid, parent_of(pid)?))).collect()
}

/// The parent of a process; `None` if there is no such process.
pub fn parent_of(pid: i32) -> Option<i32> {
    let stat = fs::read(format!("/proc/{pid}/stat")).ok()?;
    // A process's name may contain any characters, even parentheses; the state and the parent follow the name.
    let stat = String::from_utf8_lossy(&stat);
    let (_, rest) = stat.rsplit_once(')')?;
    rest.split_whitespace().nth(1)?.parse().ok()
}
