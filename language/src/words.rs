//! The keywords of the language. Reserved keywords are never names; free keywords may also be names, and are keywords only
//! where the grammar expects them.

macro_rules! words {
    (reserved { $($r:ident $rt:literal,)* } free { $($f:ident $ft:literal,)* }) => {
        /// A keyword of the language.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Word {
            $(#[doc = concat!("`", $rt, "`")] $r,)*
            $(#[doc = concat!("`", $ft, "`")] $f,)*
        }

        impl Word {
            /// All reserved keywords: they are never names.
            pub const RESERVED: &[Self] = &[$(Self::$r,)*];
            /// All free keywords: they may also be names.
            pub const FREE: &[Self] = &[$(Self::$f,)*];

            /// The keyword's text, as the formatter writes it.
            #[must_use]
            pub const fn text(self) -> &'static str {
                match self { $(Self::$r => $rt,)* $(Self::$f => $ft,)* }
            }

            /// Whether the keyword is reserved, so that it cannot be a name.
            #[must_use]
            pub const fn is_reserved(self) -> bool {
                match self { $(Self::$r => true,)* $(Self::$f => false,)* }
            }

            fn of_lower(text: &str) -> Option<Self> {
                match text { $($rt => Some(Self::$r),)* $($ft => Some(Self::$f),)* _ => None }
            }
        }
    };
}

words! {
    reserved {
        Cell "cell", Task "task", Type "type", Is "is", Record "record", Port "port", UsePort "use_port", Var "var",
        Begin "begin", Takeover "takeover", End "end", On "on", Do "do", If "if", Then "then", Elsif "elsif",
        Else "else", Loop "loop", While "while", Atomic "atomic",
        Send "send", UseSend "use_send", Query "query", Receive "receive", Reply "reply", Response "response",
        Waitfor "waitfor", Run "run", Takes "takes", In "in", Exit "exit", Skip "skip", Assert "assert",
        And "and", Or "or", Not "not", Mod "mod", True "true", False "false", Myself "self",
        Bool "bool", Int8 "int8", Int16 "int16", Int32 "int32", Integer "integer", Word "word", Real "real",
        Timer "timer",
    }
    free {
        Tick "tick", Model "model", Node "node", At "at", Link "link", Capacity "capacity", Couple "couple", Faults "faults",
        Check "check", Module "module", Standby "standby", Of "of", Extern "extern",
        Usage "usage", MessageFormat "message_format", UserList "user_list", TimeOut "time_out", Class "class",
        BoundedBuffer "bounded_buffer", Retry "retry", Resend "resend", Penalty "penalty", Paper "paper",
        Rate "rate", Latest "latest",
        Order "order", Delay "delay", Start "start", Stop "stop", Abort "abort",
        Silence "silence", When "when", Expiry "expiry", Fence "fence", Refused "refused", Failed "failed",
        Within "within", From "from", For "for", Ticket "ticket", Trunc "trunc", Loose "loose", Over "over", Tight "tight", Serial "serial", Work "work",
        Lease "lease", Every "every", Via "via", Loss "loss", Dup "dup", Fail "fail", Drift "drift",
        Crash "crash", Cut "cut", Pause "pause", Up "up", To "to", Never "never", Always "always", Leads "leads",
        Usec "usec", Msec "msec", Sec "sec",
    }
}

/// The size of a buffer that any keyword fits, in bytes.
const LONGEST: usize = 16;

impl Word {
    /// The keyword that `text` spells; case is ignored.
    #[must_use]
    pub fn find(text: &str) -> Option<Self> {
        let mut lower = [0; LONGEST];
        let lower = lower.get_mut(..text.len())?;
        lower.copy_from_slice(text.as_bytes());
        lower.make_ascii_lowercase();
        std::str::from_utf8(lower).ok().and_then(Self::of_lower)
    }

    /// The keyword of `among` that `text` probably misspells.
    #[must_use]
    pub fn near(text: &str, among: &[Self]) -> Option<Self> {
        let lower = text.to_ascii_lowercase();
        if lower.len() > LONGEST + 2 {
            return None;
        }
        let far = among.iter().map(|word| (strsim::osa_distance(&lower, word.text()), *word));
        // One typing error is allowed in a short keyword, two in a long one.
        let near = far.filter(|(distance, word)| *distance <= if word.text().len() < 5 { 1 } else { 2 });
        near.min().map(|(_, word)| word)
    }

    /// Keywords that begin a declaration of the file.
    pub(crate) const DECLARATIONS: &[Self] = &[
        Self::Tick,
        Self::Model,
        Self::Node,
        Self::Link,
        Self::Type,
        Self::Task,
        Self::Couple,
        Self::Faults,
        Self::Check,
    ];

    /// Keywords that begin a declaration of a task, and the `begin` behind these declarations.
    pub(crate) const OF_TASK: &[Self] = &[Self::Port, Self::UsePort, Self::Var, Self::Begin];

    /// Keywords that begin a statement, or end or continue a block.
    pub(crate) const STATEMENTS: &[Self] = &[
        Self::Send,
        Self::UseSend,
        Self::Query,
        Self::Receive,
        Self::Reply,
        Self::Response,
        Self::Waitfor,
        Self::Order,
        Self::Delay,
        Self::Run,
        Self::Start,
        Self::Stop,
        Self::Exit,
        Self::Skip,
        Self::Abort,
        Self::Assert,
        Self::If,
        Self::Loop,
        Self::While,
        Self::Atomic,
        Self::On,
        Self::End,
        Self::Else,
        Self::Elsif,
        Self::Takeover,
    ];

    /// Keywords that begin an option of a port.
    pub(crate) const OPTIONS: &[Self] = &[
        Self::Usage,
        Self::MessageFormat,
        Self::UserList,
        Self::TimeOut,
        Self::Class,
        Self::BoundedBuffer,
        Self::Retry,
        Self::Resend,
        Self::Penalty,
        Self::Rate,
        Self::Latest,
    ];

    /// The units of time, each with its length in microseconds.
    pub(crate) const UNITS: &[(Self, u64)] = &[(Self::Usec, 1), (Self::Msec, 1_000), (Self::Sec, 1_000_000)];

    /// The unit of the language for a short unit of the command line: `msec` for `ms`.
    pub(crate) fn short_unit(text: &str) -> Option<Self> {
        match text {
            "us" => Some(Self::Usec),
            "ms" => Some(Self::Msec),
            "s" => Some(Self::Sec),
            _ => None,
        }
    }
}
