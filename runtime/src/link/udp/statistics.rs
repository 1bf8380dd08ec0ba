//! The counters of a UDP link.

use std::io;
use std::sync::atomic::{AtomicU64, Ordering};

macro_rules! counts {
    ($($(#[doc = $doc:literal])+ $variant:ident = $name:literal),* $(,)?) => {
        /// The events that a UDP link counts. It does not count the arriving datagrams that it drops: the link
        /// reports each of these to the node, with the reason.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum UdpCount { $($(#[doc = $doc])+ $variant),* }

        impl UdpCount {
            /// All counters of a link.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// A short name for tables and counters.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }
        }
    };
}

counts! {
    /// Datagrams handed to the kernel.
    DatagramsSent = "datagrams_sent",
    /// Packets in the datagrams that were handed to the kernel.
    PacketsSent = "packets_sent",
    /// Datagrams that left in the same call as an earlier datagram (UDP_SEGMENT): the number of calls that this saved.
    SendsSaved = "sends_saved",
    /// Routes for which the kernel refused to cut a call into datagrams.
    SegmentsRefused = "segments_refused",
    /// Datagrams that arrived, valid or not.
    DatagramsReceived = "datagrams_received",
    /// Datagrams that the kernel had merged with an earlier datagram (UDP_GRO): the number of calls that this saved.
    ReceivesSaved = "receives_saved",
    /// Packets handed to the sink: the node that the link receives for.
    PacketsReceived = "packets_received",
    /// Datagrams that the kernel dropped because its queue was full (SO_RXQ_OVFL); datagrams that it had merged count as one.
    KernelDropped = "kernel_dropped",
    /// Datagrams that the kernel dropped from the socket of strangers. Their source was no neighbour's address, so
    /// they show a flood from outside the cell.
    StrangersDropped = "strangers_dropped",
    /// Sends that found the kernel's send queue full; the packets were kept.
    Busy = "send_busy",
    /// Sends that failed: no socket has the neighbour's address (ECONNREFUSED). The kernel reports this with the next
    /// send or receive.
    SendRefused = "send_refused",
    /// Sends that failed: no memory in the kernel (ENOBUFS, ENOMEM).
    SendNoBuffers = "send_no_buffers",
    /// Sends that failed: the network is down or unreachable (ENETDOWN, ENETUNREACH).
    SendNoNetwork = "send_no_network",
    /// Sends that failed: the host is down or unreachable (EHOSTDOWN, EHOSTUNREACH).
    SendNoHost = "send_no_host",
    /// Sends that failed: not permitted (EPERM, EACCES; a firewall).
    SendForbidden = "send_forbidden",
    /// Sends that failed in another way.
    SendFailed = "send_failed",
    /// Errors that the socket reported on reception.
    ReceiveFailed = "receive_failed",
    /// Datagrams whose wait was counted from the time when the socket was last seen empty, because the wall clock was set.
    ClockSet = "clock_set",
    /// Datagrams whose wait was counted from the time when the socket was last seen empty, because the kernel gave no stamp.
    NoStamp = "no_stamp",
    /// New sessions of neighbours: the first session of each neighbour, and one for each restart.
    NewIncarnations = "new_lives",
    /// Greetings sent: they carry no packets, and are not counted among the datagrams.
    GreetingsSent = "greetings_sent",
    /// Greetings that arrived.
    GreetingsReceived = "greetings_received",
    /// Goodbyes sent: each copy for each neighbour.
    GoodbyesSent = "goodbyes_sent",
    /// Neighbours that have said goodbye, once for each of their sessions.
    GoodbyesReceived = "goodbyes_received",
    /// How often the node asked a neighbour for an echo, because the neighbour's session or counter could not be
    /// distinguished from an old one.
    EchoesAsked = "echoes_asked",
    /// Counters of neighbours that one datagram had set too far ahead, and that a later datagram corrected.
    CountersMended = "counters_mended",
    /// Refusals sent. The reasons are counted with the datagrams that were refused.
    RefusalsSent = "refusals_sent",
    /// Packets that arrived before the node began, and were dropped.
    BeforeStart = "before_start",
    /// Datagrams of handshakes sent: requests for a session with keys, and answers to such requests.
    HandshakesSent = "handshakes_sent",
    /// Sessions with keys that this node asked for and got.
    SessionsMade = "sessions_made",
}

impl UdpCount {
    /// The counters of packets that were lost, or may have been lost.
    pub const FAILURES: [Self; 8] = [
        Self::KernelDropped,
        Self::SendRefused,
        Self::SendNoBuffers,
        Self::SendNoNetwork,
        Self::SendNoHost,
        Self::SendForbidden,
        Self::SendFailed,
        Self::ReceiveFailed,
    ];
}

/// A UDP link's counters. They never decrease.
#[derive(Debug, Default)]
pub(super) struct Statistics([AtomicU64; UdpCount::ALL.len()]);

impl Statistics {
    pub(super) fn add(&self, count: UdpCount, by: u64) {
        self.0[count as usize].fetch_add(by, Ordering::Relaxed);
    }

    pub(super) fn get(&self, count: UdpCount) -> u64 {
        self.0[count as usize].load(Ordering::Relaxed)
    }

    pub(super) fn send_failed(&self, error: &io::Error) {
        use rustix::io::Errno;
        let count = match Errno::from_io_error(error) {
            Some(Errno::CONNREFUSED) => UdpCount::SendRefused,
            Some(Errno::NOBUFS | Errno::NOMEM) => UdpCount::SendNoBuffers,
            Some(Errno::NETDOWN | Errno::NETUNREACH) => UdpCount::SendNoNetwork,
            Some(Errno::HOSTDOWN | Errno::HOSTUNREACH) => UdpCount::SendNoHost,
            Some(Errno::PERM | Errno::ACCESS) => UdpCount::SendForbidden,
            _ => UdpCount::SendFailed,
        };
        self.add(count, 1);
    }
}
