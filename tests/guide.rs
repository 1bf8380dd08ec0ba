//! Follows the guide (`docs/guide`) to the letter. The test writes each cell of a chapter into an empty folder, runs each
//! command there, and compares its output with the chapter. [`Block`] lists the kinds of blocks.

use crate::front_door::{blocks, is_excerpt, links};
use crate::support::program::Program;
use crate::support::{Said, run_in, runtime_dir, tried_again};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

macro_rules! chapters {
    ($($name:ident $file:literal)*) => {
        const CHAPTERS: &[&str] = &[$($file),*];
        $(#[test] fn $name() { follow($file); })*
    };
}

chapters! {
    introduction "introduction"
    install "install"
    first_cell "first-cell"
    fault_to_mended "fault-to-mended"
    time_outs "time_outs"
    rendezvous "rendezvous"
    sharing_a_tool "sharing-a-tool"
    take_over "take-over"
    three_machines "three-machines"
    rust_task "rust-task"
    watching "watching"
    recording "recording"
    what_is_checked "what-is-checked"
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guide")
}

fn text_of(page: &str) -> String {
    let path = folder().join(format!("{page}.md"));
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Follows a chapter, each time in a new folder. In a run on a late machine a time_out may expire, or the run may end before
/// a fault that the chapter injects. A chapter that is wrong fails each time.
fn follow(chapter: &str) {
    tried_again(&format!("docs/guide/{chapter}.md was not followed"), || {
        let dir = runtime_dir();
        let faults = carry_out(dir.path(), &text_of(chapter));
        faults.iter().for_each(|fault| eprintln!("{fault}\n"));
        faults.is_empty()
    });
}

/// A block of a chapter.
enum Block<'a> {
    /// ```` ```cell first.cell ````: a file that the reader writes.
    Cell(&'a str),
    /// ```` ```cell-part first.cell ````: lines of a file of the chapter.
    PartOfCell(&'a str),
    /// ```` ```rust-part examples/extern_task.rs ````: lines of a file of the repository.
    PartOfTree(&'a str),
    /// ```` ```console ````: commands, each after `$ `, with lines of their output.
    Console,
    /// ```` ```text ````: pictures and arithmetic, which are not checked.
    Text,
}

impl<'a> Block<'a> {
    fn of_kind(kind: &'a str) -> Option<Self> {
        let (word, file) = kind.split_once(' ').unwrap_or((kind, ""));
        match (word, file) {
            ("cell", file) if !file.is_empty() => Some(Self::Cell(file)),
            ("cell-part", file) if !file.is_empty() => Some(Self::PartOfCell(file)),
            ("rust-part", file) if !file.is_empty() => Some(Self::PartOfTree(file)),
            ("console", "") => Some(Self::Console),
            ("text", "") => Some(Self::Text),
            _ => None,
        }
    }
}

/// Follows a chapter in a folder. Returns the faults of the chapter, each with a line number.
fn carry_out(dir: &Path, text: &str) -> Vec<String> {
    let mut faults = Vec::new();
    for block in blocks(text) {
        // The first line of a block is the one after the line that opens it.
        let first = block.before.lines().count() + 2;
        match Block::of_kind(block.kind) {
            Some(Block::Cell(name)) => {
                let file = dir.join(name);
                fs::write(&file, block.lines.join("\n") + "\n").expect("a file of the chapter");
                let said = run_in(dir, &["fmt", "--check", file.to_str().expect("UTF-8")]);
                if said.code != Some(0) {
                    faults.push(format!(
                        "{first}: `imrs fmt` writes {name} otherwise: {}{}",
                        said.out, said.err
                    ));
                }
            }
            Some(Block::PartOfCell(name)) => faults.extend(part(&block.lines, &dir.join(name), first)),
            Some(Block::PartOfTree(name)) => {
                let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(name);
                faults.extend(part(&block.lines, &file, first));
            }
            Some(Block::Console) => faults.extend(console(dir, &block.lines, first)),
            Some(Block::Text) => {}
            None => faults.push(format!("{}: `{}` is no kind of block", first - 1, block.kind)),
        }
    }
    faults
}

/// Returns a fault if these lines are no excerpt of the file.
fn part(lines: &[&str], file: &Path, first: usize) -> Option<String> {
    let Ok(text) = fs::read_to_string(file) else {
        return Some(format!("{first}: there is no file {}", file.display()));
    };
    let [lines, text]: [Vec<&str>; 2] =
        [lines.to_vec(), text.lines().collect()].map(|all| all.iter().map(|line| line.trim()).collect());
    (!is_excerpt(&lines, &text)).then(|| format!("{first}: these lines are not in {}", file.display()))
}

/// Runs the commands of a block.
fn console(dir: &Path, lines: &[&str], first: usize) -> Vec<String> {
    let mut faults = Vec::new();
    let mut at = 0;
    while at < lines.len() {
        let line = first + at;
        let Some(command) = lines[at].strip_prefix("$ ") else {
            faults.push(format!("{line}: `{}` follows no command", lines[at]));
            at += 1;
            continue;
        };
        let shown: Vec<&str> =
            lines[at + 1..].iter().copied().take_while(|line| !line.starts_with("$ ")).collect();
        at += 1 + shown.len();
        let code = shown.first().and_then(|line| line.strip_prefix("# exit code "));
        let shown = if code.is_some() { &shown[1..] } else { &shown[..] };
        let code = code.map_or(Some(0), |code| code.trim().parse().ok());
        let said = shell(dir, command);
        let missing = missing(shown, &said.out);
        if said.code != code || missing.is_some() {
            let missing = missing.map_or(String::new(), |line| format!("`{line}` is not printed there; "));
            let Said { code, out, .. } = said;
            faults.push(format!("{line}: `{command}`: {missing}it ended with {code:?} and printed\n{out}"));
        }
    }
    faults
}

/// Runs a shell line as a reader of the guide would, with both output streams merged.
fn shell(dir: &Path, line: &str) -> Said {
    let programs = Path::new(env!("CARGO_BIN_EXE_imrs")).parent().expect("a folder");
    let path = std::env::var("PATH").unwrap_or_default();
    let mut command = Command::new("sh");
    command.arg("-c").arg(format!("exec 2>&1\n{line}")).current_dir(dir).stdin(Stdio::null());
    command.env("PATH", format!("{}:{path}", programs.display())).env("NO_COLOR", "1");
    command.env("XDG_RUNTIME_DIR", dir).env("XDG_STATE_HOME", dir.join("state")).env("TMPDIR", dir);
    let mut program = Program::start(command);
    program.read_until(|_| false);
    program.finish()
}

/// Returns the first shown line that the command did not print after the previous shown line.
fn missing<'a>(shown: &[&'a str], printed: &str) -> Option<&'a str> {
    let mut printed = printed.lines();
    let shown = shown.iter().copied().filter(|line| !line.trim().is_empty() && line.trim() != "...");
    shown.into_iter().find(|line| !printed.any(|printed| is_like(line, printed)))
}

/// Whether a printed line matches the shown one, in which `…` stands for any text. Runs of spaces count as one.
fn is_like(shown: &str, printed: &str) -> bool {
    let [shown, printed] = [shown, printed].map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "));
    let mut pieces = shown.split('…');
    let first = pieces.next().unwrap_or_default();
    let Some(mut rest) = printed.strip_prefix(first) else { return false };
    let pieces: Vec<&str> = pieces.collect();
    let Some((last, middle)) = pieces.split_last() else { return rest.is_empty() };
    for piece in middle {
        let Some((_, after)) = rest.split_once(piece) else { return false };
        rest = after;
    }
    rest.ends_with(last)
}

#[test]
fn the_contents_are_the_chapters() {
    let contents = text_of("SUMMARY");
    let named: Vec<&str> = links(&contents).into_iter().map(|link| link.trim_end_matches(".md")).collect();
    assert_eq!(named, CHAPTERS);
    for entry in fs::read_dir(folder()).expect("the guide").flatten() {
        let name = entry.file_name().into_string().expect("a plain name");
        let page = name.strip_suffix(".md").unwrap_or(&name);
        let is_known = ["SUMMARY", "book.toml"].contains(&page) || CHAPTERS.contains(&page);
        assert!(is_known, "docs/guide/{name} is in no list");
    }
}

/// Each fault of a chapter is reported with its line.
#[test]
fn a_chapter_that_is_wrong_says_where() {
    let page = "# T\n```cell a.cell\ncell  a;\n```\n```cell-part a.cell\ncell b;\n```\n```console\n$ echo one; echo two\n\
                two\none\n$ exit 3\n# exit code 3\n$ exit 3\n```\n```rust\n```\n";
    let dir = runtime_dir();
    let faults = carry_out(dir.path(), page);
    let begin: Vec<&str> = faults.iter().filter_map(|fault| fault.split([' ']).next()).collect();
    assert_eq!(begin, ["3:", "6:", "9:", "14:", "16:"], "{faults:?}");
    assert!(faults[2].contains("`one` is not printed there"), "{faults:?}");
}

#[test]
fn a_shown_line_may_leave_text_out() {
    assert!(is_like("a … c", "a  b c") && is_like("…b…", "abc") && is_like("a b", "  a   b"));
    assert!(!is_like("a … d", "a b c") && !is_like("a", "ab") && !is_like("a…b…c", "acb"));
}
