//! Reads and writes schedules as TOML files. A file has the faults, and also the choices if `--save` wrote the file.

use crate::failure::Failure;
use crate::names::did_you_mean;
use imrs_model::cell::{Chooser, Fault, MOST_FAULTS, Schedule, Tape};
use imrs_protocol::{CellTable, NodeId, TaskId};
use imrs_wire::files::{self, FileError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

/// The version of the file format. In version 1, the choices of a node did not include the order of its waiting inputs
/// (D170).
const VERSION: u32 = 2;
/// The greatest length of a file, in bytes.
const LONGEST: u64 = 16 << 20;

/// A schedule in the form in which a file has it.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct File {
    version: u32,
    /// The cell for which the schedule was saved.
    #[serde(skip_serializing_if = "Option::is_none")]
    cell: Option<String>,
    /// The digest of the declarations of the cell for which the schedule was saved.
    #[serde(skip_serializing_if = "Option::is_none")]
    digest: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    fault: Vec<Line>,
    /// The choices of the schedule. Without them each seed draws its own choices.
    #[serde(skip_serializing_if = "Option::is_none")]
    choices: Option<Choices>,
}

/// A fault in the file. Exactly one of the first eight fields is set, and that field is the kind of the fault.
#[derive(Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
struct Line {
    #[serde(skip_serializing_if = "Option::is_none")]
    lose: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    copy: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    overtake: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fail: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    stop: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cut: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pause: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    drift: Option<String>,
    /// For a packet: its link, `a -> b`.
    #[serde(skip_serializing_if = "Option::is_none")]
    link: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    task: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    at: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    restart_after: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    lasts: Option<String>,
    /// For a pause: `waits` if an action that the node has just begun starts only after the pause.
    #[serde(skip_serializing_if = "Option::is_none")]
    action: Option<String>,
    /// For a clock: `twice` or `missed`.
    #[serde(skip_serializing_if = "Option::is_none")]
    tick: Option<String>,
}

#[derive(Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
struct Choices {
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    task: BTreeMap<String, Vec<u32>>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    link: BTreeMap<String, Vec<u32>>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    node: BTreeMap<String, Vec<u32>>,
}

/// The faults of a file, and its choices if it has any.
pub(super) type Plan = (Vec<Fault>, Option<Tape>);

/// The names in a cell, and the length of its tick, which the texts of a file need.
pub(super) struct Names<'a> {
    pub table: &'a CellTable,
    pub tick_us: u64,
}

/// Reads a file of a schedule.
///
/// # Errors
/// [`Failure::Usage`], which names the file and the wrong fault.
pub(super) fn read(path: &Path, names: &Names<'_>) -> Result<Plan, Failure> {
    let refused = |what: String| Failure::Usage(format!("{}: {what}", path.display()));
    let text = files::text(path, LONGEST).map_err(|error| match error {
        FileError::Io(error) => refused(format!("cannot be read: {error}")),
        other => refused(format!("no plan, {other}: name a file that --save wrote, or one like it")),
    })?;
    let file: File = toml::from_str(&text).map_err(|error| refused(error.to_string().trim_end().into()))?;
    names.plan(file).map_err(refused)
}

/// The text of a file with a schedule.
pub(super) fn text(schedule: &Schedule, command: &str, names: &Names<'_>) -> String {
    let cell = names.table.cell();
    let mut choices = Choices::default();
    for (&who, made) in &schedule.tape {
        let (of, name) = match who {
            Chooser::Task(task) => (&mut choices.task, names.task_name(task)),
            Chooser::Link(from, to) => (&mut choices.link, names.link_name(from, to)),
            Chooser::Node(node) => (&mut choices.node, names.node_name(node)),
        };
        of.insert(name, made.clone());
    }
    let file = File {
        version: VERSION,
        cell: Some(cell.name.clone()),
        digest: Some(format!("{:08x}", names.table.digest())),
        fault: schedule.faults.iter().map(|fault| names.line(fault)).collect(),
        choices: Some(choices),
    };
    // TOML can write strings, numbers and lists of them, so this does not fail.
    let body = toml::to_string(&file).unwrap_or_default();
    format!("# {command}\n{body}")
}

