//! A screen that shows a specimen frame by frame.

use super::Specimen;
use crate::app::{App, Msg};
use crate::clock::Moment;
use crate::theme::Theme;
use crate::view::show;
use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use imrs_protocol::Ticks;
use imrs_wire::obs::{ServerFrame, Snapshot};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use std::time::Duration;

/// The time between two frames.
const FRAME: Duration = Duration::from_millis(33);
/// How many nodes send frames between two drawn frames.
const TELL: u64 = 10;
/// One of this many ports of a node has changed since the node's previous frame: 5 %.
const APART: usize = 20;

/// A screen: the app, the last state of its nodes, and the two buffers whose difference a terminal gets.
pub struct Shown {
    app: App,
    cell: Specimen,
    states: Vec<Snapshot>,
    now: Moment,
    frames: u64,
    shown: Buffer,
    drawn: Buffer,
}

impl Shown {
    /// The screen of a terminal of this size, after these keys were pressed; `\n` is Enter.
    #[must_use]
    pub fn new(cell: Specimen, (width, height): (u16, u16), keys: &str) -> Self {
        let now = Duration::from_secs(1);
        let mut app = App::new(Theme::COLOUR, None);
        for arrival in cell.arrivals(now) {
            app.update(Msg::Feed(arrival), now);
        }
        let mut drawn = Buffer::empty(Rect::new(0, 0, width, height));
        for key in keys.chars() {
            show(&mut app, now, &mut drawn);
            let code = if key == '\n' { KeyCode::Enter } else { KeyCode::Char(key) };
            app.update(Msg::Key(KeyEvent::new(code, KeyModifiers::NONE)), now);
        }
        let states = (0..cell.nodes).map(|node| cell.snapshot(node)).collect();
        drawn.reset();
        Self { app, cell, states, now, frames: 0, shown: drawn.clone(), drawn }
    }

    /// Advances by one frame: some of the nodes, in rotation, send a snapshot and events.
    pub fn go_on(&mut self) {
        self.now += FRAME;
        for turn in 0..TELL.min(self.cell.nodes.into()) {
            let node = (self.frames * TELL + turn) % u64::from(self.cell.nodes);
            let node = u16::try_from(node).unwrap_or(0);
            let state = &mut self.states[usize::from(node)];
            Specimen::go_on(state, self.frames, APART);
            drop_expired(state);
            for said in [ServerFrame::Snapshot(state.clone()), ServerFrame::Events(self.cell.events(node))] {
                self.app.update(Msg::Feed(Specimen::said(node, self.now, said)), self.now);
            }
        }
        self.frames += 1;
    }

    /// Draws a frame. Returns how many screen cells differ from the previous frame.
    pub fn draw(&mut self) -> usize {
        self.drawn.reset();
        show(&mut self.app, self.now, &mut self.drawn);
        let changed = self.shown.diff(&self.drawn).len();
        std::mem::swap(&mut self.shown, &mut self.drawn);
        changed
    }
}

/// Removes expired messages from a state.
fn drop_expired(state: &mut Snapshot) {
    for port in state.tasks.iter_mut().flat_map(|task| &mut task.view.ports) {
        if port.len == 0 || port.min_slack == Some(Ticks::ZERO) {
            (port.len, port.min_slack) = (0, None);
            port.queue.clear();
        }
    }
}
