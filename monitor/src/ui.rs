//! The main loop of the screen: it handles messages and draws at most thirty frames a second.

use crate::app::{App, Effect, Msg};
use crate::background::LateAnswer;
use crate::clock::{Clock, Moment};
use crate::config;
use crate::error::MonitorError;
use crate::judge::{ConformanceWorker, Judge};
use crate::keeper::Keeper;
use crate::name::shown_line;
use crate::options::Endpoint;
use crate::record::{Tape, free_name};
use crate::signals::{self, Call, Listener};
use crate::source::live::{Live, Which};
use crate::source::{Sink, Source};
use crate::terminal::{self, Borrowed};
use crate::view;
use crossterm::event::{self, Event};
use signal_hook::consts::SIGINT;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// The least time between two frames.
const FRAME: Duration = Duration::from_millis(33);
/// The least time after a user's input, which must be answered quickly.
const ANSWER: Duration = Duration::from_millis(8);
/// How many messages may be queued. A source that sends more is blocked, and its node then combines its snapshots.
const QUEUE: usize = 64;
/// How often the keyboard thread checks whether it must end, which is also the longest delay of leaving the monitor.
const LOOK: Duration = Duration::from_millis(50);

/// The numbers of sources that the user adds start here; sources that are found automatically have lower numbers.
const MORE: u32 = 60_000;
/// How many numbers each source that the user adds may use.
const EACH: u32 = 256;
/// The name of the file to which a screen is written; a number makes it unique.
const FRAME_FILE: &str = "monitor-screen.txt";

/// The files that the screen writes.
pub struct Files {
    /// The file of the record key.
    pub record: PathBuf,
    /// The file of the typed lines, if they are kept.
    pub lines: Option<PathBuf>,
}

enum Input {
    Msg(Msg),
    Call(Call),
    /// The terminal is gone, so no key press will arrive any more.
    NoKeys,
}

/// Shows `source` on the terminal until the user quits. Every arrival passes through `tape`.
///
/// # Errors
/// [`MonitorError`].
pub fn show(
    mut source: impl Source,
    clock: Clock,
    mut app: App,
    tape: &Arc<Tape>,
    files: Files,
    judge: Option<Arc<dyn Judge>>,
) -> Result<(), MonitorError> {
    let (sender, inputs) = sync_channel(QUEUE);
    let mut terminal = Borrowed::take(app.mouse)?;
    let for_signals = sender.clone();
    let listener = Listener::start(move |call| for_signals.try_send(Input::Call(call)).is_ok())?;
    let (for_feeds, taped) = (sender.clone(), Arc::clone(tape));
    let judged = sender.clone();
    let worker = ConformanceWorker::open(
        judge,
        Sink::new(clock, move |arrival| judged.send(Input::Msg(Msg::Feed(arrival))).is_ok()),
    );
    let hears = worker.clone();
    source.start(Sink::new(clock, move |arrival| {
        taped.take(&arrival);
        hears.hear(&arrival.feed);
        for_feeds.send(Input::Msg(Msg::Feed(arrival))).is_ok()
    }))?;
    let keys = Some(Keys::start(sender.clone())?);
    let told = sender.clone();
    // When a line cannot be saved, the main loop may have ended already, and then the error is dropped.
    let tell = move |text| drop(told.try_send(Input::Msg(Msg::Told(text))));
    let keeper = files.lines.map(|path| Keeper::start(path, tell));
    let mut screen = Loop {
        app: &mut app,
        clock,
        inputs,
        due: Some(Duration::ZERO),
        drawn: None,
        tape,
        record: files.record,
        sender,
        keys,
        keeper,
        more: Vec::new(),
        worker,
        gaps: 0,
    };
    let ended = screen.run(&mut terminal);
    // The keyboard thread must end before the terminal is restored, because it would take input meant for the shell.
    drop(screen);
    drop(terminal);
    if let Ok(Some(signal)) = ended {
        listener.end_as(signal);
    }
    ended.map(|_| ())
}

struct Loop<'a> {
    app: &'a mut App,
    clock: Clock,
    inputs: Receiver<Input>,
    /// When the next frame is due; `None` if none is.
    due: Option<Moment>,
    drawn: Option<Moment>,
    tape: &'a Arc<Tape>,
    /// The file that the record key writes.
    record: PathBuf,
    /// A sender of inputs, for sources that the user adds and for the keyboard thread.
    sender: SyncSender<Input>,
    /// The keyboard thread; `None` while the terminal is released.
    keys: Option<Keys>,
    /// Writes the typed lines, if they are kept.
    keeper: Option<Keeper>,
    /// The sources that the user added.
    more: Vec<Live>,
    /// The worker that judges the recordings that nodes announce.
    worker: ConformanceWorker,
    /// The store's count of gaps at the last check.
    gaps: u64,
}

