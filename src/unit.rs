//! `imrs unit`: prints a systemd unit that runs one node of a cell (D204).

use crate::args::{Cli, LaunchArgs, UnitArgs, Verb};
use crate::exit::Exit;
use crate::failure::Failure;
use crate::output::Output;
use crate::run::checked;
use clap::Parser;
use imrs_client::{cell_file, keys};
use imrs_launch::{Keys, cells};
use std::env;
use std::fmt::Write;
use std::path::Path;

/// Prints the unit after the checks of `imrs run`: of the cell, the node, the options and the keys.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &UnitArgs, out: &mut Output) -> Result<Exit, Failure> {
    if cell_file::is_stdin(&args.cell) {
        return Err(Failure::Usage("name a cell file: a unit reads it again at each start".into()));
    }
    let is_name = |letter: char| letter.is_ascii_alphanumeric() || "_-.".contains(letter);
    if args.user.is_empty() || !args.user.chars().all(is_name) {
        return Err(Failure::Usage(format!("--user {}: this is no name of a user", args.user)));
    }
    let cell = args.cell.canonicalize().unwrap_or_else(|_| args.cell.clone());
    let folder = cell.parent().unwrap_or(Path::new("/"));
    // The unit runs in this folder, so the paths in the options are relative to it.
    if cell.is_file() {
        env::set_current_dir(folder)
            .map_err(|error| Failure::Usage(format!("{}: {error}", folder.display())))?;
    }
    let mut words = vec!["run".into(), text_of(&cell)?, "--node".into(), args.node.clone()];
    words.extend(args.options.iter().cloned());
    let is_real_time = checked_options(&words)?.rt;
    let program = env::current_exe().map_err(|error| Failure::Usage(format!("this program: {error}")))?;
    words.insert(0, text_of(&program)?);
    let command: Vec<String> = words.iter().map(|word| quoted(word)).collect();
    let about = format!("node {} of {}", args.node, text_of(&cell)?);
    let unit = unit(&about, &command.join(" "), (&text_of(folder)?, &args.user), is_real_time);
    out.line(unit.trim_end())?;
    Ok(Exit::Well)
}

/// Parses the words of a command line as the options of `imrs run`, with the same checks.
fn checked_options(words: &[String]) -> Result<LaunchArgs, Failure> {
    let parsed = Cli::try_parse_from(std::iter::once("imrs").chain(words.iter().map(String::as_str)));
    let args = match parsed.map(|cli| cli.verb) {
        Ok(Some(Verb::Run(args))) => args,
        Ok(_) => return Err(Failure::Usage("the words behind `--` are no options of `imrs run`".into())),
        Err(error) => {
            let text = error.render().to_string();
            let why = text.trim_start_matches("error: ").lines().next().unwrap_or_default();
            return Err(Failure::Usage(format!("behind `--`: {why}")));
        }
    };
    if args.launch.record.is_some() {
        return Err(Failure::Usage(
            "--record: a unit starts its node again and again, and a recording is never replaced by the next one. Record with `imrs monitor --record`, or start the node by hand".into(),
        ));
    }
    let (source, loaded) = cells::open(&args.cell, args.paper)?;
    if let Keys::Folder(folder) = checked(&args, source, &loaded)?.keys {
        let file = keys::file_of(&folder, args.launch.node.as_deref().unwrap_or_default());
        if !file.is_file() {
            return Err(Failure::Usage(format!(
                "{}: there is no such file: copy it from where `imrs keygen` made it",
                file.display()
            )));
        }
    }
    Ok(args.launch)
}

fn text_of(path: &Path) -> Result<String, Failure> {
    let text = path.to_str().map(str::to_owned);
    text.ok_or_else(|| Failure::Usage(format!("{}: a unit can only name paths in UTF-8", path.display())))
}

/// The text of the unit. The unit executes `command` in the folder, as the user.
fn unit(about: &str, command: &str, (folder, user): (&str, &str), is_real_time: bool) -> String {
    let limits = if is_real_time { "# For --rt.\nLimitRTPRIO=99\nLimitMEMLOCK=infinity\n" } else { "" };
    format!(
        "\
[Unit]
Description=imrs: {about}
Wants=network-online.target
After=network-online.target
# A node is started again however often it fails.
StartLimitIntervalSec=0

[Service]
Type=notify
NotifyAccess=main
ExecStart={command}
WorkingDirectory={folder}
User={user}
# The number of the node's incarnation, which must outlive a reboot, is in /var/lib/imrs.
StateDirectory=imrs
StateDirectoryMode=0700
# The sockets at which monitors connect are in /run/imrs. Other nodes on this machine use the folder, too.
RuntimeDirectory=imrs
RuntimeDirectoryMode=0700
RuntimeDirectoryPreserve=yes
Environment=XDG_STATE_HOME=%S XDG_RUNTIME_DIR=%t
Restart=on-failure
RestartSec=1
# Exit code 2: the cell, its keys or the options are wrong, and another start would not help. Exit codes 5 and 6: the tasks
# ended in order, but evidence is missing, or links were faulty or datagrams of others came.
RestartPreventExitStatus=2 5 6
WatchdogSec=3
# Only the launcher gets the signal. It lets the tasks end in order, and then the node.
KillMode=mixed
TimeoutStopSec=10
{limits}
[Install]
WantedBy=multi-user.target
",
        about = percent(about),
        folder = percent(folder),
    )
}

/// A word without the specifiers of units (`%`).
fn percent(word: &str) -> String {
    word.replace('%', "%%")
}

/// A word of a command line, escaped for a unit: `%` and `$` have no special meaning, and the word is quoted if needed
/// (`systemd.service(5)`).
fn quoted(word: &str) -> String {
    let mut text = String::new();
    for letter in percent(word).replace('$', "$$").chars() {
        match letter {
            '"' | '\\' => text.extend(['\\', letter]),
            '\n' => text.push_str("\\n"),
            '\t' => text.push_str("\\t"),
            letter if letter.is_control() => {
                let _ = write!(text, "\\u{:04x}", u32::from(letter));
            }
            letter => text.push(letter),
        }
    }
    let is_plain = |letter: char| letter.is_alphanumeric() || "-_./:=@,+%$".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) { text } else { format!("\"{text}\"") }
}

#[cfg(test)]
mod tests {
    use super::quoted;

    #[test]
    fn a_word_reaches_the_program_as_it_was_typed() {
        assert_eq!(quoted("--node"), "--node");
        assert_eq!(quoted("pick=./pick --gently"), "\"pick=./pick --gently\"");
        assert_eq!(quoted("50%"), "50%%");
        assert_eq!(quoted("$HOME/a\"b\\c"), "\"$$HOME/a\\\"b\\\\c\"");
        assert_eq!(quoted("a\nb"), "\"a\\nb\"");
        assert_eq!(quoted(";"), "\";\"");
        assert_eq!(quoted(""), "\"\"");
    }
}
