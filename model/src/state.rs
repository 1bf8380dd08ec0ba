//! Packed states, each a block of bytes, which the searches hash and compare.

use std::fmt;

/// The number of bytes before the specification state: violation, budgets, flags, and steps since the last tick.
pub(crate) const HEADER: usize = 7;

/// A packed state. States with equal bytes behave alike from then on.
#[derive(Clone, PartialEq, Eq, Hash)]
pub struct Packed(pub(crate) Box<[u8]>);

impl Packed {
    /// The violation that the state holds, if there is one. Such a state is absorbing: no transition leaves it.
    #[must_use]
    pub fn violation(&self) -> Option<Violation> {
        Violation::from_code(self.0.first().copied().unwrap_or(0))
    }

    /// Whether the state has no successors: the state holds a violation, or the property is already shown to be reachable.
    #[must_use]
    pub fn is_final(&self) -> bool {
        self.violation().is_some() || self.0.len() <= HEADER
    }

    /// The length of the state in bytes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Always false: every state has at least a violation code.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl fmt::Debug for Packed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

macro_rules! violations {
    ($($name:ident $code:literal $text:literal),* $(,)?) => {
        /// How a state violates a property.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Violation {
            $(#[doc = $text] $name),*
        }

        impl Violation {
            pub(crate) const fn code(self) -> u8 {
                match self { $(Self::$name => $code),* }
            }

            pub(crate) const fn from_code(code: u8) -> Option<Self> {
                match code { $($code => Some(Self::$name),)* _ => None }
            }

            /// The text of the violation, in one line.
            #[must_use]
            pub const fn text(self) -> &'static str {
                match self { $(Self::$name => $text),* }
            }
        }
    };
}

violations! {
    FalseRelease 1 "a member was released before all had arrived in its round",
    Unpaired 2 "members count different rounds as the same rendezvous",
    Stranded 3 "a member waits though all have arrived and nothing is in flight",
    GaveUpAfterAllArrived 4 "a member gave up though all had arrived",
    Divergent 5 "one member was released from a round that another left without a release",
    Released 6 "a member was released",
    NotMet 7 "too many attempts since the faults stopped, and no member was released",
    Stale 8 "a message was handed over after its sender's time_out",
    SecondOutcome 9 "a command ended twice",
    NoOutcome 10 "a command did not end within its time_out and one tick",
    WrongAnswer 11 "an answer belongs to another command",
    ExecutedTwice 12 "a command was handed over twice",
    LateAnswer 13 "an answer given within its execution budget came after the sender's time_out",
    Unanswered 19 "a command ended without its answer",
    NotOutranking 30 "a handler ran that does not outrank what it interrupts",
    TooDeep 31 "handlers interrupted each other too deeply",
    Bypassed 32 "the head of a port was bypassed too often",
    RefusedTooOften 33 "a message was rejected by rank too often",
    NotServed 34 "a message was not served though it arrived in time",
    CommandEvicted 35 "a command made room while a status message stayed in the buffer",
    Zeno 36 "too much happens between two ticks",
    Faulted 37 "a request without fault was called faulty",
    TooEarly 42 "a delay ended before its time",
    BothActive 41 "both tasks of a couple act at a time",
    OldEpoch 43 "a task becomes active in an epoch that is not new",
    OldOrder 44 "an order was executed though one of a newer epoch had arrived",
    TtlExtended 45 "a message that waits has more time left than its sender waits for it",
    NotExpired 46 "a message still waits though its sender's time_out is over",
    RanAnyway 47 "a command ran that was reported to its sender as not run",
    HandedOverTwice 48 "a message was taken in or handed over twice",
    FalseCopy 49 "a message was dropped as a copy, and no earlier one had been taken in",
    NotMostUrgent 50 "a message was served before a more urgent one",
    LostMoreUrgent 51 "a full buffer lost a message that was more urgent than one that it kept",
    ExpiredEarly 52 "a message expired before its time was over",
    BufferDiffers 53 "a buffer holds other messages than those put in and not taken out, or in another order",
    Miscounted 54 "a message was not rejected as often as its node counts",
    Garbled 55 "a packet is another one after its bytes",
    Fused 56 "a fused step differs from the small steps that it stands for",
    StaleCheck 57 "a check has another value than the search took for granted",
    Script 39 "a script ended in a fault or an assertion that does not hold",
    Check 40 "a check of the cell does not hold",
    Reached 38 "what must be possible is possible",
    Stuck 15 "nothing more can happen, and a task waits",
    Overflow 20 "the state outgrew its packed form",
    Panic 21 "the machine panicked",
    Invariant 22 "an invariant of the machine is broken",
}