impl Loop<'_> {
    /// Runs until the user quits or a signal ends the monitor. Returns that signal.
    fn run(&mut self, terminal: &mut Borrowed) -> Result<Option<i32>, MonitorError> {
        loop {
            // If a panic in another thread has restored the terminal, nothing may be drawn any more.
            if !terminal::is_borrowed() {
                return Err(MonitorError::Internal);
            }
            let now = self.clock.now();
            if self.due.is_some_and(|due| due <= now) {
                self.app.update(Msg::Time, now);
                self.wish();
                terminal.draw(|buffer| view::show(self.app, now, buffer))?;
                self.drawn = Some(now);
                self.due = self.app.redraw_after().map(|after| now + after);
            }
            let wait = self.due.map_or(LOOK, |due| due.saturating_sub(self.clock.now()));
            let first = match self.inputs.recv_timeout(wait) {
                Ok(input) => input,
                Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => return Err(MonitorError::Internal),
            };
            // All queued inputs are handled before the next frame.
            let more: Vec<_> = self.inputs.try_iter().take(QUEUE).collect();
            for input in std::iter::once(first).chain(more) {
                match self.take(input, terminal)? {
                    Next::GoOn => {}
                    Next::Quit => return Ok(None),
                    Next::EndAs(signal) => return Ok(Some(signal)),
                }
            }
        }
    }

    fn take(&mut self, input: Input, terminal: &mut Borrowed) -> Result<Next, MonitorError> {
        let apart = match &input {
            Input::Msg(Msg::Key(_) | Msg::Mouse(_) | Msg::Resize) => ANSWER,
            _ => FRAME,
        };
        let effect = match input {
            Input::Msg(msg) => self.app.update(msg, self.clock.now()),
            // SIGINT means ^C, and ^C quits. If the monitor ended by the signal itself, the parent shell would also
            // abort its script.
            Input::Call(Call::End(SIGINT)) => return Ok(Next::Quit),
            Input::Call(Call::End(signal)) => return Ok(Next::EndAs(signal)),
            Input::Call(Call::Stop) => Effect::Suspend,
            Input::Call(Call::GoOn) => {
                terminal.take_again()?;
                Effect::Draw
            }
            Input::NoKeys => return Ok(Next::Quit),
        };
        if let (Some(typed), Some(keeper)) = (self.app.take_typed(), &self.keeper) {
            keeper.keep(typed);
        }
        match effect {
            Effect::Nothing => {}
            Effect::Draw => {
                let soonest = self.drawn.map_or(Duration::ZERO, |drawn| drawn + apart);
                self.due = Some(self.due.map_or(soonest, |due| due.min(soonest)));
            }
            Effect::Record => {
                self.toggle_recording();
                self.due = Some(Duration::ZERO);
            }
            Effect::Write => {
                let told = self.write(terminal);
                self.tell(told);
            }
            Effect::Copy(text) => {
                terminal.copy(&text)?;
                self.due = Some(Duration::ZERO);
            }
            Effect::Connect(endpoint) => {
                if let Err(error) = self.connect(endpoint) {
                    self.tell(format!("cannot attach: {error}"));
                }
                self.due = Some(Duration::ZERO);
            }
            Effect::Mouse(mouse) => {
                terminal.use_mouse(mouse)?;
                self.due = Some(Duration::ZERO);
            }
            Effect::Theme => {
                self.remember_theme();
                self.due = Some(Duration::ZERO);
            }
            Effect::Suspend => {
                // The keyboard thread must end first, because it would take input meant for the shell.
                self.keys = None;
                terminal::give_back();
                signals::stop();
                terminal.take_again()?;
                self.keys = Some(Keys::start(self.sender.clone())?);
                self.due = Some(Duration::ZERO);
            }
            Effect::Quit => return Ok(Next::Quit),
        }
        Ok(Next::GoOn)
    }
}

