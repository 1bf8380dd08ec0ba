//! An opened recording of observations (a film): its encoded frames, and the stops at which it can be shown. The
//! history of the present run is shown in the same way ([`History`](crate::history::History)).

use super::trouble::{Trouble, Troubles};
use crate::clock::{Moment, micros};
use crate::error::MonitorError;
use crate::source::{Arrival, Feed, SourceId};
use crate::store::Store;
use imrs_wire::files;
use imrs_wire::obs::{Events, Role, ServerFrame};
use imrs_wire::recording::{Ending, Record, RecordingReader, Shown, Step, Story, Stream};
use std::io::{BufReader, Read};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// The approximate size of a segment of a recording, in bytes.
const REEL: usize = 4 << 20;

/// A recorded frame, in its encoded form.
#[derive(Clone, Debug)]
struct Frame {
    at: Moment,
    source: u16,
    trouble: Trouble,
    /// The range of the frame in the bytes of its segment.
    bytes: Range<u32>,
}

/// A segment of consecutive frames, which a recording and the growing history can share.
#[derive(Clone, Debug, Default)]
pub struct Reel {
    bytes: Vec<u8>,
    frames: Vec<Frame>,
}

impl Reel {
    /// Adds a frame that shows this trouble. Returns false if the segment is full.
    pub fn put(&mut self, at: Moment, source: u16, trouble: Trouble, bytes: &[u8]) -> bool {
        let [start, end] = [self.bytes.len(), self.bytes.len() + bytes.len()].map(u32::try_from);
        let (Ok(start), Ok(end)) = (start, end) else { return false };
        self.bytes.extend_from_slice(bytes);
        self.frames.push(Frame { at, source, trouble, bytes: start..end });
        true
    }

    /// The memory that the segment takes, in bytes.
    #[must_use]
    pub fn weight(&self) -> usize {
        self.bytes.capacity() + self.frames.capacity() * size_of::<Frame>()
    }

    /// The arrival time of the segment's first frame.
    #[must_use]
    pub fn began(&self) -> Option<Moment> {
        self.frames.first().map(|frame| frame.at)
    }

    /// Releases unused memory.
    pub fn close(&mut self) {
        self.bytes.shrink_to_fit();
        self.frames.shrink_to_fit();
    }

    fn shown(&self, frame: &Frame) -> Option<Shown> {
        let bytes = self.bytes.get(frame.bytes.start as usize..frame.bytes.end as usize)?;
        Shown::decode(bytes).ok()
    }
}

/// A stop: an instant at which the recording can be shown. The state there follows from all frames up to it.
#[derive(Clone, Debug)]
pub struct Stop {
    /// The instant of the stop.
    pub at: Moment,
    /// The number of frames up to this stop.
    pub frames: usize,
    /// The gravest trouble between the previous stop and this one.
    pub trouble: Trouble,
}

/// A recording of observations. Frames stay encoded and are decoded when they are shown.
#[derive(Debug, Default)]
pub struct Film {
    /// The segments. With each of them, the number of frames up to its end.
    reels: Vec<(Arc<Reel>, usize)>,
    /// The segment that is being filled.
    open: Reel,
    /// The number of frames.
    frames: usize,
    /// The stops of the recording; there is at least one.
    stops: Vec<Stop>,
    /// The description of the counterexample, if the recording shows one.
    pub story: Option<Story>,
    /// The name of the cell, as the recording program knew it.
    pub cell: String,
    /// A note on the file: that it was cut off or is damaged.
    pub notice: Option<String>,
}

/// A decoded frame for the player.
pub(crate) enum Scene {
    Arrival(Arrival),
    Step(Step),
    Nothing,
}

impl Film {
    /// Opens a recording and reads it up to its last whole record.
    ///
    /// # Errors
    /// [`MonitorError::Recording`] if nothing can be shown: the file is missing, is not a recording of this version, or
    /// shows no nodes.
    pub fn open(path: &Path) -> Result<Self, MonitorError> {
        let failed = |why: String| MonitorError::Recording { path: path.to_owned(), why };
        let file = files::open(path).map_err(|error| failed(error.to_string()))?;
        Self::read(BufReader::new(file)).map_err(failed)
    }

