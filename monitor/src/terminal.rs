//! The terminal is borrowed: whatever ends the monitor, it is given back as it was.

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

/// Whether the terminal is ours now. Set before it is changed, so that a signal in between still restores it.
static BORROWED: AtomicBool = AtomicBool::new(false);

/// The terminal, while the monitor draws on it. Dropping it gives it back.
#[derive(Debug)]
pub struct Borrowed {
    terminal: Terminal<CrosstermBackend<BufWriter<Stdout>>>,
    mouse: bool,
}

impl Borrowed {
    /// Takes the terminal, with its mouse or without, and makes sure that a panic in any thread gives it back before it is reported.
    ///
    /// # Errors
    /// [`MonitorError::Terminal`].
    pub fn take(mouse: bool) -> Result<Self, MonitorError> {
        // crossterm answers NO_COLOR with a reset of all styles, the selection's too. The theme knows of it instead.
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
    /// What the terminal answers instead of its size.
    pub fn area(&self) -> io::Result<Rect> {
        let size = self.terminal.backend().size()?;
        Ok(Rect::from((ratatui::layout::Position::ORIGIN, size)))
    }

    /// Gives `text` to the terminal's clipboard (OSC 52); a terminal that has none ignores it.
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
    pub fn draw(
        &mut self,
        view: impl FnOnce(Rect, &mut ratatui::buffer::Buffer),
    ) -> Result<(), MonitorError> {
        let drawn = self.terminal.draw(|frame| view(frame.area(), frame.buffer_mut()));
        drawn.map(|_| ()).map_err(MonitorError::Terminal)
    }

    /// Takes the terminal again after it was given back, and forgets what was on it.
    ///
    /// # Errors
    /// [`MonitorError::Terminal`].
    pub fn take_again(&mut self) -> Result<(), MonitorError> {
        grab(self.mouse).map_err(MonitorError::Terminal)?;
        // Resizing clears without asking the terminal where its cursor is, which not every terminal answers.
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

/// Whether the terminal is ours now.
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

/// Gives the terminal back, once. Errors are of no use here: there is nobody left to tell.
pub fn give_back() {
    if BORROWED.swap(false, Ordering::SeqCst) {
        let _ = disable_raw_mode();
        let _ = execute!(io::stdout(), DisableMouseCapture, Show, LeaveAlternateScreen);
    }
}
