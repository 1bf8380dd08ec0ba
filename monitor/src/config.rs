//! The user's configuration file, `$XDG_CONFIG_HOME/imrs/monitor.toml`. Options on the command line take precedence.

use crate::checked::{Checked, FilterText};
use crate::column::OverviewColumn;
use crate::keymap::Keymap;
use crate::options::Endpoint;
use crate::theme::{Own, Theme};
use imrs_wire::files::{self, FileError};
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// An example of the file: every key with its meaning, commented out.
pub const EXAMPLE: &str = include_str!("config.toml");

/// The greatest accepted length of the file, in bytes.
const LONGEST: u64 = 1 << 20;

/// The contents of the file. An unknown key is an error, so that a typing error is noticed. Each value is checked while
/// it is read, so that an error names its line.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// The theme: `colour`, `light`, `contrast`, `mono`, `ascii`, `colour-ascii`. Default: by the abilities of the terminal.
    #[schemars(with = "Option<String>")]
    pub theme: Option<Checked<Theme>>,
    /// Colours of roles instead of the theme's: `head`, `dim`, `good`, `warn`, `bad`, `alarm`, `bar`.
    #[schemars(with = "BTreeMap<String, String>")]
    pub palette: Own,
    /// Whether the mouse is used. Without it the terminal's own selection works.
    pub mouse: Option<bool>,
    /// Whether the screen is redrawn only once a second, and after input.
    pub reduced_motion: Option<bool>,
    /// Actions, each with its keys instead of its usual ones.
    #[schemars(with = "BTreeMap<String, Vec<String>>")]
    pub keys: Keymap,
    /// The columns of the overview after the names: `state`, `queue`, `slack`, `rate`, `expired`, `overflow`, `rejected`,
    /// `resent`, `timed_out`, `health`. Default: those that have room.
    #[schemars(with = "Vec<String>")]
    pub columns: Vec<Checked<OverviewColumn>>,
    /// The nodes to attach to: `unix:PATH` or `tcp:HOST:PORT`. Default: all on this machine.
    #[schemars(with = "Vec<String>")]
    pub connect: Vec<Checked<Endpoint>>,
    /// The file with the token for nodes that require one.
    pub token: Option<PathBuf>,
    /// The cell to show if there are several.
    pub cell: Option<String>,
    /// The initial filter, as typed after `/`.
    #[schemars(with = "Option<String>")]
    pub filter: Option<Checked<FilterText>>,
}

/// Why the file cannot be used.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// The path of the file.
        path: PathBuf,
        /// The reason, as an error.
        source: FileError,
    },
    /// The contents of the file are wrong.
    #[error("{path}: {what}")]
    Wrong {
        /// The path of the file.
        path: PathBuf,
        /// The place in the file, and the reason.
        what: String,
    },
}

impl Config {
    /// Reads the file `named` or, without it, the user's own file if it exists. `var` returns environment variables.
    ///
    /// # Errors
    /// [`ConfigError`]. A missing file is an error only if it was named.
    pub fn load(named: Option<&Path>, var: impl Fn(&str) -> Option<String>) -> Result<Self, ConfigError> {
        let Some(path) = named.map(Path::to_owned).or_else(|| place(var)) else { return Ok(Self::default()) };
        match files::text(&path, LONGEST) {
            Ok(text) => Self::parse(&text).map_err(|what| ConfigError::Wrong { path, what }),
            Err(FileError::Io(error)) if error.kind() == io::ErrorKind::NotFound && named.is_none() => {
                Ok(Self::default())
            }
            Err(source) => Err(ConfigError::Io { path, source }),
        }
    }

    /// Reads the settings from the text of a file.
    ///
    /// # Errors
    /// The place of the error in the text, and the reason.
    pub fn parse(text: &str) -> Result<Self, String> {
        toml::from_str(text).map_err(|error| error.to_string().trim_end().to_owned())
    }

    /// The nodes to attach to.
    #[must_use]
    pub fn endpoints(&self) -> Vec<Endpoint> {
        self.connect.iter().map(|endpoint| endpoint.0.clone()).collect()
    }

    /// The schema of the file, as JSON Schema.
    #[must_use]
    pub fn schema() -> serde_json::Value {
        schemars::schema_for!(Self).to_value()
    }
}

