//! Macros for Rust programs that are tasks of a cell. [`cell!`] compiles a cell file into the program; [`derive@Message`]
//! lays a struct out as the cell language lays out its records. The output of both macros refers to `imrs_runtime`, so the
//! program must depend on that crate.

#![forbid(unsafe_code)]

mod cell;
mod message;

use proc_macro::TokenStream;
use syn::{DeriveInput, LitStr, parse_macro_input};

/// Compiles a cell file, named relative to the folder of the package's `Cargo.toml`. An error of the cell is a compile error
/// of the program, with the code, line and help of the cell compiler.
///
/// The macro adds to its module:
/// - `FILE`: the text of the cell.
/// - `table()`: the table of the cell, in microseconds, made once.
/// - `builder(node)`: an `imrs_runtime::Builder` of this node with the scripts of the cell. The program adds the bodies of
///   the `extern` tasks and the functions of the actions.
/// - `nodes`, `tasks`, `ports`: modules with a constant for each node, task and port, in capitals.
/// - for each record, a struct of its name that is a `Message`.
/// - `messages` and `answers`: modules with the type of each port's messages and of its answers, under the port's name.
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

/// Makes a struct a message: its fields follow each other in order, little endian, without padding. Each field is a `bool`,
/// `i8`, `i16`, `i32`, `u32` or `f32`; together they have at most 192 bytes.
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
/// A type without a layout in the cell language cannot be a field:
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
