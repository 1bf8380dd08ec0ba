//! `imrs fmt`: formats cell files.

use crate::args::FmtArgs;
use crate::cell_file::{is_stdin, read, replace, shown};
use crate::exit::{Exit, turned_down};
use crate::failure::Failure;
use crate::output::{Output, complain, complain_in_full};
use imrs_language::{format, render};
use std::path::Path;

/// How many lines of a difference are shown of the old and of the new text, at most.
const SHOWN: usize = 8;

/// Formats cell files. A file that cannot be read or has errors does not stop the others from being formatted.
///
/// # Errors
/// [`Failure::Output`].
pub fn run(args: &FmtArgs, out: &mut Output) -> Result<Exit, Failure> {
    let mut worst = Exit::Well;
    for path in &args.cells {
        let exit = match one(path, args.check, out) {
            Ok(exit) => exit,
            Err(Failure::Output(error)) => return Err(Failure::Output(error)),
            Err(failure) => {
                complain(&failure);
                failure.exit()
            }
        };
        if exit as u8 > worst as u8 {
            worst = exit;
        }
    }
    Ok(worst)
}

fn one(path: &Path, only_check: bool, out: &mut Output) -> Result<Exit, Failure> {
    let source = read(path)?;
    let file = shown(path);
    let text = match format(&source) {
        Ok(text) => text,
        Err(found) => {
            let shown = render::text(&found, &file, Some(&source), render::Style::Coloured);
            complain_in_full(out.color, &shown);
            complain(format_args!("{file}: not formatted: it cannot be read"));
            return Ok(turned_down(&found));
        }
    };
    if only_check {
        if text == source.text() {
            return Ok(Exit::Well);
        }
        out.text(&difference(&file, source.text(), &text))?;
        return Ok(Exit::Finding);
    }
    if is_stdin(path) {
        out.file(&text)?;
    } else if text != source.text() {
        replace(path, &text)?;
    }
    Ok(Exit::Well)
}

/// A text that shows how the old and the new text differ, from the first to the last line that differs.
fn difference(file: &str, old: &str, new: &str) -> String {
    let (old, new): (Vec<&str>, Vec<&str>) = (old.split('\n').collect(), new.split('\n').collect());
    let same = old.iter().zip(&new).take_while(|(a, b)| a == b).count();
    let rest = old[same..].iter().rev().zip(new[same..].iter().rev()).take_while(|(a, b)| a == b).count();
    let mut shown = format!("{file}:{}: would be written as\n", same + 1);
    for (sign, lines) in [('-', &old[same..old.len() - rest]), ('+', &new[same..new.len() - rest])] {
        for line in lines.iter().take(SHOWN) {
            // The terminal would use a carriage return to overwrite the text before it.
            shown.push_str(&format!("{sign} {}\n", line.trim_end_matches('\r')));
        }
        if lines.len() > SHOWN {
            shown.push_str(&format!("{sign} .. {} more lines\n", lines.len() - SHOWN));
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::difference;

    #[test]
    fn a_difference_leaves_out_what_is_the_same() {
        assert_eq!(
            difference("a.cell", "x\ny  z\nw\n", "x\ny z\nw\n"),
            "a.cell:2: would be written as\n- y  z\n+ y z\n"
        );
        assert_eq!(difference("a", "x", "x\n"), "a:2: would be written as\n+ \n");
    }
}