impl Names<'_> {
    fn plan(&self, file: File) -> Result<Plan, String> {
        if file.version != VERSION {
            return Err(format!(
                "version {}: this imrs reads version {VERSION}; write that where it has no choices of nodes, or save it anew",
                file.version
            ));
        }
        let own = &self.table.cell().name;
        if let Some(cell) = file.cell.filter(|cell| cell != own) {
            return Err(format!("it was saved from the cell `{cell}`, this is `{own}`"));
        }
        if file.digest.is_some_and(|digest| digest != format!("{:08x}", self.table.digest())) {
            return Err(format!("the declarations of `{own}` have changed since it was saved"));
        }
        if file.fault.len() > MOST_FAULTS {
            return Err(format!("{} faults: at most {MOST_FAULTS} are taken", file.fault.len()));
        }
        let read = |(number, line): (usize, &Line)| {
            self.fault(line).map_err(|what| format!("fault {number}: {what}"))
        };
        let faults = (1..).zip(&file.fault).map(read).collect::<Result<_, _>>()?;
        let tape = file.choices.map(|choices| self.tape(choices)).transpose()?;
        Ok((faults, tape))
    }

    fn tape(&self, choices: Choices) -> Result<Tape, String> {
        let mut tape = Tape::new();
        for (name, made) in choices.task {
            tape.insert(Chooser::Task(self.task(&name)?), made);
        }
        for (name, made) in choices.link {
            let (from, to) = self.link(&name)?;
            // TOML refuses the same key twice, but two spellings of one link, `a -> b` and `a->b`, are two keys for it.
            if tape.insert(Chooser::Link(from, to), made).is_some() {
                return Err(format!("choices.link has `{}` twice: write it once", self.link_name(from, to)));
            }
        }
        for (name, made) in choices.node {
            tape.insert(Chooser::Node(self.node(&name)?), made);
        }
        Ok(tape)
    }

    fn fault(&self, line: &Line) -> Result<Fault, String> {
        let kinds = [
            ("lose", line.lose.is_some(), &["link"][..], &[][..]),
            ("copy", line.copy.is_some(), &["link"], &[]),
            ("overtake", line.overtake.is_some(), &["link"], &[]),
            ("fail", line.fail.is_some(), &["task"], &[]),
            ("stop", line.stop.is_some(), &["at"], &["restart_after"]),
            ("cut", line.cut.is_some(), &["at"], &["lasts"]),
            ("pause", line.pause.is_some(), &["at", "lasts"], &["action"]),
            ("drift", line.drift.is_some(), &["at", "tick"], &[]),
        ];
        let words = [
            ("link", line.link.is_some()),
            ("task", line.task.is_some()),
            ("at", line.at.is_some()),
            ("restart_after", line.restart_after.is_some()),
            ("lasts", line.lasts.is_some()),
            ("action", line.action.is_some()),
            ("tick", line.tick.is_some()),
        ];
        let said: Vec<_> = kinds.iter().filter(|(_, said, ..)| *said).collect();
        let [&(kind, _, needs, may)] = said[..] else {
            let all: Vec<&str> = kinds.iter().map(|(kind, ..)| *kind).collect();
            return Err(format!("it says {} of {}: write one", said.len(), all.join(", ")));
        };
        for (word, said) in words {
            if needs.contains(&word) && !said {
                return Err(format!("`{kind}` needs `{word}`"));
            }
            if said && !needs.contains(&word) && !may.contains(&word) {
                return Err(format!("`{kind}` has no `{word}`"));
            }
        }
        let nth = |number: Option<u32>| {
            number.filter(|&nth| nth > 0).ok_or_else(|| format!("`{kind}` counts from 1"))
        };
        let text = |word: &Option<String>| word.clone().unwrap_or_default();
        let time = |word: &str, time: &Option<String>| {
            time.as_deref().map(|time| self.ticks(word, time)).transpose()
        };
        let at = || Ok::<_, String>(time("at", &line.at)?.unwrap_or(0));
        Ok(match kind {
            "lose" => Fault::Lose { link: self.link(&text(&line.link))?, nth: nth(line.lose)? },
            "copy" => Fault::Copy { link: self.link(&text(&line.link))?, nth: nth(line.copy)? },
            "overtake" => Fault::Overtake { link: self.link(&text(&line.link))?, nth: nth(line.overtake)? },
            "fail" => Fault::Fail { task: self.task(&text(&line.task))?, nth: nth(line.fail)? },
            "stop" => {
                let restart = time("restart_after", &line.restart_after)?;
                Fault::Stop { node: self.node(&text(&line.stop))?, at: at()?, restart }
            }
            "cut" => {
                let lasts = time("lasts", &line.lasts)?;
                Fault::Cut { link: self.cut(&text(&line.cut))?, at: at()?, lasts }
            }
            "pause" => {
                let before_action = match line.action.as_deref() {
                    None => false,
                    Some("waits") => true,
                    Some(other) => {
                        return Err(format!("action = \"{other}\": write \"waits\", or leave it out"));
                    }
                };
                let lasts = time("lasts", &line.lasts)?.unwrap_or(0);
                let lasts = u32::try_from(lasts).ok().filter(|ticks| *ticks > 0 && *ticks < u32::MAX);
                let lasts = lasts.ok_or("`pause` lasts at least a tick, and not for years")?;
                Fault::Pause { node: self.node(&text(&line.pause))?, at: at()?, lasts, before_action }
            }
            _ => {
                let more = match text(&line.tick).as_str() {
                    "twice" => true,
                    "missed" => false,
                    other => return Err(format!("tick = \"{other}\": write \"twice\" or \"missed\"")),
                };
                Fault::Drift { node: self.node(&text(&line.drift))?, at: at()?, more }
            }
        })
    }

    fn line(&self, fault: &Fault) -> Line {
        let mut line = Line::default();
        let time = |ticks: u64| Some(self.time(ticks));
        match *fault {
            Fault::Lose { link, nth } => {
                (line.lose, line.link) = (Some(nth), Some(self.link_name(link.0, link.1)));
            }
            Fault::Copy { link, nth } => {
                (line.copy, line.link) = (Some(nth), Some(self.link_name(link.0, link.1)));
            }
            Fault::Overtake { link, nth } => {
                (line.overtake, line.link) = (Some(nth), Some(self.link_name(link.0, link.1)));
            }
            Fault::Fail { task, nth } => (line.fail, line.task) = (Some(nth), Some(self.task_name(task))),
            Fault::Stop { node, at, restart } => {
                (line.stop, line.at) = (Some(self.node_name(node)), time(at));
                line.restart_after = restart.and_then(time);
            }
            Fault::Cut { link, at, lasts } => {
                let ends = self.table.cell().links.get(link);
                let ends =
                    ends.map(|link| format!("{} -- {}", self.node_name(link.a), self.node_name(link.b)));
                (line.cut, line.at, line.lasts) = (ends, time(at), lasts.and_then(time));
            }
            Fault::Pause { node, at, lasts, before_action } => {
                (line.pause, line.at) = (Some(self.node_name(node)), time(at));
                (line.lasts, line.action) = (time(lasts.into()), before_action.then(|| "waits".into()));
            }
            Fault::Drift { node, at, more } => {
                (line.drift, line.at) = (Some(self.node_name(node)), time(at));
                line.tick = Some(if more { "twice" } else { "missed" }.into());
            }
        }
        line
    }

    /// A number of ticks as text: `120ms`.
    pub fn time(&self, ticks: u64) -> String {
        humantime::format_duration(Duration::from_micros(ticks.saturating_mul(self.tick_us))).to_string()
    }

    fn ticks(&self, word: &str, time: &str) -> Result<u64, String> {
        let span = crate::time::parse(time).map_err(|error| format!("{word} = \"{time}\": {error}"))?;
        let (us, tick) = (span.as_nanos(), u128::from(self.tick_us) * 1000);
        if us % tick != 0 {
            return Err(format!("{word} = \"{time}\": the tick of the cell is {}", self.time(1)));
        }
        u64::try_from(us / tick).map_err(|_| format!("{word} = \"{time}\": too long"))
    }

    fn node_name(&self, node: NodeId) -> String {
        self.table.cell().nodes.get(node.index()).map_or("?", |node| &node.name).to_owned()
    }

    fn task_name(&self, task: TaskId) -> String {
        self.table.cell().tasks.get(task.index()).map_or("?", |task| &task.name).to_owned()
    }

    fn link_name(&self, from: NodeId, to: NodeId) -> String {
        format!("{} -> {}", self.node_name(from), self.node_name(to))
    }

    fn node(&self, name: &str) -> Result<NodeId, String> {
        let names = || self.table.cell().nodes.iter().map(|node| node.name.as_str());
        let at = names().position(|node| node == name);
        at.map(NodeId::from_index).ok_or_else(|| format!("no node `{name}`{}", did_you_mean(name, names())))
    }

    fn task(&self, name: &str) -> Result<TaskId, String> {
        let names = || self.table.cell().tasks.iter().map(|task| task.name.as_str());
        let at = names().position(|task| task == name);
        at.map(TaskId::from_index).ok_or_else(|| format!("no task `{name}`{}", did_you_mean(name, names())))
    }

    /// A link in one direction: `a -> b`.
    fn link(&self, text: &str) -> Result<(NodeId, NodeId), String> {
        let (from, to) =
            text.split_once("->").ok_or_else(|| format!("`{text}` is no link: write `a -> b`"))?;
        let ends = (self.node(from.trim())?, self.node(to.trim())?);
        self.between(ends).map(|_| ends)
    }

    /// A link in both directions: `a -- b`.
    fn cut(&self, text: &str) -> Result<usize, String> {
        let (from, to) =
            text.split_once("--").ok_or_else(|| format!("`{text}` is no link: write `a -- b`"))?;
        self.between((self.node(from.trim())?, self.node(to.trim())?))
    }

    fn between(&self, (from, to): (NodeId, NodeId)) -> Result<usize, String> {
        let links = &self.table.cell().links;
        let at =
            links.iter().position(|link| (link.a, link.b) == (from, to) || (link.b, link.a) == (from, to));
        at.ok_or_else(|| format!("no link joins {} and {}", self.node_name(from), self.node_name(to)))
    }
}
