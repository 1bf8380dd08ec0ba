//! The UDP sockets: the options that are set in the kernel, and the data that the kernel gives with each datagram.

use super::UdpError;
use crate::clock;
use crate::link::residency::Reading;
use imrs_wire::envelope::MAX_DATAGRAM_BYTES;
use nix::sys::socket::{ControlMessageOwned, MsgFlags, recvmsg, setsockopt, sockopt};
use nix::sys::time::TimeSpec;
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::net::sockopt::set_socket_reuseaddr;
use rustix::net::{self, AddressFamily, SocketFlags, SocketType};
use std::io::{self, IoSlice, IoSliceMut};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::os::fd::{AsRawFd, OwnedFd};
use std::time::{Duration, Instant};

/// The size of a receive buffer: one byte more than the longest datagram, so that a longer one is noticed.
const BUFFER_BYTES: usize = MAX_DATAGRAM_BYTES + 1;
/// The most bytes that the kernel merges. Any single datagram fits, too.
const MERGED_BYTES: usize = 64 * 1024;

/// How many bytes the kernel holds for the network (SO_SNDBUF; the kernel doubles this for its own needs). No urgent
/// packet can overtake these bytes, so the number is just large enough to keep the network busy. A full datagram
/// takes 2,304 bytes of the kernel's memory if it leaves alone. So the kernel holds 15 datagrams, or 20 that leave in
/// calls of four (D129). The socket takes more once half of these bytes are sent. The other seven datagrams take 85
/// us at a gigabit a second, and the sending thread wakes in less time (D110).
const SEND_QUEUE_BYTES: usize = 16 * 1024;

/// Limits how many bytes the kernel holds for the network from this socket.
pub(super) fn bound_sending(socket: &UdpSocket) -> nix::Result<()> {
    setsockopt(socket, sockopt::SndBuf, &SEND_QUEUE_BYTES)
}

/// Asks the kernel to cut the data of each send into datagrams of this many bytes; zero ends that.
pub(super) fn set_segment(socket: &UdpSocket, bytes: usize) -> nix::Result<()> {
    let bytes = i32::try_from(bytes).unwrap_or(i32::MAX);
    setsockopt(socket, sockopt::UdpGsoSegment, &bytes)
}

/// Whether the kernel can cut the data of a send into datagrams.
pub(super) fn segments(socket: &UdpSocket) -> bool {
    set_segment(socket, 0).is_ok()
}

/// Asks the kernel to merge datagrams that arrive from one sender at the same time. Returns whether the kernel does so.
pub(super) fn merge(socket: &UdpSocket) -> bool {
    setsockopt(socket, sockopt::UdpGroSegment, &true).is_ok()
}

/// Sends all slices in one call, to the address to which the socket is connected.
pub(super) fn send_all(socket: &UdpSocket, slices: &[IoSlice<'_>]) -> io::Result<usize> {
    Ok(rustix::io::writev(socket, slices)?)
}

/// Datagrams as the kernel gave them: one, or several that it merged.
pub(super) struct Received<'a> {
    bytes: &'a [u8],
    /// The length of each datagram; the last one may be shorter.
    segment: usize,
    /// When the datagrams arrived, by the wall clock since 1970. On the loopback this is when the first of them
    /// arrived; if a network card merged them, it is when the card released them. The time for which the card may hold
    /// datagrams is part of the link's declared bound (D129).
    pub(super) stamp: Option<Duration>,
    /// How many datagrams the kernel has dropped since the socket was made, if the kernel reports that. The number
    /// wraps around.
    pub(super) dropped: Option<u32>,
}

impl<'a> Received<'a> {
    /// A received call in a test: these bytes, cut into datagrams of this length, without a stamp.
    #[cfg(test)]
    pub(super) const fn of(bytes: &'a [u8], segment: usize) -> Self {
        Self { bytes, segment, stamp: None, dropped: None }
    }

    /// The single datagrams, in order. An empty datagram counts, too.
    pub(super) fn datagrams(&self) -> impl Iterator<Item = &'a [u8]> + use<'a> {
        let (first, others) = self.bytes.split_at(self.segment.min(self.bytes.len()));
        std::iter::once(first).chain(others.chunks(self.segment.max(1)))
    }
}

