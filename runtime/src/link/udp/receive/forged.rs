//! A forger attacks whole links with keys: these tests cover everything that a datagram passes after the socket. The
//! forger must not change what a node knows of its neighbours, and genuine datagrams must still arrive.

mod forger;
mod scene;

use crate::link::Link;
use crate::link::udp::UdpCount;
use crate::link::udp::keyed::rig::{keys, packet};
use crate::lock::lock;
use forger::Forger;
use imrs_wire::envelope::Refused;
use rustix::process::{Gid, Uid, getuid};
use rustix::thread::{set_thread_groups, set_thread_res_gid, set_thread_res_uid};
use scene::{ENDS, SILENT, Scene};
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

/// How many forged datagrams come between two genuine ones.
const BATCH: u64 = 500;
/// The length of a genuine datagram with one packet.
const GENUINE: usize = 16 + 20 + 32 + 16;

/// The attacked nodes, and a forger who has recorded them, an earlier start of them, and another cell.
fn attacked() -> (Scene, Forger) {
    let (keys, others) = (keys(), keys());
    let recorded = |mut scene: Scene| {
        scene.links.iter().for_each(Link::goodbye);
        scene.passes_on();
        assert!(scene.heard.iter().all(|heard| lock(&heard.stopped).len() == 1), "a goodbye was recorded");
        scene.recorded
    };
    let earlier = recorded(Scene::new(&keys));
    let forger = Forger::new(Scene::new(&others), earlier, recorded(Scene::new(&others)));
    (Scene::new(&keys), forger)
}

/// Asserts that forged datagrams led only to hints for people, and to none about a neighbour with a session.
fn are_hints(scene: &Scene) {
    for refusal in scene.links.iter().flat_map(|link| link.refusals()) {
        let hints = [Refused::OtherKeys, Refused::OtherMode, Refused::OtherVersion];
        assert!(refusal.node == SILENT && hints.contains(&refusal.why), "{refusal:?}");
    }
}

/// Counts the results of forged datagrams.
#[derive(Default)]
struct Thrown {
    spent: Duration,
    /// A forged datagram that is as long as a genuine one with one packet.
    last: Vec<u8>,
}

/// Throws a batch of forged datagrams at the two nodes.
fn throw(scene: &Scene, forger: &mut Forger, batch: u64, thrown: &mut Thrown) {
    let before = [0, 1].map(|me| scene.state(me));
    for number in batch * BATCH..(batch + 1) * BATCH {
        let (to, from, bytes) = forger.datagram(number, scene);
        let begun = Instant::now();
        scene.arrives(to, from, (&bytes, bytes.len()));
        thrown.spent += begun.elapsed();
        if bytes.len() == GENUINE {
            thrown.last = bytes;
        }
    }
    assert_eq!([0, 1].map(|me| scene.state(me)), before, "batch {batch}");
    are_hints(scene);
}

#[test]
fn a_forger_with_all_but_the_keys_changes_nothing_that_a_link_knows() {
    let count: u64 = std::env::var("IMRS_FORGERIES").map_or(60_000, |count| count.parse().expect("a number"));
    let ((mut scene, mut forger), batches) = (attacked(), count / BATCH);
    scene.asks_again();
    let (sent, mut thrown) = (scene.sent, Thrown::default());
    for batch in 0..batches {
        throw(&scene, &mut forger, batch, &mut thrown);
        scene.talks(&thrown.last);
        // Time passes twice. A cookie of the handshake is first of the current span, then of the one before, and then
        // too old.
        if [batches / 3, 2 * batches / 3].contains(&batch) {
            scene.later(Duration::from_secs(10));
        }
    }
    for me in [0, 1] {
        let numbers = scene.heard[me].of(1 - me);
        assert!(numbers.into_iter().eq(1..=scene.sent[1 - me]), "each genuine packet came once, in order");
        assert_eq!(scene.sent[me], sent[me] + u32::try_from(batches).unwrap());
    }
    let mut reasons = BTreeMap::<_, u64>::new();
    for heard in &scene.heard {
        lock(&heard.discards).iter().for_each(|(name, count)| *reasons.entry(*name).or_default() += count);
    }
    let answers = scene.links.each_ref().map(|link| link.count(UdpCount::HandshakesSent));
    assert!(answers[0] > 10 && answers[1] > 10, "no answers were drawn: {answers:?}");
    let each = thrown.spent / u32::try_from(count).unwrap();
    println!(
        "total: {count} forged datagrams, none taken in, {each:?} each, {answers:?} answers: {reasons:?}"
    );
    for reason in ["forged", "mode", "replayed", "other_keys", "stale_session", "version"] {
        assert!(reasons.get(reason).is_some_and(|&count| count > 0), "{reason} was not put to the test");
    }
    // The network has delayed a genuine datagram until now: the node must still accept it, and only once.
    assert_eq!(scene.links[0].send(ENDS[1], &[packet(0, 1, 1 << 20)]), Ok(1));
    let late = scene.taken(1).expect("it left");
    scene.recorded.retain(|(_, bytes)| *bytes != late);
    throw(&scene, &mut forger, batches, &mut thrown);
    let address = Some(scene.address_of_other(1));
    assert_eq!([1, 2].map(|_| scene.arrives(1, address, (&late, late.len()))), [1, 0]);
    assert_eq!(scene.heard[1].of(0).last(), Some(&(1 << 20)));
}

