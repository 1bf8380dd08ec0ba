//! Receivers on one thread with a mailbox: tasks of tokio, and actors of kameo, ractor and actix.

use crate::cases::urgent::Message;
use crate::sample::nanos_of;
use std::future::Future;
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, oneshot};

/// How many messages fit in a mailbox.
pub const ROOM: usize = 2_048;
const SERVICE: Duration = Duration::from_micros(2);

/// A message without an answer.
#[derive(Debug)]
pub enum Mail {
    /// A message of a stream.
    Plain(Message),
    /// One that takes 2 us of work.
    Work,
    /// An urgent one, and when it was sent.
    Urgent(Instant),
}

/// The receiver that every peer runs.
#[derive(Debug, Default)]
pub struct Clerk {
    took: u64,
}

impl Clerk {
    fn take(&mut self, mail: Mail) {
        match mail {
            Mail::Plain(message) => {
                std::hint::black_box(message);
            }
            Mail::Work => {
                let begins = Instant::now();
                while begins.elapsed() < SERVICE {
                    std::hint::spin_loop();
                }
            }
            Mail::Urgent(sent) => self.took = nanos_of(sent.elapsed()),
        }
    }
}

/// A handle to such a receiver.
pub trait Post: Clone + 'static {
    /// Asks how long the last urgent message took until it was served, in nanoseconds.
    fn ask(&self) -> impl Future<Output = u64>;
    /// Sends a message; waits while the mailbox is full.
    fn tell(&self, mail: Mail) -> impl Future<Output = ()>;
}

/// A task of tokio with a channel for messages, and a channel for each answer.
#[derive(Clone)]
pub struct Tokio(mpsc::Sender<(Option<Mail>, Option<oneshot::Sender<u64>>)>);

impl Tokio {
    /// Starts it on the current runtime.
    pub fn start() -> Self {
        let (tell, mut told) = mpsc::channel::<(Option<Mail>, Option<oneshot::Sender<u64>>)>(ROOM);
        tokio::spawn(async move {
            let mut clerk = Clerk::default();
            while let Some((mail, answer)) = told.recv().await {
                mail.into_iter().for_each(|mail| clerk.take(mail));
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
    async fn tell(&self, mail: Mail) {
        self.0.send((Some(mail), None)).await.expect("it listens");
    }
}

/// An actor of kameo.
#[derive(Clone)]
pub struct Kameo(pub kameo::actor::ActorRef<Clerk>);

/// The question that every actor answers.
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

impl kameo::message::Message<Mail> for Clerk {
    type Reply = ();
    async fn handle(&mut self, mail: Mail, _: &mut kameo::message::Context<Self, ()>) {
        self.take(mail);
    }
}

impl Kameo {
    /// Starts it on the current runtime.
    pub fn start() -> Self {
        use kameo::Actor;
        Self(Clerk::spawn_with_mailbox(Clerk::default(), kameo::mailbox::bounded(ROOM)))
    }
}

impl Post for Kameo {
    async fn ask(&self) -> u64 {
        self.0.ask(Took).await.expect("an answer")
    }
    async fn tell(&self, mail: Mail) {
        self.0.tell(mail).await.expect("it listens");
    }
}

/// An actor of ractor. Its mailbox has no bound.
#[derive(Clone)]
pub struct Ractor(ractor::ActorRef<RactorMail>);

/// The messages of a ractor actor.
pub enum RactorMail {
    Mail(Mail),
    Took(ractor::RpcReplyPort<u64>),
}

struct RactorClerk;

impl ractor::Actor for RactorClerk {
    type Msg = RactorMail;
    type State = Clerk;
    type Arguments = ();
    async fn pre_start(
        &self,
        _: ractor::ActorRef<RactorMail>,
        (): (),
    ) -> Result<Clerk, ractor::ActorProcessingErr> {
        Ok(Clerk::default())
    }
    async fn handle(
        &self,
        _: ractor::ActorRef<RactorMail>,
        mail: RactorMail,
        clerk: &mut Clerk,
    ) -> Result<(), ractor::ActorProcessingErr> {
        match mail {
            RactorMail::Mail(mail) => clerk.take(mail),
            RactorMail::Took(answer) => {
                let _ = answer.send(clerk.took);
            }
        }
        Ok(())
    }
}

impl Ractor {
    /// Starts it on the current runtime.
    pub async fn start() -> Self {
        let (actor, _) = ractor::Actor::spawn(None, RactorClerk, ()).await.expect("it starts");
        Self(actor)
    }

    /// Ends it.
    pub fn stop(&self) {
        self.0.stop(None);
    }
}

impl Post for Ractor {
    async fn ask(&self) -> u64 {
        match self.0.call(RactorMail::Took, None).await.expect("it listens") {
            ractor::rpc::CallResult::Success(took) => took,
            ractor::rpc::CallResult::Timeout | ractor::rpc::CallResult::SenderError => {
                panic!("no answer")
            }
        }
    }
    async fn tell(&self, mail: Mail) {
        self.0.cast(RactorMail::Mail(mail)).expect("it listens");
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

impl actix::Message for Mail {
    type Result = ();
}

impl actix::Handler<Took> for Clerk {
    type Result = u64;
    fn handle(&mut self, _: Took, _: &mut Self::Context) -> u64 {
        self.took
    }
}

impl actix::Handler<Mail> for Clerk {
    type Result = ();
    fn handle(&mut self, mail: Mail, _: &mut Self::Context) {
        self.take(mail);
    }
}

impl Actix {
    /// Starts it on the current system.
    pub fn start() -> Self {
        Self(actix::Actor::start(Clerk::default()))
    }
}

impl Post for Actix {
    async fn ask(&self) -> u64 {
        self.0.send(Took).await.expect("an answer")
    }
    async fn tell(&self, mail: Mail) {
        // `do_send` has no bound; `try_send` reports a full mailbox.
        let mut mail = mail;
        loop {
            match self.0.try_send(mail) {
                Ok(()) => return,
                Err(actix::dev::SendError::Full(back)) => {
                    mail = back;
                    tokio::task::yield_now().await;
                }
                Err(actix::dev::SendError::Closed(_)) => panic!("it listens no more"),
            }
        }
    }
}
