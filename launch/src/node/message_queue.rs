//! Sends a node's messages to the launcher on a thread of its own, so that a stopped launcher never blocks the node.

use crate::pipe::{Word, say};
use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};

/// If the queue is at least this long, a node defers messages that it can send later.
const WAITING: usize = 16_384;

/// An unbounded queue of messages to the launcher, and the thread that writes them in order.
pub struct MessageQueue {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    words: Mutex<Words>,
    changed: Condvar,
}

#[derive(Default)]
struct Words {
    waiting: VecDeque<Word>,
    /// How many messages the thread has taken from the queue, and has not written to the pipe yet.
    in_hand: usize,
    ended: bool,
    /// The error of the pipe; most likely the launcher has exited.
    failed: Option<io::Error>,
}

impl MessageQueue {
    /// Starts the thread that writes the messages.
    ///
    /// # Errors
    /// An error if the operating system refuses a thread.
    pub fn start(pipe: Box<dyn Write + Send>) -> io::Result<Self> {
        let shared = Arc::<Shared>::default();
        let own = Arc::clone(&shared);
        let thread = thread::Builder::new().name("imrs teller".into()).spawn(move || own.write(pipe))?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Queues a message without waiting.
    ///
    /// # Errors
    /// An error if the pipe has failed.
    pub fn say(&self, word: Word) -> io::Result<()> {
        let mut words = self.shared.lock();
        if let Some(error) = &words.failed {
            return Err(error.kind().into());
        }
        words.waiting.push_back(word);
        self.shared.changed.notify_all();
        Ok(())
    }

    /// Whether the queue is short enough. If not, the node should add only messages that cannot wait.
    pub fn has_room(&self) -> bool {
        let words = self.shared.lock();
        words.waiting.len() + words.in_hand < WAITING
    }

    /// Waits until all messages have been written to the pipe.
    ///
    /// # Errors
    /// An error if the pipe has failed.
    pub fn end(mut self) -> io::Result<()> {
        self.close();
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        }
        self.shared.lock().failed.take().map_or(Ok(()), Err)
    }

    fn close(&self) {
        self.shared.lock().ended = true;
        self.shared.changed.notify_all();
    }
}

impl Drop for MessageQueue {
    fn drop(&mut self) {
        self.close();
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Words> {
        self.words.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self, mut pipe: Box<dyn Write + Send>) {
        loop {
            let mut words = self.lock();
            words.in_hand = 0;
            while words.waiting.is_empty() {
                if words.ended {
                    return;
                }
                words = self.changed.wait(words).unwrap_or_else(PoisonError::into_inner);
            }
            let some = std::mem::take(&mut words.waiting);
            words.in_hand = some.len();
            drop(words);
            if let Err(error) = some.iter().try_for_each(|word| say(&mut pipe, word)) {
                self.lock().failed = Some(error);
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipe::hear;
    use std::io::BufReader;

    #[test]
    fn a_launcher_that_stands_still_keeps_nobody_waiting_and_hears_everything_later() {
        let (words, pipe) = io::pipe().expect("a pipe");
        let queue = MessageQueue::start(Box::new(pipe)).expect("a thread");
        // The test sends more messages than the pipe holds. If they were written to the pipe directly, it
        // would block here for ever.
        let mut told = 0;
        while queue.has_room() {
            queue.say(Word::Told(told)).expect("nobody has gone");
            told += 1;
        }
        queue.say(Word::Done).expect("what cannot wait is told, too");
        let mut words = BufReader::new(words);
        for until in 0..told {
            assert_eq!(hear(&mut words).expect("a word"), Some(Word::Told(until)));
        }
        assert_eq!(hear(&mut words).expect("a word"), Some(Word::Done));
        queue.end().expect("everything was heard");
        assert_eq!(hear::<Word>(&mut words).expect("the end"), None);
    }

    #[test]
    fn a_launcher_that_has_gone_is_an_error() {
        let (words, pipe) = io::pipe().expect("a pipe");
        drop(words);
        let queue = MessageQueue::start(Box::new(pipe)).expect("a thread");
        queue.say(Word::Started).expect("nobody has tried yet");
        assert_eq!(queue.end().expect_err("nobody reads").kind(), io::ErrorKind::BrokenPipe);
    }
}
