//! A program without `std` around the protocol, as a robot's controller would have it: its own panic handler and its own
//! allocator. It builds only while neither the protocol nor a library under it links `std`, whose panic handler would be
//! a second one.
#![no_std]

use core::alloc::{GlobalAlloc, Layout};
use core::panic::PanicInfo;
use imrs_protocol::{CommTask, Input, NodeTable, Outbox, Packet, Signal, Ticks, TimeId};

struct Nowhere;

// SAFETY: this allocator returns no memory at all, which the contract of an allocator permits.
unsafe impl GlobalAlloc for Nowhere {
    unsafe fn alloc(&self, _: Layout) -> *mut u8 {
        core::ptr::null_mut()
    }
    unsafe fn dealloc(&self, _: *mut u8, _: Layout) {}
}

#[global_allocator]
static ALLOCATOR: Nowhere = Nowhere;

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {
        core::hint::spin_loop();
    }
}

struct Silence;

impl Outbox for Silence {
    fn transmit(&mut self, _: Packet) {}
    fn signal(&mut self, _: Signal) {}
    fn arm(&mut self, _: TimeId, _: u8, _: Ticks) {}
    fn disarm(&mut self, _: TimeId) {}
}

/// Lets a tick pass: a call of the state machine, so that its code is compiled into this program.
pub fn tick(task: &mut CommTask, table: &NodeTable) {
    task.handle(table, task.now() + Ticks(1), &Input::Time, &mut Silence);
}