/// Receives datagrams into one reused buffer.
pub(super) struct Receiver {
    bytes: Box<[u8]>,
    control: Vec<u8>,
    /// Whether the kernel's stamps are times of arrival, not of reception.
    pub(super) stamped: bool,
}

impl Receiver {
    /// Makes a receiver. `merges` says whether the kernel may merge datagrams.
    pub(super) fn new(stamped: bool, merges: bool) -> Self {
        let control = nix::cmsg_space!(TimeSpec, u32, i32);
        let room = if merges { MERGED_BYTES } else { BUFFER_BYTES };
        Self { bytes: vec![0; room].into(), control, stamped }
    }

    /// Receives the next datagram that waits, or several that the kernel merged. Never blocks.
    pub(super) fn receive(&mut self, socket: &UdpSocket) -> io::Result<Received<'_>> {
        let mut slices = [IoSliceMut::new(&mut self.bytes)];
        let flags = MsgFlags::MSG_DONTWAIT;
        let message = recvmsg::<()>(socket.as_raw_fd(), &mut slices, Some(&mut self.control), flags)?;
        let (mut stamp, mut dropped, mut segment) = (None, None, None);
        for control in message.cmsgs().into_iter().flatten() {
            match control {
                ControlMessageOwned::ScmTimestampns(at) => stamp = since_1970(at),
                ControlMessageOwned::RxqOvfl(total) => dropped = Some(total),
                ControlMessageOwned::UdpGroSegments(bytes) => segment = usize::try_from(bytes).ok(),
                _ => {}
            }
        }
        let length = message.bytes;
        let segment = segment.filter(|&bytes| bytes > 0).unwrap_or(length);
        let stamp = stamp.filter(|_| self.stamped);
        Ok(Received { bytes: &self.bytes[..length], segment, stamp, dropped })
    }
}

fn since_1970(at: TimeSpec) -> Option<Duration> {
    let nanoseconds = u32::try_from(at.tv_nsec()).ok()?;
    Some(Duration::new(u64::try_from(at.tv_sec()).ok()?, nanoseconds))
}

/// The options that are set on a receiving socket.
#[derive(Clone, Copy, Debug)]
pub(super) struct Asked {
    /// Whether the kernel merges datagrams that arrive from one sender at the same time.
    pub(super) merges: bool,
    /// Whether the kernel stamps arriving datagrams.
    pub(super) stamped: bool,
    /// How many bytes can wait in the kernel, approximately.
    pub(super) queue: usize,
}

impl Asked {
    /// Sets these options on a socket, except merging, which the kernel may not know.
    fn of(self, socket: &UdpSocket) -> Result<(), UdpError> {
        let option = |option: &'static str, result: nix::Result<()>| {
            result.map_err(|errno| UdpError::Option { option, source: errno.into() })
        };
        option("SO_RCVBUF", setsockopt(socket, sockopt::RcvBuf, &self.queue))?;
        option("SO_SNDBUF", bound_sending(socket))?;
        option("SO_RXQ_OVFL", setsockopt(socket, sockopt::RxqOvfl, &1))?;
        if self.stamped {
            option("SO_TIMESTAMPNS", setsockopt(socket, sockopt::ReceiveTimestampns, &true))?;
        }
        Ok(())
    }
}

/// Makes a socket and binds it to `address`, which no other socket may have. `merges` says whether the kernel may
/// merge datagrams. Also returns the options that the kernel accepted, and a reading of the clocks from before any
/// datagram can have arrived.
pub(super) fn bind(
    address: SocketAddr,
    queue: usize,
    merges: bool,
) -> Result<(UdpSocket, Asked, Reading), UdpError> {
    let stamped = stamps_work();
    let empty = Reading::take();
    let socket = UdpSocket::bind(address).map_err(|source| UdpError::Bind { address, source })?;
    socket.set_nonblocking(true).map_err(|source| UdpError::Option { option: "O_NONBLOCK", source })?;
    let asked = Asked { merges: merges && merge(&socket), stamped, queue };
    asked.of(&socket)?;
    Ok((socket, asked, empty))
}

