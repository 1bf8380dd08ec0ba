//! Takes over the terminal, and restores it however the monitor ends.

use crate::error::MonitorError;
use crossterm::clipboard::CopyToClipboard;
use crossterm::cursor::{Hide, Show};
use crossterm::event::{DisableMouseCapture, EnableMouseCapture};
use crossterm::execute;
use crossterm::terminal::{EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode};
use ratatui::Terminal;
use ratatui::backend::{Backend, CrosstermBackend};
use ratatui::layout::Rect;
use std::io::{self, BufWriter, Stdout};
use std::panic;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether the monitor holds the terminal. Set before the terminal changes, so that a signal in between still restores it.
static BORROWED: AtomicBool = AtomicBool::new(false);

/// The terminal while the monitor draws on it. Dropping it restores the terminal.
#[derive(Debug)]
pub struct Borrowed {
    terminal: Terminal<CrosstermBackend<BufWriter<Stdout>>>,
    mouse: bool,
}

impl Borrowed {
    /// Takes the terminal, with or without its mouse. A panic in any thread restores it before the panic is reported.
    ///
    /// # Errors
    /// [`MonitorError::Terminal`].
    pub fn take(mouse: bool) -> Result<Self, MonitorError> {
        // With NO_COLOR crossterm drops all styles, including the selection. The theme handles NO_COLOR instead.
        crossterm::style::force_color_output(true);
        let report = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            give_back();
            report(info);
        }));
        grab(mouse).map_err(MonitorError::Terminal)?;
        let backend = CrosstermBackend::new(BufWriter::new(io::stdout()));
        let terminal = Terminal::new(backend).map_err(|e| {
            give_back();
            MonitorError::Terminal(e)
        })?;
        Ok(Self { terminal, mouse })
    }

    /// The area of the screen.
    ///
    /// # Errors
    /// The error of the query for its size.
    pub fn area(&self) -> io::Result<Rect> {
        let size = self.terminal.backend().size()?;
        Ok(Rect::from((ratatui::layout::Position::ORIGIN, size)))
    }

    /// Copies `text` to the terminal's clipboard (OSC 52); a terminal without one ignores it.
    ///
    /// # Errors
    /// [`MonitorError::Terminal`].
    pub fn copy(&mut self, text: &str) -> Result<(), MonitorError> {
        execute!(io::stdout(), CopyToClipboard::to_clipboard_from(text)).map_err(MonitorError::Terminal)
    }

    /// Draws one frame with `view`.
    ///
    /// # Errors
    /// [`MonitorError::Terminal`].
    pub fn draw(&mut self, view: impl FnOnce(&mut ratatui::buffer::Buffer)) -> Result<(), MonitorError> {
        let drawn = self.terminal.draw(|frame| view(frame.buffer_mut()));
        drawn.map(|_| ()).map_err(MonitorError::Terminal)
    }

    /// Takes the terminal again after it was released, and forgets its contents.
    ///
    /// # Errors
    /// [`MonitorError::Terminal`].
    pub fn take_again(&mut self) -> Result<(), MonitorError> {
        grab(self.mouse).map_err(MonitorError::Terminal)?;
        // Resizing clears the screen without a query for the cursor, which some terminals do not answer.
        let again = self
            .terminal
            .backend()
            .size()
            .and_then(|size| self.terminal.resize(Rect::from((ratatui::layout::Position::ORIGIN, size))));
        again.map_err(MonitorError::Terminal)
    }
}

impl Drop for Borrowed {
    fn drop(&mut self) {
        give_back();
    }
}

/// Whether the monitor holds the terminal.
#[must_use]
pub fn is_borrowed() -> bool {
    BORROWED.load(Ordering::SeqCst)
}

fn grab(mouse: bool) -> io::Result<()> {
    BORROWED.store(true, Ordering::SeqCst);
    enable_raw_mode()
        .and_then(|()| execute!(io::stdout(), EnterAlternateScreen, Hide))
        .and_then(|()| if mouse { execute!(io::stdout(), EnableMouseCapture) } else { Ok(()) })
        .inspect_err(|_| give_back())
}

/// Restores the terminal, once. Errors are ignored, because no caller is left to receive them.
pub fn give_back() {
    if BORROWED.swap(false, Ordering::SeqCst) {
        let _ = disable_raw_mode();
        let _ = execute!(io::stdout(), DisableMouseCapture, Show, LeaveAlternateScreen);
    }
}
