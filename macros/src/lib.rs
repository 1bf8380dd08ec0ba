//! For Rust programs that are tasks of a cell, beside `imrs-runtime`: [`cell!`] compiles a cell file into the program, and
//! [`derive@Message`] lays a struct out as the cell language lays its records out. What they write refers to
//! `imrs_runtime`, which the program must depend on.

#![forbid(unsafe_code)]

mod cell;
mod message;

use proc_macro::TokenStream;
use syn::{DeriveInput, LitStr, parse_macro_input};

/// Compiles a cell file, named relative to the folder of the package's `Cargo.toml`. An error of the cell is an error of
/// the program, in the compiler's own words: code, line and help.
///
/// Into the module where it stands it writes:
/// - `FILE`: the text of the cell.
/// - `table()`: the cell's table, in microseconds, made once.
/// - `builder(node)`: an `imrs_runtime::Builder` of this node that has the scripts of the cell already; the program gives
///   bodies to the `extern` tasks and functions to the actions.
/// - `nodes`, `tasks`, `ports`: a constant for each, in capitals.
/// - for each record a struct of its name that is a `Message`.
/// - `messages` and `answers`: for each port the type of what is sent and of what is answered, under the port's name.
///
/// ```
/// mod vision {
///     imrs_macros::cell!("tests/vision.cell");
/// }
/// use imrs_runtime::{Context, TaskError, TaskEnd};
/// use std::time::Duration;
///
/// fn camera(ctx: &mut Context) -> Result<(), TaskError> {
///     for x in [900, 120] {
///         ctx.tell(vision::ports::POSE, &vision::Pose { x, y: 40 })?;
///     }
///     Ok(())
/// }
///
/// # fn main() {
/// let node = vision::builder(vision::nodes::HERE).task("camera", camera).start().expect("a node");
/// assert!(node.wait(Duration::from_secs(10)));
/// # let ends = node.stop(Duration::from_secs(10));
/// # assert_eq!(ends[0].1, TaskEnd::Returned);
/// # }
/// ```
///
/// A cell with errors does not compile:
///
/// ```compile_fail
/// imrs_macros::cell!("tests/faulty.cell");
/// ```
#[proc_macro]
pub fn cell(input: TokenStream) -> TokenStream {
    let path = parse_macro_input!(input as LitStr);
    cell::expand(&path).into()
}

/// Makes a struct a message: its fields one after another, in their order, little endian, without padding. Each is a
/// `bool`, `i8`, `i16`, `i32`, `u32` or `f32`; all together at most 192 bytes (D28).
///
/// ```
/// use imrs_macros::Message;
/// use imrs_runtime::message::{LONGEST, Message as _};
///
/// #[derive(Clone, Copy, Debug, PartialEq, Message)]
/// struct Pose {
///     x: i16,
///     y: i16,
///     held: bool,
/// }
///
/// let mut room = [0; LONGEST];
/// assert_eq!(Pose { x: 1, y: -2, held: true }.encode(&mut room), Some(5));
/// assert_eq!(room[..5], [1, 0, 0xfe, 0xff, 1]);
/// assert_eq!(Pose::decode(&room[..5]), Some(Pose { x: 1, y: -2, held: true }));
/// ```
///
/// What has no layout in the cell language is no field:
///
/// ```compile_fail
/// #[derive(imrs_macros::Message)]
/// struct Far {
///     x: f64,
/// }
/// ```
#[proc_macro_derive(Message)]
pub fn derive_message(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    message::expand(&input).unwrap_or_else(|error| error.to_compile_error()).into()
}
