//! `imrs keygen`: draws the keys with which the nodes of a cell close their datagrams.

use crate::args::KeygenArgs;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::kept;
use crate::output::Output;
use imrs_client::keys;
use imrs_launch::cells;
use std::fs::{self, DirBuilder};
use std::os::unix::fs::DirBuilderExt;

/// Draws keys for each node of a cell, and writes one file for each.
///
/// # Errors
/// [`Failure`]; an existing file is one, without `--force`.
pub fn run(args: &KeygenArgs, out: &mut Output) -> Result<Exit, Failure> {
    let (_, loaded) = cells::open(&args.cell, false)?;
    let folder = &args.out;
    let failed = |why: &dyn std::fmt::Display| Failure::Usage(format!("--out {}: {why}", folder.display()));
    if !folder.is_dir() {
        let made = DirBuilder::new().recursive(true).mode(0o700).create(folder);
        made.map_err(|error| failed(&error))?;
    }
    let drawn = keys::draw(&loaded).map_err(|error| failed(&error))?;
    let path = |node: &str| keys::file_of(folder, node);
    // Keys of two draws do not fit each other, so all files are checked before one is written.
    for (node, _) in &drawn {
        kept::check(&path(node), args.force)?;
    }
    for (node, text) in &drawn {
        kept::keep_text(&path(node), args.force, text)?;
    }
    let folder = fs::canonicalize(folder).unwrap_or_else(|_| folder.clone());
    for (node, _) in &drawn {
        out.line(format_args!("{}", path(node).display()))?;
    }
    out.line(format_args!(
        "Copy to each machine the file of its node alone, then: imrs run {} --node NAME --keys {}",
        args.cell.display(),
        folder.display()
    ))?;
    Ok(Exit::Well)
}
