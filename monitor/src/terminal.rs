//! Takes over the terminal, and restores it however the monitor ends.

use crate::error::MonitorError;
use crossterm::clipboard::CopyToClipboard;
use crossterm::cursor::{Hide, Show};
use crossterm::event::{DisableMouseCapture, EnableMouseCapture};
use crossterm::terminal::{
    BeginSynchronizedUpdate, EndSynchronizedUpdate, EnterAlternateScreen, LeaveAlternateScreen,
    disable_raw_mode, enable_raw_mode,
};
use crossterm::{execute, queue};
use ratatui::Terminal;
use ratatui::backend::{Backend, CrosstermBackend};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use std::io::{self, BufWriter, Stdout, Write};
use std::panic;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether the monitor holds the terminal. It is set before the terminal changes, so that a signal right then still
/// restores the terminal.
static BORROWED: AtomicBool = AtomicBool::new(false);

/// How many bytes are collected before they are written: a whole frame of a large screen.
const FRAME_BYTES: usize = 1 << 18;

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
        let backend = CrosstermBackend::new(BufWriter::with_capacity(FRAME_BYTES, io::stdout()));
        let terminal = Terminal::new(backend).map_err(|e| {
            give_back();
            MonitorError::Terminal(e)
        })?;
        Ok(Self { terminal, mouse })
    }

    /// The size of the screen, as an area.
    ///
    /// # Errors
    /// The error of asking the terminal for its size.
    pub fn area(&self) -> io::Result<Rect> {
        let size = self.terminal.backend().size()?;
        Ok(Rect::from((ratatui::layout::Position::ORIGIN, size)))
    }

    /// Copies `text` to the terminal's clipboard (OSC 52). A terminal without a clipboard ignores this.
    ///
    /// # Errors
    /// [`MonitorError::Terminal`].
    pub fn copy(&mut self, text: &str) -> Result<(), MonitorError> {
        execute!(io::stdout(), CopyToClipboard::to_clipboard_from(text)).map_err(MonitorError::Terminal)
    }

    /// Takes the mouse, or leaves it to the terminal.
    ///
    /// # Errors
    /// [`MonitorError::Terminal`].
    pub fn use_mouse(&mut self, mouse: bool) -> Result<(), MonitorError> {
        self.mouse = mouse;
        let done = if mouse {
            execute!(io::stdout(), EnableMouseCapture)
        } else {
            execute!(io::stdout(), DisableMouseCapture)
        };
        done.map_err(MonitorError::Terminal)
    }

    /// Draws one frame with `view`.
    ///
    /// # Errors
    /// [`MonitorError::Terminal`].
    pub fn draw(&mut self, view: impl FnOnce(&mut Buffer)) -> Result<(), MonitorError> {
        frame(&mut self.terminal, view).map_err(MonitorError::Terminal)
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

/// Draws one frame as a synchronized update: the terminal shows the frame only when the frame is complete. Terminals
/// that do not know synchronized updates ignore the marks of their beginning and end.
fn frame<W: Write>(
    terminal: &mut Terminal<CrosstermBackend<W>>,
    view: impl FnOnce(&mut Buffer),
) -> io::Result<()> {
    queue!(terminal.backend_mut(), BeginSynchronizedUpdate)?;
    let drawn = terminal.draw(|frame| view(frame.buffer_mut())).map(|_| ());
    // The update ends even if drawing failed, because the terminal would otherwise hold back the shell's output, too.
    execute!(terminal.backend_mut(), EndSynchronizedUpdate).and(drawn)
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
        let _ =
            execute!(io::stdout(), EndSynchronizedUpdate, DisableMouseCapture, Show, LeaveAlternateScreen);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::{TerminalOptions, Viewport};
    use std::cell::RefCell;
    use std::rc::Rc;

    #[derive(Clone, Default)]
    struct Written(Rc<RefCell<Vec<u8>>>);

    impl Write for Written {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.borrow_mut().write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_frame_is_one_synchronized_update() {
        let options = TerminalOptions { viewport: Viewport::Fixed(Rect::new(0, 0, 20, 2)) };
        let out = Written::default();
        let mut terminal = Terminal::with_options(CrosstermBackend::new(out.clone()), options).unwrap();
        for (text, next) in [("first", "second"), ("second", "third")] {
            frame(&mut terminal, |buffer| {
                buffer.set_string(0, 0, text, ratatui::style::Style::new());
            })
            .unwrap();
            let written = out.0.take();
            let written = String::from_utf8(written).unwrap();
            let inner = written.strip_prefix("\x1b[?2026h").and_then(|rest| rest.strip_suffix("\x1b[?2026l"));
            let inner = inner.unwrap_or_else(|| panic!("{written:?}"));
            assert!(inner.contains(text) && !inner.contains("2026") && !inner.contains(next), "{inner:?}");
        }
    }
}