/// Without a limit, a flood of copies would keep a core busy with answers.
#[test]
fn copies_of_a_request_for_a_session_draw_64_answers_in_50_ms() {
    let scene = Scene::new(&keys());
    let (to, hello) = scene.recorded.iter().find(|(_, bytes)| bytes[15] == 1).expect("a request");
    let link = &scene.links[*to];
    let now = || link.micros(Instant::now());
    let (before, begun) = (link.count(UdpCount::HandshakesSent), now());
    for _ in 0..10_000 {
        scene.arrives(*to, None, (hello, hello.len()));
    }
    let answers = link.count(UdpCount::HandshakesSent) - before;
    let spans = (now() - begun) / 50_000 + 2;
    assert!((64..=64 * spans).contains(&answers), "{answers} answers in {spans} spans");
}

/// The id of another user of this computer, who does not run the nodes.
const OTHER: u32 = 61_002;

/// Whether this process may act as another user. If not, the test is skipped with a message; with `IMRS_REQUIRE_ALL=1`
/// it fails.
fn may_be_another() -> bool {
    let may = getuid().is_root();
    let required = std::env::var_os("IMRS_REQUIRE_ALL").is_some_and(|value| value == "1");
    assert!(may || !required, "only root may be another user, and IMRS_REQUIRE_ALL=1 requires it");
    if !may {
        eprintln!("SKIPPED: only root may be another user");
    }
    may
}

/// Sends, as another user of this computer, each datagram that the channel `asked` brings.
fn another_user(asked: Receiver<(SocketAddr, Vec<u8>)>, sent: &Sender<usize>) {
    let (user, group) = (Uid::from_raw(OTHER), Gid::from_raw(OTHER));
    set_thread_groups(&[]).expect("no groups");
    set_thread_res_gid(group, group, group).expect("its group");
    // From here on this thread, and only this thread, lacks the rights of root.
    set_thread_res_uid(user, user, user).expect("its user");
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    for (to, bytes) in asked {
        sent.send(socket.send_to(&bytes, to).expect("it leaves")).expect("the test waits");
    }
}

#[test]
fn a_forger_with_a_user_of_their_own_changes_nothing_through_the_sockets() {
    if !may_be_another() {
        return;
    }
    let (mut scene, mut forger) = attacked();
    scene.meets_on_sockets();
    scene.talks_on_sockets();
    let ((ask, asked), (sent, is_sent)) = (channel(), channel());
    thread::spawn(move || another_user(asked, &sent));
    for batch in 0..10 {
        let before = [0, 1].map(|me| scene.state(me));
        for number in batch * BATCH..(batch + 1) * BATCH {
            let (to, _, bytes) = forger.datagram(number, &scene);
            ask.send((scene.links[to].local_address(), bytes.clone())).expect("the other user");
            assert_eq!(is_sent.recv(), Ok(bytes.len()));
            scene.takes_in(to);
        }
        assert_eq!([0, 1].map(|me| scene.state(me)), before, "batch {batch}");
        are_hints(&scene);
        scene.talks_on_sockets();
    }
    for me in [0, 1] {
        let numbers = scene.heard[me].of(1 - me);
        assert!(numbers.into_iter().eq(1..=scene.sent[1 - me]), "each genuine packet came once, in order");
    }
}