    /// Reads a recording up to its last whole record.
    ///
    /// # Errors
    /// Says why nothing can be shown.
    pub fn read(source: impl Read) -> Result<Self, String> {
        let mut reader = RecordingReader::new(source).map_err(|error| error.to_string())?;
        if reader.header().node.is_some() {
            return Err("it has the inputs of one node, not what a monitor saw: see `imrs replay`".to_owned());
        }
        let mut film = Self { cell: reader.header().cell.clone(), ..Self::default() };
        let mut reading = Reading::default();
        loop {
            let offset = reader.offset();
            let damaged = |why: &dyn std::fmt::Display| format!("DAMAGED: {why}; shown up to there");
            match reader.next_record() {
                Ok(Some(Record::Frame { source, at, bytes })) => match Shown::decode(&bytes) {
                    Ok(shown) => film.add(source, at, &bytes, shown, &mut reading),
                    Err(error) if film.stops.is_empty() => return Err(error.to_string()),
                    Err(error) => {
                        film.notice = Some(damaged(&format_args!("at byte {offset}: {error}")));
                        break;
                    }
                },
                Ok(Some(Record::Gap { stream: Stream::Frames(source), lost })) => {
                    let at = film.stops.last().map_or(0, |stop| micros(stop.at));
                    let shown = Shown::Said(ServerFrame::Events(Events { lost, events: Vec::new() }));
                    film.add(source, at, &shown.encode(), shown, &mut reading);
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
        film.close();
        if film.stops.is_empty() {
            return Err(film.notice.unwrap_or_else(|| "nothing was recorded in it".to_owned()));
        }
        if film.notice.is_none() && reader.ending() != Ending::Ended {
            film.notice = Some("the recording was cut off: it has no end".to_owned());
        }
        Ok(film)
    }

    /// The history of the present run, as a film: `opening` has the state at the start of the history, `reels` the
    /// later frames.
    #[must_use]
    pub fn of(cell: String, opening: Arc<Reel>, reels: Vec<Arc<Reel>>) -> Self {
        let mut film = Self { cell, ..Self::default() };
        for reel in std::iter::once(opening).chain(reels) {
            for frame in &reel.frames {
                let opens = film.stops.last().is_none_or(|stop| stop.at < frame.at);
                film.stop(frame.at, opens, frame.trouble);
                film.frames += 1;
                film.end_stop();
            }
            film.reels.push((reel, film.frames));
        }
        film
    }

    /// Adds a frame to this recording.
    fn add(&mut self, source: u16, at: u64, bytes: &[u8], shown: Shown, reading: &mut Reading) {
        let at = Duration::from_micros(at);
        let opens = match &shown {
            Shown::Story(_) => false,
            Shown::Step(_) => true,
            Shown::Attached { .. } | Shown::Said(_) | Shown::Lost { .. } => {
                !reading.in_story && self.stops.last().is_none_or(|stop| stop.at < at)
            }
        };
        if let Shown::Story(story) = shown {
            reading.in_story = true;
            self.story = Some(story);
            return;
        }
        let trouble = reading.trouble(source, at, shown);
        self.stop(at, opens, trouble);
        if self.open.weight() + bytes.len() > REEL {
            self.close();
        }
        if self.open.put(at, source, trouble, bytes) {
            self.frames += 1;
        }
        self.end_stop();
    }

    /// Closes the segment that is being filled.
    fn close(&mut self) {
        let mut reel = std::mem::take(&mut self.open);
        reel.close();
        self.reels.push((Arc::new(reel), self.frames));
    }

    /// Starts a new stop if `opens`, and adds the trouble to the last stop.
    fn stop(&mut self, at: Moment, opens: bool, trouble: Trouble) {
        if opens {
            self.stops.push(Stop { at, frames: self.frames, trouble: Trouble::None });
        }
        if let Some(stop) = self.stops.last_mut() {
            stop.trouble = stop.trouble.max(trouble);
        }
    }

    /// Extends the last stop to all frames so far.
    fn end_stop(&mut self) {
        if let Some(stop) = self.stops.last_mut() {
            stop.frames = self.frames;
        }
    }

    /// The stops, in order.
    #[must_use]
    pub fn stops(&self) -> &[Stop] {
        &self.stops
    }

    /// The length of the recording: the time of its last stop.
    #[must_use]
    pub fn length(&self) -> Moment {
        self.stops.last().map_or(Duration::ZERO, |stop| stop.at)
    }

    /// The last stop at or before this time; the first stop if there is none before.
    #[must_use]
    pub fn stop_at(&self, at: Moment) -> usize {
        self.stops.partition_point(|stop| stop.at <= at).saturating_sub(1)
    }

    /// The number of frames of the recording.
    pub(crate) const fn frames(&self) -> usize {
        self.frames
    }

    /// Decodes the frame with this number.
    pub(crate) fn scene(&self, number: usize) -> Scene {
        let at = self.reels.partition_point(|(_, end)| *end <= number);
        let Some((reel, end)) = self.reels.get(at) else { return Scene::Nothing };
        let Some(frame) = (number + reel.frames.len()).checked_sub(*end).and_then(|n| reel.frames.get(n))
        else {
            return Scene::Nothing;
        };
        // Decoding cannot fail: `read` has already decoded the frame once, or the history has encoded it.
        let Some(shown) = reel.shown(frame) else { return Scene::Nothing };
        match shown {
            Shown::Step(step) => Scene::Step(step),
            shown => arrival(frame.at, frame.source, shown).map_or(Scene::Nothing, Scene::Arrival),
        }
    }
}

/// The arrival that a recorded frame stands for.
fn arrival(at: Moment, source: u16, shown: Shown) -> Option<Arrival> {
    let feed = match shown {
        Shown::Attached { hello, .. } => match hello.role {
            Role::Node(identity) => Feed::Attached { identity, pid: hello.pid, build: hello.build },
            Role::Monitor => return None,
        },
        Shown::Said(said) => Feed::Frame(Box::new(said)),
        Shown::Lost { why } => Feed::Lost { why },
        Shown::Step(_) | Shown::Story(_) => return None,
    };
    Some(Arrival { at, source: SourceId(source.into()), feed })
}

/// What is known while a recording is read.
#[derive(Default)]
struct Reading {
    in_story: bool,
    store: Store,
    troubles: Troubles,
}

impl Reading {
    /// The trouble that the next frame shows. The steps of a counterexample say this themselves.
    fn trouble(&mut self, source: u16, at: Moment, shown: Shown) -> Trouble {
        if let Shown::Step(step) = &shown {
            return if step.odd { Trouble::Grave } else { Trouble::None };
        }
        if self.in_story {
            return Trouble::None;
        }
        let trouble = self.troubles.of(&shown, SourceId(source.into()), at, &self.store);
        if let Some(arrival) = arrival(at, source, shown) {
            self.store.apply(arrival);
        }
        trouble
    }
}