/// The path of the user's file, if the environment names a folder for it.
#[must_use]
pub fn place(var: impl Fn(&str) -> Option<String>) -> Option<PathBuf> {
    let set = |name: &str| var(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let base = set("XDG_CONFIG_HOME").or_else(|| Some(set("HOME")?.join(".config")))?;
    Some(base.join("imrs/monitor.toml"))
}

/// The path of the file in which the chosen theme is stored: `$XDG_STATE_HOME/imrs/monitor-theme`.
#[must_use]
pub fn memory(var: impl Fn(&str) -> Option<String>) -> Option<PathBuf> {
    Some(state_folder(var)?.join("monitor-theme"))
}

/// The file that keeps the typed lines: `$XDG_STATE_HOME/imrs/monitor-lines`.
#[must_use]
pub fn lines(var: impl Fn(&str) -> Option<String>) -> Option<PathBuf> {
    Some(state_folder(var)?.join("monitor-lines"))
}

fn state_folder(var: impl Fn(&str) -> Option<String>) -> Option<PathBuf> {
    let set = |name: &str| var(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let base = set("XDG_STATE_HOME").or_else(|| Some(set("HOME")?.join(".local/state")))?;
    Some(base.join("imrs"))
}

/// Reads the theme in the file at [`memory`]'s path; `None` if the file has no valid theme.
#[must_use]
pub fn remembered(path: &Path) -> Option<Theme> {
    Theme::named(files::text(path, 64).ok()?.trim())
}

/// Writes the name of a theme into the file at [`memory`]'s path.
///
/// # Errors
/// The error of the file or of its folder.
pub fn remember(path: &Path, theme: &Theme) -> io::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    std::fs::write(path, theme.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_stands_in_the_example_and_in_the_schema() {
        assert_eq!(Config::parse(EXAMPLE), Ok(Config::default()));
        // Each key is commented out with a valid value.
        let set: String = EXAMPLE
            .lines()
            .filter_map(|line| line.strip_prefix('#'))
            .filter(|line| line.contains(" = "))
            .map(|line| format!("{line}\n"))
            .collect();
        let config = Config::parse(&set).unwrap_or_else(|why| panic!("{why}\n{set}"));
        let Config { theme, palette, mouse, reduced_motion, keys, columns, connect, token, cell, filter } =
            config;
        assert!(theme.is_some() && mouse.is_some() && reduced_motion.is_some() && !connect.is_empty());
        assert!(token.is_some() && cell.is_some() && filter.is_some());
        assert!(palette != Own::default() && keys != Keymap::default() && !columns.is_empty());
        let schema = Config::schema();
        let known = schema["properties"].as_object().expect("properties");
        for line in set.lines() {
            let key = line.split(" = ").next().unwrap_or_default().trim();
            let key = key.split('.').next().unwrap_or_default();
            assert!(known.contains_key(key), "{key}: {schema}");
        }
        assert_eq!(known.len(), set.lines().count());
    }

    #[test]
    fn what_is_wrong_is_told_with_its_place() {
        let wrong = |text: &str| Config::parse(text).unwrap_err();
        // For an error in a list, the line is the one on which the list begins.
        let cases = [
            ("theme = \"mono\"\ncolour = 3\n", 2, "unknown field `colour`"),
            ("\n\ntheme = \"pink\"", 3, "there are colour"),
            (
                "\nconnect = [\n\"tcp:a:1\",\n\"here\"]",
                2,
                "`here` names no endpoint: write unix:PATH or tcp:HOST:PORT",
            ),
            ("mouse = true\nfilter = \"slak<3ms\"", 2, "did you mean `slack`"),
            ("mouse = true\n[keys]\npaus = \"p\"", 3, "no action `paus`: did you mean `pause`?"),
            ("[keys]\npause = \"p\"\ntheme = \"hyper\"", 3, "no key `hyper`"),
            ("[keys]\npause = [\"p\",\n\"hyper\"]", 2, "no key `hyper`"),
            ("[keys]\npause = \"p\"\ntheme = \"p\"", 1, "`p` cannot be both `pause` and `theme`"),
            ("\ncolumns = [\"state\", \"heath\"]", 2, "no column `heath`: did you mean `health`?"),
            ("palette.bad = \"#d55e00\"\npalette.god = \"red\"", 2, "did you mean `good`"),
            ("\npalette.bad = \"reddish\"", 2, "no colour `reddish`"),
            ("mouse = \"yes\"", 1, "expected a boolean"),
        ];
        for (text, line, said) in cases {
            let error = wrong(text);
            assert!(error.contains(&format!("line {line},")) && error.contains(said), "{text}: {error}");
        }
    }

    #[test]
    fn the_chosen_theme_is_remembered() {
        let folder = tempfile::tempdir().unwrap();
        let home = folder.path().to_str().unwrap().to_owned();
        let path = memory(|name| (name == "HOME").then(|| home.clone())).unwrap();
        assert!(path.ends_with(".local/state/imrs/monitor-theme"));
        assert_eq!(remembered(&path), None);
        remember(&path, &Theme::CONTRAST).unwrap();
        assert_eq!(remembered(&path), Some(Theme::CONTRAST));
        std::fs::write(&path, "pink").unwrap();
        assert_eq!(remembered(&path), None);
        assert_eq!(memory(|_| None), None);
    }

    #[test]
    fn the_file_is_where_the_desktop_says() {
        let var = |vars: &'static [(&str, &str)]| {
            move |name: &str| vars.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned())
        };
        let at = place(var(&[("XDG_CONFIG_HOME", "/c"), ("HOME", "/h")]));
        assert_eq!(at, Some("/c/imrs/monitor.toml".into()));
        assert_eq!(place(var(&[("HOME", "/h")])), Some("/h/.config/imrs/monitor.toml".into()));
        assert_eq!(place(var(&[])), None);
        assert!(matches!(Config::load(None, var(&[])), Ok(config) if config == Config::default()));
        let named = Config::load(Some(Path::new("/not/there.toml")), var(&[]));
        assert!(matches!(named, Err(ConfigError::Io { .. })));
    }
}
