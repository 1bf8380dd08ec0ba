//! A task written as a future: a gripper that closes until its force sensor or a message of another task stops it, whichever
//! comes first. The sensor has a driver with a thread of its own; the future waits for both.
//!
//! `cargo run --example futures`

use futures_util::future::{Either, select};
use futures_util::task::AtomicWaker;
use imrs_runtime::{Asked, AsyncContext, Context, TaskEnd, TaskError};
use std::future::poll_fn;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::task::Poll;
use std::thread;
use std::time::Duration;

mod cell {
    imrs_macros::cell!("examples/futures/grip.cell");
}
use cell::{Hold, ports};

/// The force that holds a part, in newtons.
const FIRM: u32 = 40;

/// The last measurement of the sensor's driver, and the waker of the task that waits for it. Any source that calls a
/// waker works like this.
#[derive(Default)]
struct Force {
    newtons: AtomicU32,
    waiting: AtomicWaker,
}

impl Force {
    /// Closes the fingers on a part that resists with this many newtons.
    fn squeeze(self: &Arc<Self>, part: u32) {
        let force = Arc::clone(self);
        thread::spawn(move || {
            for newtons in 0..=part {
                force.newtons.store(newtons, Ordering::Release);
                force.waiting.wake();
                thread::sleep(Duration::from_millis(1));
            }
        });
    }

    /// Waits until the fingers press with this force.
    async fn reaches(&self, newtons: u32) {
        poll_fn(|poller| {
            self.waiting.register(poller.waker());
            if self.newtons.load(Ordering::Acquire) >= newtons { Poll::Ready(()) } else { Poll::Pending }
        })
        .await;
    }
}

async fn gripper(mut ctx: AsyncContext, parts: [u32; 2]) -> Result<(), TaskError> {
    for part in parts {
        let Some(asked) = ctx.take::<()>(ports::CLOSE, None).await? else { continue };
        let force = Arc::new(Force::default());
        force.squeeze(part);
        // The other future is dropped: that cancels the wait for `halt`, and loses no message.
        let held = match select(pin!(force.reaches(FIRM)), pin!(ctx.receive(Some(ports::HALT), None))).await {
            Either::Left(((), _)) => true,
            Either::Right((halted, _)) => halted.map(|_| false)?,
        };
        ctx.answer(&asked.from, &Hold { held })?;
    }
    Ok(())
}

/// A thread queries a future like any other task. The second part is too soft to be held, and then a person reaches in.
fn pendant(ctx: &mut Context) -> Result<(), TaskError> {
    for expected in [true, false] {
        if !expected {
            ctx.tell(ports::ENTER, &())?;
        }
        match ctx.query::<(), Hold>(ports::CLOSE, &())? {
            Asked::Reply(Hold { held }) => {
                println!("{}", if held { "the part is held" } else { "a person reached in" });
                assert_eq!(held, expected);
            }
            Asked::Refused | Asked::TimedOutUnsent => println!("the gripper was not asked"),
            Asked::TimedOutUnknown | Asked::PeerRestarted => println!("it is unknown what it holds"),
        }
    }
    Ok(())
}

async fn curtain(mut ctx: AsyncContext) -> Result<(), TaskError> {
    if ctx.receive(Some(ports::ENTER), None).await?.is_some() {
        ctx.delay(Duration::from_millis(60)).await?;
        ctx.tell(ports::HALT, &())?;
    }
    Ok(())
}

/// Runs the cell until its tasks have ended.
pub fn main() {
    let node = cell::builder(cell::nodes::HERE)
        .async_task("gripper", |ctx| gripper(ctx, [2 * FIRM, FIRM / 2]))
        .async_task("curtain", curtain)
        .task("pendant", pendant)
        .start()
        .expect("a node that starts");
    assert!(node.wait(Duration::from_secs(60)), "the programs have ended");
    for (task, end) in node.stop(Duration::from_secs(1)) {
        assert_eq!(end, TaskEnd::Returned, "{task}");
    }
}
