//! `imrs keygen`: draws the keys with which the nodes of a cell encrypt and authenticate their datagrams.

use crate::args::KeygenArgs;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::kept;
use crate::output::{Output, count};
use imrs_client::{cell_file, keys};
use imrs_launch::{LaunchError, cells};
use std::fs::DirBuilder;
use std::os::unix::fs::DirBuilderExt;
use std::path::PathBuf;

/// The file that keeps the folder out of a git repository.
const IGNORE: &str = ".gitignore";

/// Draws keys for each node of a cell, and writes one file for each.
///
/// # Errors
/// [`Failure`]. Without `--force`, an existing file is an error.
pub fn run(args: &KeygenArgs, out: &mut Output) -> Result<Exit, Failure> {
    let (_, loaded) = cells::open(&args.cell, false)?;
    let folder = folder_of(args)?;
    if !folder.is_dir() {
        let made = DirBuilder::new().recursive(true).mode(0o700).create(&folder);
        made.map_err(|error| Failure::Usage(format!("{}: {error}", folder.display())))?;
    }
    let drawn = keys::draw(&loaded).map_err(LaunchError::from)?;
    let nodes = loaded.table.cell().nodes.iter();
    let files: Vec<PathBuf> = nodes.map(|node| keys::file_of(&folder, &node.name)).collect();
    // Keys of two draws do not work together, so all files are checked before any file is written.
    for path in &files {
        kept::check(path, args.force)?;
    }
    if !folder.join(IGNORE).exists() {
        kept::keep_text(&folder.join(IGNORE), false, "*\n")?;
    }
    for (path, text) in files.iter().zip(&drawn) {
        kept::keep_text(path, args.force, text)?;
        out.line(path.display())?;
    }
    let (cell, here) = (cell_file::shown(&args.cell), folder == keys::beside(&args.cell));
    let named = if here { String::new() } else { format!(" --keys {}", folder.display()) };
    out.line(format_args!(
        "Keys of {}. Here: imrs run {cell} --node NAME{named}",
        count(files.len() as u64, "node")
    ))?;
    out.line("On another machine: copy the file of its node, and no other, into a folder, and name that with --keys.")?;
    Ok(Exit::Well)
}

fn folder_of(args: &KeygenArgs) -> Result<PathBuf, Failure> {
    match &args.out {
        Some(folder) => Ok(folder.clone()),
        None if cell_file::is_stdin(&args.cell) => Err(Failure::Usage(
            "name a folder for the keys of a cell from standard input: --out FOLDER".into(),
        )),
        None => Ok(keys::beside(&args.cell)),
    }
}
