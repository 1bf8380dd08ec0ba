//! The receivers of other libraries on one thread, each with a mailbox: tasks of tokio, and actors of kameo, ractor and
//! actix.

use crate::cases::urgent::Message;
use crate::sample::nanos_of;
use std::future::Future;
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, oneshot};

/// How many messages fit into a mailbox.
pub const ROOM: usize = 2_048;
const SERVICE: Duration = Duration::from_micros(2);

/// A message that gets no answer.
#[derive(Debug)]
pub enum Note {
    /// A message of a stream.
    Plain(Message),
    /// A message that takes 2 us of work.
    Work,
    /// An urgent message, with the time at which it was sent.
    Urgent(Instant),
}

/// The receiver that every library runs. It serves the messages and answers the question [`Took`].
#[derive(Debug, Default)]
pub struct Clerk {
    took: u64,
}

impl Clerk {
    fn take(&mut self, note: Note) {
        match note {
            Note::Plain(message) => {
                std::hint::black_box(message);
            }
            Note::Work => {
                let begins = Instant::now();
                while begins.elapsed() < SERVICE {
                    std::hint::spin_loop();
                }
            }
            Note::Urgent(sent) => self.took = nanos_of(sent.elapsed()),
        }
    }
}

/// A handle to a receiver of a library.
pub trait Post: Clone + 'static {
    /// Asks how long the last urgent message took until it was served, in nanoseconds.
    fn ask(&self) -> impl Future<Output = u64>;
    /// Sends a message to the receiver; waits while the mailbox is full.
    fn tell(&self, note: Note) -> impl Future<Output = ()>;
}

/// A task of tokio with a channel for messages, and a channel for each answer.
#[derive(Clone)]
pub struct Tokio(mpsc::Sender<(Option<Note>, Option<oneshot::Sender<u64>>)>);

impl Tokio {
    /// Starts the task on the current runtime.
    pub fn start() -> Self {
        let (tell, mut told) = mpsc::channel::<(Option<Note>, Option<oneshot::Sender<u64>>)>(ROOM);
        tokio::spawn(async move {
            let mut clerk = Clerk::default();
            while let Some((note, answer)) = told.recv().await {
                note.into_iter().for_each(|note| clerk.take(note));
                if let Some(answer) = answer {
                    let _ = answer.send(clerk.took);
                }
            }
        });
        Self(tell)
    }
}

impl Post for Tokio {
    async fn ask(&self) -> u64 {
        let (answer, answered) = oneshot::channel();
        self.0.send((None, Some(answer))).await.expect("it listens");
        answered.await.expect("an answer")
    }
    async fn tell(&self, note: Note) {
        self.0.send((Some(note), None)).await.expect("it listens");
    }
}

/// An actor of kameo.
#[derive(Clone)]
pub struct Kameo(pub kameo::actor::ActorRef<Clerk>);

/// The question that every receiver answers.
pub struct Took;

impl kameo::Actor for Clerk {
    type Args = Self;
    type Error = std::convert::Infallible;
    async fn on_start(clerk: Self, _: kameo::actor::ActorRef<Self>) -> Result<Self, Self::Error> {
        Ok(clerk)
    }
}

impl kameo::message::Message<Took> for Clerk {
    type Reply = u64;
    async fn handle(&mut self, _: Took, _: &mut kameo::message::Context<Self, u64>) -> u64 {
        self.took
    }
}

impl kameo::message::Message<Note> for Clerk {
    type Reply = ();
    async fn handle(&mut self, note: Note, _: &mut kameo::message::Context<Self, ()>) {
        self.take(note);
    }
}

impl Kameo {
    /// Starts the actor on the current runtime.
    pub fn start() -> Self {
        use kameo::Actor;
        Self(Clerk::spawn_with_mailbox(Clerk::default(), kameo::mailbox::bounded(ROOM)))
    }
}

impl Post for Kameo {
    async fn ask(&self) -> u64 {
        self.0.ask(Took).await.expect("an answer")
    }
    async fn tell(&self, note: Note) {
        self.0.tell(note).await.expect("it listens");
    }
}

/// An actor of ractor. Its mailbox has no bound.
#[derive(Clone)]
pub struct Ractor(ractor::ActorRef<RactorNote>);

/// The messages of a ractor actor.
pub enum RactorNote {
    Note(Note),
    Took(ractor::RpcReplyPort<u64>),
}

struct RactorClerk;

impl ractor::Actor for RactorClerk {
    type Msg = RactorNote;
    type State = Clerk;
    type Arguments = ();
    async fn pre_start(
        &self,
        _: ractor::ActorRef<RactorNote>,
        (): (),
    ) -> Result<Clerk, ractor::ActorProcessingErr> {
        Ok(Clerk::default())
    }
    async fn handle(
        &self,
        _: ractor::ActorRef<RactorNote>,
        note: RactorNote,
        clerk: &mut Clerk,
    ) -> Result<(), ractor::ActorProcessingErr> {
        match note {
            RactorNote::Note(note) => clerk.take(note),
            RactorNote::Took(answer) => {
                let _ = answer.send(clerk.took);
            }
        }
        Ok(())
    }
}

impl Ractor {
    /// Starts the actor on the current runtime.
    pub async fn start() -> Self {
        let (actor, _) = ractor::Actor::spawn(None, RactorClerk, ()).await.expect("it starts");
        Self(actor)
    }

    /// Ends the actor.
    pub fn stop(&self) {
        self.0.stop(None);
    }
}

impl Post for Ractor {
    async fn ask(&self) -> u64 {
        match self.0.call(RactorNote::Took, None).await.expect("it listens") {
            ractor::rpc::CallResult::Success(took) => took,
            ractor::rpc::CallResult::Timeout | ractor::rpc::CallResult::SenderError => {
                panic!("no answer")
            }
        }
    }
    async fn tell(&self, note: Note) {
        self.0.cast(RactorNote::Note(note)).expect("it listens");
    }
}

/// An actor of actix.
#[derive(Clone)]
pub struct Actix(actix::Addr<Clerk>);

impl actix::Actor for Clerk {
    type Context = actix::Context<Self>;
    fn started(&mut self, context: &mut Self::Context) {
        context.set_mailbox_capacity(ROOM);
    }
}

impl actix::Message for Took {
    type Result = u64;
}

impl actix::Message for Note {
    type Result = ();
}

impl actix::Handler<Took> for Clerk {
    type Result = u64;
    fn handle(&mut self, _: Took, _: &mut Self::Context) -> u64 {
        self.took
    }
}

impl actix::Handler<Note> for Clerk {
    type Result = ();
    fn handle(&mut self, note: Note, _: &mut Self::Context) {
        self.take(note);
    }
}

impl Actix {
    /// Starts the actor on the current system.
    pub fn start() -> Self {
        Self(actix::Actor::start(Clerk::default()))
    }
}

impl Post for Actix {
    async fn ask(&self) -> u64 {
        self.0.send(Took).await.expect("an answer")
    }
    async fn tell(&self, note: Note) {
        // `do_send` ignores the mailbox's bound; `try_send` reports a full mailbox.
        let mut note = note;
        loop {
            match self.0.try_send(note) {
                Ok(()) => return,
                Err(actix::dev::SendError::Full(back)) => {
                    note = back;
                    tokio::task::yield_now().await;
                }
                Err(actix::dev::SendError::Closed(_)) => panic!("it listens no more"),
            }
        }
    }
}
