//! A recording of observations, opened: its frames as they were recorded, and the stops at which it can be looked at.

use crate::clock::Moment;
use crate::error::MonitorError;
use crate::source::{Arrival, Feed, SourceId};
use crate::store::journal::{Level, level_of};
use imrs_wire::obs::{Events, Role, ServerFrame};
use imrs_wire::recording::{Ending, Record, RecordingReader, Shown, Step, Story, Stream};
use std::fs::File;
use std::io::{BufReader, Read};
use std::ops::Range;
use std::path::Path;
use std::time::Duration;

/// A frame, encoded as it was recorded.
#[derive(Clone, Debug)]
struct Frame {
    at: Moment,
    source: u16,
    /// Among the film's bytes.
    bytes: Range<usize>,
}

/// A state of the recording that can be looked at: after all frames up to here.
#[derive(Clone, Debug)]
pub struct Stop {
    /// When.
    pub at: Moment,
    /// How many frames came until then.
    pub frames: usize,
    /// Whether something went wrong since the stop before.
    pub odd: bool,
}

/// A recording of observations. Frames are kept as they were recorded and decoded when they are shown.
#[derive(Debug, Default)]
pub struct Film {
    bytes: Vec<u8>,
    frames: Vec<Frame>,
    /// Never empty.
    stops: Vec<Stop>,
    /// What it tells, if it is a counterexample.
    pub story: Option<Story>,
    /// The name of the cell, as the recording program knew it.
    pub cell: String,
    /// What is to be known of the file: that it was cut off, or is damaged.
    pub notice: Option<String>,
}

/// What a frame means to who shows it.
pub(crate) enum Scene {
    Arrival(Arrival),
    Step(Step),
    Nothing,
}

impl Film {
    /// Opens a recording and reads it as far as it is whole.
    ///
    /// # Errors
    /// [`MonitorError::Recording`] where nothing of it can be shown: it is not there, is no recording of this version,
    /// or shows no nodes.
    pub fn open(path: &Path) -> Result<Self, MonitorError> {
        let failed = |why: String| MonitorError::Recording { path: path.to_owned(), why };
        let file = File::open(path).map_err(|error| failed(error.to_string()))?;
        Self::read(BufReader::new(file)).map_err(failed)
    }

    /// Reads a recording as far as it is whole.
    ///
    /// # Errors
    /// Why nothing of it can be shown.
    pub fn read(source: impl Read) -> Result<Self, String> {
        let mut reader = RecordingReader::new(source).map_err(|error| error.to_string())?;
        if reader.header().node.is_some() {
            return Err("it has the inputs of one node, not what a monitor saw: see `imrs replay`".to_owned());
        }
        let mut film = Self { cell: reader.header().cell.clone(), ..Self::default() };
        let mut story = false;
        loop {
            let offset = reader.offset();
            let damaged = |why: &dyn std::fmt::Display| format!("DAMAGED: {why}; shown up to there");
            match reader.next_record() {
                Ok(Some(Record::Frame { source, at, bytes })) => match Shown::decode(&bytes) {
                    Ok(shown) => film.add(source, at, &bytes, shown, &mut story),
                    Err(error) if film.frames.is_empty() => return Err(error.to_string()),
                    Err(error) => {
                        film.notice = Some(damaged(&format_args!("at byte {offset}: {error}")));
                        break;
                    }
                },
                Ok(Some(Record::Gap { stream: Stream::Frames(source), lost })) => {
                    let at = film.stops.last().map_or(0, |stop| micros(stop.at));
                    let shown = Shown::Said(ServerFrame::Events(Events { lost, events: Vec::new() }));
                    film.add(source, at, &shown.encode(), shown, &mut story);
                }
                Ok(Some(
                    Record::Header(_)
                    | Record::Input { .. }
                    | Record::Keyframe { .. }
                    | Record::Script { .. }
                    | Record::Close { .. }
                    | Record::Gap { stream: Stream::Task(_), .. }
                    | Record::End,
                )) => {}
                Ok(None) => break,
                Err(error) => {
                    film.notice = Some(damaged(&error));
                    break;
                }
            }
        }
        if film.stops.is_empty() {
            return Err(film.notice.unwrap_or_else(|| "nothing was recorded in it".to_owned()));
        }
        if film.notice.is_none() && reader.ending() != Ending::Ended {
            film.notice = Some("the recording was cut off: it has no end".to_owned());
        }
        Ok(film)
    }

    /// Adds a frame. A step of a story, or a later time, is a stop of its own.
    fn add(&mut self, source: u16, at: u64, bytes: &[u8], shown: Shown, in_story: &mut bool) {
        let at = Duration::from_micros(at);
        let odd = match &shown {
            Shown::Step(step) => step.odd,
            Shown::Lost { .. } => !*in_story,
            Shown::Said(ServerFrame::Events(Events { events, .. })) => {
                !*in_story && events.iter().any(|event| level_of(event.what.event) == Level::Bad)
            }
            Shown::Said(ServerFrame::Table(_) | ServerFrame::Snapshot(_) | ServerFrame::Bye(_))
            | Shown::Attached { .. }
            | Shown::Story(_) => false,
        };
        let opens = match &shown {
            Shown::Story(_) => false,
            Shown::Step(_) => true,
            Shown::Attached { .. } | Shown::Said(_) | Shown::Lost { .. } => {
                !*in_story && self.stops.last().is_none_or(|stop| stop.at < at)
            }
        };
        if let Shown::Story(story) = shown {
            *in_story = true;
            self.story = Some(story);
            return;
        }
        let start = self.bytes.len();
        self.bytes.extend_from_slice(bytes);
        self.frames.push(Frame { at, source, bytes: start..self.bytes.len() });
        if opens {
            self.stops.push(Stop { at, frames: 0, odd: false });
        }
        if let Some(stop) = self.stops.last_mut() {
            stop.frames = self.frames.len();
            stop.odd |= odd;
        }
    }

    /// The states that can be looked at, in their order.
    #[must_use]
    pub fn stops(&self) -> &[Stop] {
        &self.stops
    }

    /// How long it is.
    #[must_use]
    pub fn length(&self) -> Moment {
        self.stops.last().map_or(Duration::ZERO, |stop| stop.at)
    }

    /// The last stop at this time or before it; the first where there is none.
    #[must_use]
    pub fn stop_at(&self, at: Moment) -> usize {
        self.stops.partition_point(|stop| stop.at <= at).saturating_sub(1)
    }

    /// How many frames it has.
    pub(crate) const fn frames(&self) -> usize {
        self.frames.len()
    }

    /// Frame number so.
    pub(crate) fn scene(&self, number: usize) -> Scene {
        let Some(frame) = self.frames.get(number) else { return Scene::Nothing };
        // It was decoded when the file was read.
        let Ok(shown) = Shown::decode(&self.bytes[frame.bytes.clone()]) else { return Scene::Nothing };
        let feed = match shown {
            Shown::Attached { hello, .. } => match hello.role {
                Role::Node(identity) => Feed::Attached { identity, pid: hello.pid, build: hello.build },
                Role::Monitor => return Scene::Nothing,
            },
            Shown::Said(said) => Feed::Frame(Box::new(said)),
            Shown::Lost { why } => Feed::Lost { why },
            Shown::Step(step) => return Scene::Step(step),
            Shown::Story(_) => return Scene::Nothing,
        };
        Scene::Arrival(Arrival { at: frame.at, source: SourceId(frame.source.into()), feed })
    }
}

fn micros(at: Moment) -> u64 {
    u64::try_from(at.as_micros()).unwrap_or(u64::MAX)
}