/// A socket on the address of another socket, `local`, that is connected to `peer`: the kernel gives it the datagrams
/// from the address `peer`.
///
/// A socket can share an address only if it, and all sockets on that address, have SO_REUSEADDR set at that moment. `bound`
/// has the option set only during this call, so no other process gets the address; two threads must not make this call at
/// once. SO_REUSEPORT would let other processes of the user share the address for as long as the node runs. Between its bind
/// and its connect the new socket also gets datagrams of strangers, which are judged by their contents, as always.
pub(super) fn connect_beside(
    bound: &UdpSocket,
    local: SocketAddr,
    peer: SocketAddr,
    asked: Asked,
) -> io::Result<UdpSocket> {
    let family = if local.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = UdpSocket::from(net::socket_with(family, SocketType::DGRAM, flags, None)?);
    asked.of(&socket).map_err(io::Error::other)?;
    if asked.merges {
        merge(&socket);
    }
    set_socket_reuseaddr(&socket, true)?;
    set_socket_reuseaddr(bound, true)?;
    let beside = net::bind(&socket, &local);
    set_socket_reuseaddr(bound, false)?;
    beside?;
    socket.connect(peer)?;
    Ok(socket)
}

/// Whether the kernel stamps datagrams when they arrive. The kernel begins to do so some time after the first socket
/// asks for it. Until then its stamps are the times of *reception*, which makes old datagrams look young. To find out,
/// this sends a datagram to its own socket, and leaves the datagram there for a while.
fn stamps_work() -> bool {
    const WAIT: Duration = Duration::from_millis(1);
    const ATTEMPTS: usize = 50;
    let attempt = || -> io::Result<bool> {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        socket.connect(socket.local_addr()?)?;
        setsockopt(&socket, sockopt::ReceiveTimestampns, &true)?;
        let mut receiver = Receiver::new(true, false);
        for _ in 0..ATTEMPTS {
            socket.send(&[0])?;
            std::thread::sleep(WAIT);
            let now = Reading::take();
            let Ok(received) = receiver.receive(&socket) else { continue };
            if received.stamp.is_some_and(|stamp| now.realtime.saturating_sub(stamp) >= WAIT / 2) {
                return Ok(true);
            }
        }
        Ok(false)
    };
    attempt().unwrap_or(false)
}

/// An event counter with which one thread ends the wait of another.
pub(super) struct Wake(OwnedFd);

impl Wake {
    pub(super) fn new() -> Result<Self, UdpError> {
        let fd = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK);
        fd.map(Self).map_err(|errno| UdpError::Wake(errno.into()))
    }

    /// Ends the current wait; if there is none, the next wait ends at once.
    pub(super) fn wake(&self) {
        // This fails only if the counter is full. A full counter ends the wait, too.
        let _ = rustix::io::write(&self.0, &1_u64.to_ne_bytes());
    }

    pub(super) const fn fd(&self) -> &OwnedFd {
        &self.0
    }

    pub(super) fn clear(&self) {
        // This fails only if another thread has already cleared the counter.
        let _ = rustix::io::read(&self.0, &mut [0_u8; 8]);
    }
}

/// How a wait for room in a full socket ended.
pub(super) enum Waited {
    /// The epoll instance has an event.
    ReadySockets,
    /// A socket that was full may take datagrams again.
    Writable,
    TimedOut,
}

/// Waits until the epoll instance has an event, one of the `full` sockets takes datagrams again, or the instant
/// `until` has passed. This function allocates, which is acceptable because it runs only while the network does not
/// keep up.
pub(super) fn wait_for_room(
    epoll: &OwnedFd,
    full: &[&UdpSocket],
    until: Option<Instant>,
) -> io::Result<Waited> {
    let mut fds = vec![PollFd::new(epoll, PollFlags::IN)];
    fds.extend(full.iter().map(|full| PollFd::new(*full, PollFlags::OUT)));
    clock::sleeps();
    loop {
        let left = until.map(|until| until.saturating_duration_since(Instant::now()));
        // If the remaining time is too long for the kernel's type, the wait has no end.
        let timeout = left.and_then(|left| Timespec::try_from(left).ok());
        match poll(&mut fds, timeout.as_ref()) {
            // In fact `poll` uses the clock of `Instant`, but no documentation promises that, so the time is checked.
            Ok(0) if until.is_some_and(|until| Instant::now() < until) => {}
            Ok(0) => return Ok(Waited::TimedOut),
            Ok(_) => {}
            Err(rustix::io::Errno::INTR) => continue,
            Err(errno) => return Err(errno.into()),
        }
        if !fds[0].revents().is_empty() {
            return Ok(Waited::ReadySockets);
        }
        // A socket with an error counts as writable, too, because the next send reports the error.
        if fds[1..].iter().any(|fd| !fd.revents().is_empty()) {
            return Ok(Waited::Writable);
        }
    }
}

