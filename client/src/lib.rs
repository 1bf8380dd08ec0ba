//! Runs nodes of a cell file in a robot's program, with Rust functions for the actions of their scripts and for their
//! `extern` tasks.
//!
//! A cell file declares the nodes of a cell, their tasks and ports, and all times. A task is a script in that file, or it is
//! `extern`: then a [`Program`] gives it a Rust function. `imrs check` and `imrs verify` check the same file before it runs.
//!
//! ```
//! use imrs_client::{Context, Program, TaskEnd, TaskError};
//! use std::time::Duration;
//!
//! const CELL: &str = r#"
//! cell vision;
//! tick 1 msec;
//! node nc at "127.0.0.1" port 7411;
//! node np at "127.0.0.1" port 7412;
//! link nc -- np delay 1 msec;
//!
//! task camera on nc extern
//!   port part(x: int16) usage = send user_list = {pick} time_out = 10 sec class = 2;
//! end camera;
//!
//! task pick on np
//!   use_port part(x: int16) usage = receive;
//!   var x: int16;
//! begin
//!   receive part(x);
//!   reply();
//!   run pick_at x takes 20..60 msec;
//! end pick;
//! "#;
//!
//! /// The program of the task `camera`: tells the robot where a part lies, in millimetres.
//! fn camera(ctx: &mut Context) -> Result<(), TaskError> {
//!     let part = ctx.port("part")?;
//!     // A message is the bytes of its fields, one after the other, little endian.
//!     let heard = ctx.send(part, &120_i16.to_le_bytes())?;
//!     assert!(heard.reply().is_some(), "the robot answers");
//!     Ok(())
//! }
//!
//! # fn main() -> Result<(), imrs_client::ProgramError> {
//! let ends = Program::of_text("vision.cell", CELL)?
//!     .task("camera", camera)
//!     .action("pick_at", |call| {
//!         println!("{} picks the part at {} mm", call.task, call.arguments[0]);
//!         Ok(0)
//!     })
//!     .run(Some(Duration::from_secs(60)))?;
//! assert_eq!(ends[0], ("camera".to_owned(), TaskEnd::Returned));
//! # assert!(matches!(ends[1].1, TaskEnd::Script(_)), "{ends:?}");
//! # Ok(())
//! # }
//! ```
//!
//! Both nodes run as threads of that program. On the robots each program runs one node: [`node("nc")`](Program::node),
//! over UDP at the address in the cell. A node of scripts alone needs no program: `imrs run vision.cell --node np`.
//! Both take the keys that `imrs keygen vision.cell` makes beside the cell file, so that no other process can read or
//! forge what they send.
//!
//! # Which crate to link
//!
//! | a program that | links |
//! |---|---|
//! | reads a cell file when it starts | `imrs-client` |
//! | has its cell compiled in, with types for its messages | `imrs-runtime` and `imrs-macros` |
//! | checks, shows or replays cells | no crate: it starts the command `imrs` |
//!
//! This crate brings the compiler of the cell language and the runtime, and no model checker, terminal or command-line
//! parser. The package `imrs`, which is the command, re-exports this whole crate. The types of `imrs-runtime` are the
//! same in both crates: a program may link `imrs-runtime` too, for futures, handlers and typed messages.
//!
//! # Units
//!
//! Lengths of time are [`Duration`](std::time::Duration)s here; in the cell file they have a unit. The arguments and results
//! of actions are whole numbers in the units of the cell. A `real` is passed as its 32 bits ([`f32::to_bits`]), and a `bool` as
//! the number 0 or 1. Messages are bytes: the fields of the port's format one after the other, little endian, without padding.
//!
//! # Errors
//!
//! [`Program::run`] returns a [`ProgramError`] if nothing could be started. Once the nodes run, a task that fails or panics
//! ends alone, and its [`TaskEnd`] says how. A call of a [`Context`] that cannot be carried out is a [`TaskError`]: pass it on
//! with `?`. That a message was not answered in time is no error but a value: [`Sent`] or [`Rendezvous`].
//!
//! Linux only. It is no safety function.

#![forbid(unsafe_code)]

#[doc(hidden)]
pub mod cell_file;
#[doc(hidden)]
pub mod cells;
mod error;
#[doc(hidden)]
pub mod incarnation;
#[doc(hidden)]
pub mod keys;
#[doc(hidden)]
pub mod place;
mod program;

pub use error::{PlaceError, ProgramError};
pub use program::Program;

/// The argument with which a [`Program`] calls its function for an action.
#[doc(inline)]
pub use imrs_runtime::script::Call;

/// The argument with which a [`Program`] calls its function for an extern task: the task's ports, and everything that a
/// script can do with them.
#[doc(inline)]
pub use imrs_runtime::Context;

/// The argument with which a [`Program`] calls its function for an extern task if that function is a future. It has the
/// calls of [`Context`]; a call that waits is awaited. The futures of a node share one thread.
#[doc(inline)]
pub use imrs_runtime::AsyncContext;

