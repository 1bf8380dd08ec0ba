//! `imrs explain`: the pages about the codes of diagnostics.

use crate::args::{ExplainArgs, Format};
use crate::exit::{Exit, Failure, did_you_mean};
use crate::output::{HEAD, Output, Styled};
use imrs_language::codes::{self, CodeEntry};
use serde_json::json;

/// Explains a code, or lists them.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &ExplainArgs, out: &mut Output) -> Result<Exit, Failure> {
    let entries: Vec<&CodeEntry> = match &args.code {
        None => codes::ALL.iter().collect(),
        Some(code) => vec![page(code)?],
    };
    match args.format {
        Format::Json => {
            let pages = entries.iter().map(
                |entry| json!({"code": entry.code, "title": entry.title, "explanation": entry.explanation}),
            );
            out.json(&json!({"version": 1, "codes": pages.collect::<Vec<_>>()}))?;
        }
        Format::Text if args.code.is_none() => {
            for entry in entries {
                out.line(format!("{}  {}", Styled(HEAD, entry.code), entry.title))?;
            }
            out.line("\nE is an error, W a warning, N a note. `imrs explain E104` shows one.")?;
        }
        Format::Text => entries.iter().try_for_each(|entry| out.text(entry.explanation))?,
    }
    Ok(Exit::Well)
}

fn page(code: &str) -> Result<&'static CodeEntry, Failure> {
    codes::explain(code).ok_or_else(|| {
        // An O for a zero is the likeliest slip.
        let upper = code.to_ascii_uppercase().replace('O', "0");
        let near = did_you_mean(&upper, codes::ALL.iter().map(|entry| entry.code));
        // The list of all is too long for a line.
        let hint = if near.starts_with(": did") { near } else { ": `imrs explain` lists them".to_owned() };
        Failure::Usage(format!("no code `{code}`{hint}"))
    })
}
