//! Tests with a slow or stopped reader of a run's output, or a full disk for its log. The run must go on, inject its faults,
//! obey signals, stop its nodes in order, and report how many lines are missing.

use crate::support::live::released;
use crate::support::{
    PATIENCE, Said, excused, imrs, is_alive, run_in, runtime_dir, side_by_side, signal, sooner_or_later,
    wait_until,
};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::process::Signal;
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// A cell of two tasks that meet for ever. If the pipe is full, no line about the meetings can be written.
const MEETS: &str = "\
cell meets;
tick 1 msec;
node na;  node nb;
link na -- nb delay 1 msec;
task a on na
  port meet()  usage = waitfor  user_list = {b}  time_out = 2 sec  class = 2  retry = 8  resend = 20 msec;
  var missed: int16;
begin
  loop
    run grip takes 10..20 msec;
    waitfor meet() on time_out do missed := missed + 1; end;
  end;
end a;
task b on nb
  use_port meet()  usage = waitfor  time_out = 2 sec;
  var missed: int16;
begin
  loop
    waitfor meet() on time_out do missed := missed + 1; end;
  end;
end b;
";

struct Bench(tempfile::TempDir);

/// A run whose output goes to a stream of the test.
struct Running {
    child: Child,
    /// An instant before the start of the run.
    started: Instant,
}

impl Bench {
    fn new() -> Self {
        let bench = Self(runtime_dir());
        std::fs::write(bench.cell(), MEETS).expect("the cell is written");
        bench
    }

    fn cell(&self) -> PathBuf {
        self.0.path().join("meets.cell")
    }

    fn start(&self, args: &[&str], out: impl Into<Stdio>, err: impl Into<Stdio>) -> Running {
        let cell = self.cell();
        let mut command = imrs(self.0.path(), &[&["run", cell.to_str().expect("UTF-8")], args].concat());
        let started = Instant::now();
        let child = command.stdout(out).stderr(err).spawn().expect("it starts");
        Running { child, started }
    }

    /// Waits until both tasks have met once.
    fn until_they_met(&self) {
        wait_until("they meet", || {
            let said = run_in(self.0.path(), &["monitor", "--once", "--format", "json"]);
            said.code != Some(3) && released(&said.last_json(), "a") >= 1
        });
    }
}