/// Whether the socket takes a datagram now, or has an error to report.
pub(super) fn takes(socket: &UdpSocket) -> bool {
    let mut fds = [PollFd::new(socket, PollFlags::OUT)];
    let now = Timespec { tv_sec: 0, tv_nsec: 0 };
    poll(&mut fds, Some(&now)).is_ok_and(|ready| ready > 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nix::sys::socket::getsockopt;

    #[test]
    fn the_queues_of_the_kernel_are_bounded() {
        const QUEUE: usize = 32 * 1024;
        let (bound, asked, _) = bind((Ipv4Addr::LOCALHOST, 0).into(), QUEUE, true).unwrap();
        let local = bound.local_addr().unwrap();
        let connected = connect_beside(&bound, local, local, asked).unwrap();
        for socket in [bound, connected] {
            // The kernel reports twice the number of bytes that was asked for.
            assert_eq!(getsockopt(&socket, sockopt::RcvBuf).unwrap(), 2 * QUEUE);
            assert_eq!(getsockopt(&socket, sockopt::SndBuf).unwrap(), 2 * SEND_QUEUE_BYTES);
        }
    }

    /// Neither a second start of the node nor any other process may get a share of the node's port.
    #[test]
    fn an_address_stays_this_nodes_alone() {
        for any in ["127.0.0.1:0", "0.0.0.0:0", "[::1]:0", "[::]:0"] {
            let (bound, asked, _) = bind(any.parse().unwrap(), 32 * 1024, true).unwrap();
            let local = bound.local_addr().unwrap();
            let of_peer = if local.is_ipv4() { "127.0.0.1:9" } else { "[::1]:9" };
            let peers: Vec<_> = (0..2)
                .map(|_| connect_beside(&bound, local, of_peer.parse().unwrap(), asked).unwrap())
                .collect();
            assert!(peers.iter().all(|peer| peer.local_addr().unwrap().port() == local.port()));
            let family = if local.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
            for shares in [false, true] {
                let other = net::socket(family, SocketType::DGRAM, None).unwrap();
                set_socket_reuseaddr(&other, shares).unwrap();
                assert_eq!(net::bind(&other, &local), Err(rustix::io::Errno::ADDRINUSE), "{any} {shares}");
            }
        }
    }

    #[test]
    fn a_datagram_comes_to_the_socket_that_is_connected_to_its_sender() {
        for (any, here) in
            [("127.0.0.1:0", "127.0.0.1"), ("0.0.0.0:0", "127.0.0.1"), ("[::1]:0", "::1"), ("[::]:0", "::1")]
        {
            let here: std::net::IpAddr = here.parse().unwrap();
            let [near, far] = [0, 1].map(|_| UdpSocket::bind((here, 0)).unwrap());
            let (bound, asked, _) = bind(any.parse().unwrap(), 32 * 1024, true).unwrap();
            let local = bound.local_addr().unwrap();
            let connected = connect_beside(&bound, local, near.local_addr().unwrap(), asked).unwrap();
            let to = (here, local.port());
            near.send_to(b"near", to).unwrap();
            far.send_to(b"far", to).unwrap();
            for (socket, expected) in [(&connected, b"near".as_slice()), (&bound, b"far")] {
                socket.set_nonblocking(false).unwrap();
                let mut bytes = [0; 9];
                let length = socket.recv(&mut bytes).unwrap();
                assert_eq!(&bytes[..length], expected, "{any}");
            }
        }
    }
}
