//! Values of the settings file that are checked while it is read, so that an error names its line.

use crate::keymap::Keymap;
use crate::keys::{Action, Key};
use crate::query::Filter;
use crate::theme::{Ink, Own};
use ratatui::style::Color;
use serde::de::{Deserialize, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use std::fmt;
use std::marker::PhantomData;
use std::str::FromStr;

/// A value that was parsed from a text of the settings file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checked<T>(pub T);

impl<'de, T: FromStr<Err: fmt::Display>> Deserialize<'de> for Checked<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map(Self).map_err(D::Error::custom)
    }
}

/// The text of a filter, which is a condition or words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilterText(pub String);

impl FromStr for FilterText {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Filter::parse(text).map(|_| Self(text.to_owned())).map_err(|error| error.to_string())
    }
}

/// A colour: `#d55e00`, a number of the terminal's 256 colours, or a name.
struct Colour(Color);

impl FromStr for Colour {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!("no colour `{}`: write `#d55e00`, a number to 255, or `red`", crate::name::shown(text))
        };
        text.parse().map(Self).map_err(|_| wrong())
    }
}

/// One text or a list of texts.
struct OneOrMany<T>(Vec<T>);

impl<'de, T: FromStr<Err: fmt::Display>> Deserialize<'de> for OneOrMany<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Texts<T>(PhantomData<T>);
        impl<'de, T: FromStr<Err: fmt::Display>> Visitor<'de> for Texts<T> {
            type Value = Vec<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a text, or a list of texts")
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<Vec<T>, E> {
                text.parse().map(|one| vec![one]).map_err(E::custom)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Vec<T>, A::Error> {
                let mut all = Vec::new();
                while let Some(Checked(one)) = list.next_element()? {
                    all.push(one);
                }
                Ok(all)
            }
        }
        deserializer.deserialize_any(Texts(PhantomData)).map(Self)
    }
}

impl<'de> Deserialize<'de> for Keymap {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Table;
        impl<'de> Visitor<'de> for Table {
            type Value = Keymap;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("actions with their keys")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Keymap, A::Error> {
                let mut own: Vec<(Action, Vec<Key>)> = Vec::new();
                while let Some((Checked(action), OneOrMany(keys))) = map.next_entry()? {
                    own.push((action, keys));
                }
                Keymap::of(own).map_err(A::Error::custom)
            }
        }
        deserializer.deserialize_map(Table)
    }
}

impl<'de> Deserialize<'de> for Own {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Table;
        impl<'de> Visitor<'de> for Table {
            type Value = Own;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("roles with their colours")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Own, A::Error> {
                let mut own = Own::default();
                while let Some((Checked(ink), Checked(Colour(colour)))) = map.next_entry()? {
                    own.set(ink, colour);
                }
                Ok(own)
            }
        }
        deserializer.deserialize_map(Table)
    }
}

impl FromStr for Ink {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Own::ROLES.iter().find(|(_, name)| *name == text);
        found.map(|(ink, _)| *ink).ok_or_else(|| {
            let names: Vec<_> = Own::ROLES.iter().map(|(_, name)| *name).collect();
            crate::name::unknown("role of a colour", text, &names)
        })
    }
}
