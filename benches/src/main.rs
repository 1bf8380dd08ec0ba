//! The measurements as a program of their own. This program also measures memory and, with `--features
//! peers,network-peers`, the libraries that people would use instead.

use clap::Parser;
use imrs_bench::{BenchArgs, BenchError, Verdict, memory, run};
use std::alloc::{GlobalAlloc, Layout, System};
use std::io::{ErrorKind, Write};
use std::process::ExitCode;

/// Measure the runtime against floors and peers, in rounds.
#[derive(Debug, Parser)]
#[command(name = "imrs-bench", version)]
struct Cli {
    #[command(flatten)]
    bench: BenchArgs,
}

struct Counting;

// SAFETY: every call goes unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        memory::allocated(layout.size());
        // SAFETY: the caller keeps the contract of `alloc`, which is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        memory::freed(layout.size());
        // SAFETY: the caller keeps the contract of `dealloc`, which is the same.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        memory::freed(layout.size());
        memory::allocated(size);
        // SAFETY: the caller keeps the contract of `realloc`, which is the same.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn main() -> ExitCode {
    let mut out = std::io::stdout().lock();
    let mut say = |text: &str| match out.write_all(text.as_bytes()) {
        // The reader has closed the pipe; the page and the picture are written nevertheless.
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        said => said.map_err(BenchError::Output),
    };
    match run(&Cli::parse().bench, &mut say) {
        Ok(Verdict::Well) => ExitCode::SUCCESS,
        Ok(Verdict::Missed) => ExitCode::from(1),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}