impl Running {
    /// The processes of the nodes that still run.
    fn nodes(&self) -> Vec<u32> {
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.child.id())).into_iter().flatten();
        let of = |thread: std::fs::DirEntry| std::fs::read_to_string(thread.path().join("children")).ok();
        let all: String = threads.flatten().filter_map(of).collect();
        all.split_whitespace().filter_map(|pid| pid.parse().ok()).filter(|&pid| is_alive(pid)).collect()
    }

    /// Waits for the end of the run. Also returns how long it took.
    fn finish(mut self) -> (Said, Duration) {
        let mut err = String::new();
        if let Some(mut pipe) = self.child.stderr.take() {
            pipe.read_to_string(&mut err).expect("text");
        }
        let end = Instant::now() + PATIENCE;
        let code = loop {
            if let Some(status) = self.child.try_wait().expect("a process") {
                break status.code();
            }
            assert!(Instant::now() < end, "it does not end");
            std::thread::sleep(Duration::from_millis(10));
        };
        (Said { out: String::new(), err, code }, self.started.elapsed())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A full pipe whose reader does not read.
fn full_pipe() -> (io::PipeReader, io::PipeWriter) {
    let (reader, mut writer) = io::pipe().expect("a pipe");
    let flags = fcntl_getfl(writer.as_fd()).expect("flags");
    fcntl_setfl(writer.as_fd(), flags | OFlags::NONBLOCK).expect("flags");
    while writer.write(b"filled by the test\n").is_ok() {}
    while writer.write(b"\n").is_ok() {}
    fcntl_setfl(writer.as_fd(), flags).expect("flags");
    (reader, writer)
}

#[test]
fn a_run_ends_in_time_though_nobody_reads_what_it_says() {
    side_by_side([&[][..], &["--in-process"], &["--format", "json"]], |how: &[&str]| {
        let bench = Bench::new();
        let (_reader, writer) = full_pipe();
        let run = bench.start(&[&["--for", "2s"], how].concat(), writer, Stdio::piped());
        let (said, took) = run.finish();
        assert_eq!(said.code, Some(0), "{said:?}");
        assert!(said.err.contains("of the answer were not read, and are left out"), "{said:?}");
        // The run takes two seconds of work, and waits five seconds for the reader.
        assert!(took >= Duration::from_secs(7), "{took:?}");
    });
}

#[test]
fn faults_come_and_ctrl_c_is_obeyed_though_nobody_reads() {
    sooner_or_later("a fault came, but its summary was not read", |killed_after| {
        let bench = Bench::new();
        let (mut reader, writer) = full_pipe();
        let kill = format!("nb@{}s", killed_after.as_secs());
        let run = bench.start(&["--kill", &kill], writer, Stdio::piped());
        let mut are_there = false;
        wait_until("both nodes are there, or one may be killed", || {
            are_there |= run.nodes().len() == 2;
            are_there || run.started.elapsed() >= killed_after
        });
        if !are_there {
            return false;
        }
        wait_until("one is killed", || run.nodes().len() == 1);
        let left = run.nodes();
        signal(run.child.id(), Signal::INT);
        wait_until("the other is stopped", || {
            run.nodes().is_empty() && !left.iter().any(|&pid| is_alive(pid))
        });
        // Now the test reads the pipe. The output contains the summary, because the summary has waited for its reader.
        let mut out = String::new();
        reader.read_to_string(&mut out).expect("text");
        let (said, _) = run.finish();
        assert_eq!(said.code, Some(0), "{said:?}");
        // The launcher waits five seconds for its reader, but this test may be suspended for longer.
        if said.err.contains("not read") {
            excused("the reader of the summary came too late");
            return false;
        }
        assert!(out.contains("fault: node nb is killed") && out.contains("node nb   killed"), "{out}");
        true
    });
}

#[test]
fn a_second_ctrl_c_ends_the_wait_for_the_reader() {
    let bench = Bench::new();
    let (_reader, writer) = full_pipe();
    let run = bench.start(&[], writer, Stdio::piped());
    bench.until_they_met();
    let nodes = run.nodes();
    signal(run.child.id(), Signal::INT);
    wait_until("the nodes are stopped", || !nodes.iter().any(|&pid| is_alive(pid)));
    signal(run.child.id(), Signal::INT);
    let (said, _) = run.finish();
    // On a busy machine reports of the nodes are still in their pipes, so evidence is missing.
    assert!(matches!(said.code, Some(0 | 5)), "{said:?}");
}

#[test]
fn a_full_disk_ends_no_run_and_is_told() {
    let full = || File::options().write(true).open("/dev/full").expect("a device");
    side_by_side([&[][..], &["--format", "json"]], |how: &[&str]| {
        let bench = Bench::new();
        let run = bench.start(&[&["--for", "2s"], how].concat(), full(), Stdio::piped());
        let (said, took) = run.finish();
        assert!(took >= Duration::from_secs(2), "{took:?}: {said:?}");
        assert_eq!(said.code, Some(2), "{said:?}");
        let line = said.err.lines().last().expect("a complaint");
        assert!(line.starts_with("imrs: cannot write the answer: No space left"), "{said:?}");
        assert!(!said.err.contains("node `"), "the nodes were stopped in order: {said:?}");
    });
}

#[test]
fn nobody_waits_for_who_reads_the_complaints() {
    side_by_side([&[][..], &["--in-process"]], |how: &[&str]| {
        let bench = Bench::new();
        // This file cannot be executed, so the node complains about it.
        let gripper = bench.0.path().join("gripper");
        std::fs::write(&gripper, "no program").expect("a file");
        let action = format!("grip={}", gripper.display());
        let ((_out, to_out), (_err, to_err)) = (full_pipe(), full_pipe());
        let run = bench.start(&[&["--action", &action, "--for", "4s"], how].concat(), to_out, to_err);
        let (said, took) = run.finish();
        // The failed action is the finding. The run still went on to its end.
        assert_eq!(said.code, Some(1), "{said:?}");
        assert!(took >= Duration::from_secs(4), "{took:?}");
    });
}
