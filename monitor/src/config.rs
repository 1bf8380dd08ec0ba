//! The user's configuration file, `$XDG_CONFIG_HOME/imrs/monitor.toml`. Options on the command line take precedence.

use crate::options::Endpoint;
use crate::query::Filter;
use crate::theme::Theme;
use imrs_wire::files::{self, FileError};
use schemars::JsonSchema;
use serde::Deserialize;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// An example file: every key with its meaning, commented out.
pub const EXAMPLE: &str = include_str!("config.toml");

/// Longest accepted file, in bytes.
const LONGEST: u64 = 1 << 20;

/// The contents of the file. An unknown key is an error, so that a typing error is noticed.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// The theme: `colour`, `light`, `contrast`, `mono`, `ascii`, `colour-ascii`. Default: by the abilities of the terminal.
    pub theme: Option<String>,
    /// Whether the mouse is used. Without it the terminal's own selection works.
    pub mouse: Option<bool>,
    /// Whether the screen is redrawn only once a second, and after input.
    pub reduced_motion: Option<bool>,
    /// The nodes to attach to: `unix:PATH` or `tcp:HOST:PORT`. Default: all on this machine.
    pub connect: Vec<String>,
    /// The file with the token for nodes that require one.
    pub token: Option<PathBuf>,
    /// The cell to show if there are several.
    pub cell: Option<String>,
    /// The initial filter, as typed after `/`.
    pub filter: Option<String>,
}

/// Why the file cannot be used.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// It cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: FileError,
    },
    /// Its contents are wrong.
    #[error("{path}: {what}")]
    Wrong {
        /// The file.
        path: PathBuf,
        /// The place and the reason.
        what: String,
    },
}

impl Config {
    /// Reads the file `named`, or otherwise the user's file if it exists. `var` returns environment variables.
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

    /// Reads the text of the file.
    ///
    /// # Errors
    /// The place and the reason of an error.
    pub fn parse(text: &str) -> Result<Self, String> {
        let config: Self = toml::from_str(text).map_err(|error| error.to_string().trim_end().to_owned())?;
        if let Some(theme) = &config.theme
            && Theme::named(theme).is_none()
        {
            return Err(format!(
                "no theme `{}`: there are {}",
                crate::name::shown(theme),
                Theme::names().join(", ")
            ));
        }
        for endpoint in &config.connect {
            endpoint.parse::<Endpoint>().map_err(|error| format!("connect: {error}"))?;
        }
        if let Some(filter) = &config.filter {
            Filter::parse(filter).map_err(|error| format!("filter: {error}"))?;
        }
        Ok(config)
    }

    /// The nodes to attach to.
    #[must_use]
    pub fn endpoints(&self) -> Vec<Endpoint> {
        self.connect.iter().filter_map(|endpoint| endpoint.parse().ok()).collect()
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
        let Config { theme, mouse, reduced_motion, connect, token, cell, filter } = config;
        assert!(theme.is_some() && mouse.is_some() && reduced_motion.is_some() && !connect.is_empty());
        assert!(token.is_some() && cell.is_some() && filter.is_some());
        let schema = Config::schema();
        let keys = schema["properties"].as_object().expect("properties");
        for line in set.lines() {
            let key = line.split(" = ").next().unwrap_or_default().trim();
            assert!(keys.contains_key(key), "{key}: {schema}");
        }
        assert_eq!(keys.len(), set.lines().count());
    }

    #[test]
    fn what_is_wrong_is_told_with_its_place() {
        let wrong = |text: &str| Config::parse(text).unwrap_err();
        let unknown = wrong("theme = \"mono\"\ncolour = 3\n");
        assert!(unknown.contains("line 2") && unknown.contains("unknown field `colour`"), "{unknown}");
        assert!(wrong("theme = \"pink\"").contains("there are colour"), "{}", wrong("theme = \"pink\""));
        assert!(wrong("connect = [\"here\"]").contains("write unix:PATH or tcp:HOST:PORT"));
        assert!(wrong("filter = \"slak<3ms\"").contains("did you mean `slack`"));
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
