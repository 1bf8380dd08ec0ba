//! The process that becomes the command. It ties its end to that of its guard, gives up a node's real-time
//! privileges, and executes the program.

use super::words::Errand;
use rustix::process::{
    Pid, Signal, getppid, getpriority_process, set_parent_process_death_signal, setpriority_process,
};
use rustix::thread::{CpuSet, sched_setaffinity};
use std::io::{self, Write};
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitCode};
use thread_priority::unix::{set_thread_priority_and_policy, thread_native_id, thread_schedule_policy};
use thread_priority::{
    NormalThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
};

/// The beginning of the line that says why the program cannot be executed. No program writes this by accident.
pub const UNSTARTED: &[u8] = b"\0imrs-guard: ";
/// The exit code if the command's program does not exist; shells use the same one.
const NOT_FOUND: u8 = 127;
/// A priority that `thread-priority` maps to niceness 0.
const ORDINARY: u8 = 47;

/// Turns this process into the command. If that fails, writes the reason to standard output.
pub fn exec(errand: &Errand) -> ExitCode {
    let error = match tie(errand) {
        Ok(()) => become_it(errand),
        Err(error) => error,
    };
    let mut line = UNSTARTED.to_vec();
    line.extend(error.raw_os_error().unwrap_or_default().to_string().bytes());
    line.push(b'\n');
    // Writing fails only if the guard has ended, and then no process reads this line.
    let _ = io::stdout().write_all(&line);
    ExitCode::from(NOT_FOUND)
}

/// Ties this process, and the program that it becomes, to the guard: whatever ends the guard ends them.
fn tie(errand: &Errand) -> io::Result<()> {
    set_parent_process_death_signal(Some(Signal::KILL))?;
    // If the guard died before this call, the guard is no longer this process's parent, and the signal would never come.
    let guard = errand.parent.and_then(Pid::from_raw);
    if guard.is_none() || getppid() != guard {
        return Err(io::Error::from_raw_os_error(rustix::io::Errno::SRCH.raw_os_error()));
    }
    Ok(())
}

fn become_it(errand: &Errand) -> io::Error {
    be_ordinary(errand.cores.as_deref());
    match errand.command.split_first() {
        Some((program, arguments)) => Command::new(program).args(arguments).exec(),
        None => io::ErrorKind::InvalidInput.into(),
    }
}

/// Takes the real-time privileges from this process. A node under `--rt` runs under SCHED_FIFO on one core, and so
/// does its guard. The command runs under the ordinary scheduler, on the cores that the launcher had. Its memory is
/// not locked, because memory locks end when a program is executed.
fn be_ordinary(cores: Option<&str>) {
    if let Some(cores) = cores {
        let mut set = CpuSet::new();
        cores.split(',').filter_map(|core| core.parse().ok()).for_each(|core| {
            if core < CpuSet::MAX_CPU {
                set.set(core);
            }
        });
        // If a core of the launcher's list no longer exists, the process stays on its current cores.
        let _ = sched_setaffinity(None, &set);
    }
    let is_ordinary = matches!(thread_schedule_policy(), Ok(ThreadSchedulePolicy::Normal(_)));
    if is_ordinary {
        return;
    }
    // The call that sets the scheduler also changes the niceness, so the niceness is restored afterwards.
    let niceness = getpriority_process(None);
    if let Ok(ordinary) = ThreadPriorityValue::try_from(ORDINARY) {
        let policy = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);
        // Giving up a privilege is never refused, so the result is ignored.
        let _ = set_thread_priority_and_policy(
            thread_native_id(),
            ThreadPriority::Crossplatform(ordinary),
            policy,
        );
    }
    let _ = niceness.and_then(|niceness| setpriority_process(None, niceness));
}