/// The result of [`Context::waitfor`].
///
/// ```
/// use imrs_client::{Context, Program, Rendezvous, TaskEnd, TaskError};
///
/// fn left(ctx: &mut Context) -> Result<(), TaskError> {
///     let lift = ctx.port("lift")?;
///     match ctx.waitfor(lift)? {
///         Rendezvous::Released { .. } => println!("both lift"),
///         Rendezvous::GaveUp { .. } => println!("the other arm did not come in time: neither arm lifts"),
///     }
///     Ok(())
/// }
///
/// # fn main() -> Result<(), imrs_client::ProgramError> {
/// const CELL: &str = "cell carry;
/// tick 1 msec;
/// node here;
/// task left on here extern
///   port lift() usage = waitfor user_list = {right} time_out = 500 msec;
/// end left;
/// task right on here
///   use_port lift() usage = waitfor;
/// begin
///   waitfor lift() on time_out do abort \"the left arm did not come\"; end;
/// end right;
/// ";
/// let ends = Program::of_text("carry.cell", CELL)?.task("left", left).run(None)?;
/// assert_eq!(ends[0], ("left".to_owned(), TaskEnd::Returned));
/// # Ok(())
/// # }
/// ```
#[doc(inline)]
pub use imrs_runtime::Rendezvous;

/// The result of [`Context::send`].
///
/// ```
/// use imrs_client::{Context, Program, Sent, TaskEnd, TaskError};
/// use std::time::Duration;
///
/// fn asker(ctx: &mut Context) -> Result<(), TaskError> {
///     let width = ctx.port("width")?;
///     match ctx.send(width, &7_i16.to_le_bytes())? {
///         Sent::Outcome(outcome) => println!("the only other task: {outcome:?}"),
///         Sent::Several(outcomes) => println!("each of the others: {outcomes:?}"),
///         Sent::Copies(number) => println!("class 1: {number} copies left, and no receiver answers"),
///     }
///     Ok(())
/// }
///
/// # fn main() -> Result<(), imrs_client::ProgramError> {
/// const CELL: &str = "cell ask;
/// tick 1 msec;
/// node here;
/// task asker on here extern
///   port width(part: int16) usage = send user_list = {answerer} time_out = 10 sec class = 2;
/// end asker;
/// task answerer on here
///   use_port width(part: int16) usage = receive;
///   var part: int16;
/// begin
///   receive width(part);
///   reply();
/// end answerer;
/// ";
/// let ends = Program::of_text("ask.cell", CELL)?.task("asker", asker).run(Some(Duration::from_secs(60)))?;
/// assert_eq!(ends[0], ("asker".to_owned(), TaskEnd::Returned));
/// # Ok(())
/// # }
/// ```
#[doc(inline)]
pub use imrs_runtime::Sent;

/// The result of [`Program::run`] for each task.
///
/// ```
/// use imrs_client::{Program, TaskEnd};
///
/// # fn main() -> Result<(), imrs_client::ProgramError> {
/// const CELL: &str = "cell ends;
/// tick 1 msec;
/// node here;
/// task lost on here extern
/// end lost;
/// task script on here
/// begin
///   delay 1 msec;
/// end script;
/// ";
/// let ends = Program::of_text("ends.cell", CELL)?.task("lost", |_| panic!("no camera")).run(None)?;
/// for (task, end) in &ends {
///     match end {
///         TaskEnd::Returned => println!("{task} returned"),
///         TaskEnd::Script(end) => println!("the script of {task} ended: {end:?}"),
///         TaskEnd::Failed(error) => println!("{task} failed: {error}"),
///         TaskEnd::Panicked(message) => println!("{task} panicked: {message}"),
///         TaskEnd::Unfinished => println!("{task} did not end when the run was stopped"),
///     }
/// }
/// assert_eq!(ends[0], ("lost".to_owned(), TaskEnd::Panicked("no camera".into())));
/// # Ok(())
/// # }
/// ```
#[doc(inline)]
pub use imrs_runtime::TaskEnd;

/// Why a call of a [`Context`] was not carried out. Pass each error on with `?`: the error that says that the node stops
/// counts as a return of the task.
///
/// ```
/// use imrs_client::{Program, TaskEnd, TaskError};
///
/// # fn main() -> Result<(), imrs_client::ProgramError> {
/// const CELL: &str = "cell alone;
/// tick 1 msec;
/// node here;
/// task camera on here extern
/// end camera;
/// ";
/// let program = Program::of_text("alone.cell", CELL)?.task("camera", |ctx| ctx.port("pose").map(|_| ()));
/// let ends = program.run(None)?;
/// let TaskEnd::Failed(error) = &ends[0].1 else { panic!("{ends:?}") };
/// assert_eq!(*error, TaskError::NoPort("pose".into()));
/// println!("{error}");
/// # Ok(())
/// # }
/// ```
#[doc(inline)]
pub use imrs_runtime::TaskError;