impl Loop<'_> {
    /// Stores the theme for later monitors, if there is a place for it.
    fn remember_theme(&mut self) {
        if let Some(path) = &self.app.remember
            && let Err(error) = config::remember(path, &self.app.theme)
        {
            let path = shown_line(&path.display().to_string());
            self.tell(format!("the theme is not remembered: {path}: {error}"));
        }
    }

    /// Passes the screen's subscription to the sources.
    fn wish(&mut self) {
        let wishes = self.tape.wishes();
        wishes.want(self.app.want());
        let gaps = self.app.live().gaps();
        if std::mem::replace(&mut self.gaps, gaps) < gaps {
            wishes.want_whole();
        }
    }

    /// Starts or ends a recording. An error is shown on the bottom line.
    fn toggle_recording(&mut self) {
        if self.tape.stop().is_some() {
            self.app.recording = None;
            return;
        }
        let path = free_name(&self.record);
        let shown = shown_line(&path.display().to_string());
        match self.tape.start(&path, self.clock.now()) {
            Ok(()) => self.app.recording = Some(shown),
            Err(error) => self.tell(format!("cannot record: {error}")),
        }
    }
}

impl Loop<'_> {
    /// Shows a text on the bottom line.
    fn tell(&mut self, text: String) {
        self.app.update(Msg::Told(text), self.clock.now());
        self.due = Some(Duration::ZERO);
    }

    /// Writes the present screen to a new file. Returns a text that names the file.
    fn write(&self, terminal: &Borrowed) -> String {
        let path = free_name(Path::new(FRAME_FILE));
        let written = terminal.area().and_then(|area| {
            let page = view::page(self.app, self.clock.now(), (area.width, area.height));
            File::create_new(&path)?.write_all(page.as_bytes())
        });
        match written {
            Ok(()) => format!("this screen is in {}", shown_line(&path.display().to_string())),
            Err(error) => format!("cannot write {}: {error}", shown_line(&path.display().to_string())),
        }
    }

    /// Attaches to another node until the monitor ends.
    fn connect(&mut self, endpoint: Endpoint) -> Result<(), MonitorError> {
        // This reserves numbers for the nodes that will be found through this node.
        let number = u32::try_from(self.more.len()).unwrap_or(u32::MAX);
        let first = MORE.saturating_add(number.saturating_mul(EACH));
        let (taped, worker, sender) = (Arc::clone(self.tape), self.worker.clone(), self.sender.clone());
        let mut source = Live::new(Which::Named(vec![endpoint]))
            .numbered_from(first)
            .with_token(self.app.token.clone())
            .with_wishes(self.tape.wishes());
        source.start(Sink::new(self.clock, move |arrival| {
            taped.take(&arrival);
            worker.hear(&arrival.feed);
            sender.send(Input::Msg(Msg::Feed(arrival))).is_ok()
        }))?;
        self.more.push(source);
        Ok(())
    }
}

enum Next {
    GoOn,
    Quit,
    EndAs(i32),
}

/// The keyboard thread. Dropping this value ends the thread and joins it.
struct Keys {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Keys {
    fn start(sender: SyncSender<Input>) -> Result<Self, MonitorError> {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let read = move || {
            let mut late = LateAnswer::default();
            while !stopped.load(Ordering::Relaxed) {
                let input = match event::poll(LOOK).and_then(|ready| ready.then(event::read).transpose()) {
                    Ok(Some(Event::Key(key))) if late.has(&key) => continue,
                    Ok(Some(Event::Key(key))) => Input::Msg(Msg::Key(key)),
                    Ok(Some(Event::Mouse(mouse))) => Input::Msg(Msg::Mouse(mouse)),
                    Ok(Some(Event::Resize(..))) => Input::Msg(Msg::Resize),
                    Ok(_) => continue,
                    Err(_) => Input::NoKeys,
                };
                let last = matches!(input, Input::NoKeys);
                if !hand_over(&sender, input, &stopped) || last {
                    return;
                }
            }
        };
        let thread = thread::Builder::new().name("imrs-keys".into()).spawn(read);
        Ok(Self { stop, thread: Some(thread.map_err(MonitorError::Terminal)?) })
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was already reported; the terminal is restored anyway.
            let _ = thread.join();
        }
    }
}

/// Passes an input to the main loop as soon as there is room. Returns false if the thread must end: the main loop then
/// waits for the thread, and takes no input.
fn hand_over(sender: &SyncSender<Input>, mut input: Input, stopped: &AtomicBool) -> bool {
    loop {
        match sender.try_send(input) {
            Ok(()) => return true,
            Err(TrySendError::Disconnected(_)) => return false,
            Err(TrySendError::Full(_)) if stopped.load(Ordering::Relaxed) => return false,
            Err(TrySendError::Full(again)) => input = again,
        }
        thread::sleep(Duration::from_millis(1));
    }
}
