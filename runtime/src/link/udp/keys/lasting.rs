//! Tests which sessions stay valid and which ones end: under restarts, with late and lost datagrams, and if both
//! nodes ask for a session at once.

use super::rig::{DIGESTS, End, MS, acquainted, end, ends, keys};
use super::*;
use crate::link::LinkDiscard;

#[test]
fn a_neighbour_that_starts_again_ends_its_earlier_session_and_no_old_one_comes_back() {
    let keys = keys();
    let mut ends = ends(&keys);
    acquainted(&mut ends, 0);
    let [old, late] = [0, 1].map(|_| ends[0].datagram().unwrap());
    ends[1].take(&old, MS).unwrap();
    // The first start of the node asks for a session, and ends while the answer is in flight.
    let hello = ends[0].channel.knock(MS).unwrap();
    let cookie = ends[1].take(&hello, MS).unwrap().unwrap();
    let initiation = ends[0].take(&cookie, MS).unwrap().unwrap();
    ends[0] = end(&keys, 0, 77, DIGESTS);
    acquainted(&mut ends, 2 * MS);
    assert_eq!(ends[1].take(&late, 3 * MS), Err(LinkDiscard::StaleSession));
    let now = ends[1].channel.sending().unwrap().index;
    // The late answer leads to no session: the first start is over, and the second start has not asked for
    // it.
    let response = ends[1].take(&initiation, 3 * MS).unwrap().unwrap();
    assert_eq!(ends[0].take(&response, 3 * MS), Err(LinkDiscard::StaleSession));
    assert_eq!(ends[1].channel.sending().unwrap().index, now);
}

/// Two ends with a session. The second end asked for it after a restart, and the first datagram in it is lost.
fn unanswered(keys: &[NodeKeys; 2]) -> [End; 2] {
    let mut ends = ends(keys);
    acquainted(&mut ends, 0);
    ends[1] = end(keys, 1, 77, DIGESTS);
    let hello = ends[1].knock(MS).unwrap();
    let cookie = ends[0].take(&hello, MS).unwrap().unwrap();
    let initiation = ends[1].take(&cookie, MS).unwrap().unwrap();
    let response = ends[0].take(&initiation, MS).unwrap().unwrap();
    let _lost = ends[1].take(&response, MS).unwrap().unwrap();
    ends
}

/// If the session ended, one node would send in a session with an earlier start of its neighbour, and the other node
/// in one that its neighbour has forgotten.
#[test]
fn a_session_is_used_however_late_its_first_datagram_comes_until_it_is_replaced() {
    let keys = keys();
    let mut ends = unanswered(&keys);
    for second in 1..10 {
        let now = second * 1_000 * MS;
        assert_eq!(ends[0].knock(now).or(ends[1].knock(now)), None, "both have a session");
        let into_the_void = ends[0].datagram().unwrap();
        assert!(ends[1].take(&into_the_void, now).is_err());
    }
    let now = 9_500 * MS;
    let late = ends[1].datagram().unwrap();
    ends[0].take(&late, now).unwrap();
    let answer = ends[0].datagram().unwrap();
    ends[1].take(&answer, now).unwrap();
    let mut others = unanswered(&keys);
    assert!(others[1].knock(10_500 * MS).is_some(), "who has no answer asks for another session");
    assert_eq!(ends[1].knock(10_500 * MS), None, "who has one asks for none");
}

/// A node that only receives sends nothing but greetings. So a greeting must let the neighbour know of a new session.
#[test]
fn a_greeting_is_repeated_until_the_neighbour_uses_the_session() {
    let mut ends = unanswered(&keys());
    let mut greetings = Vec::new();
    for now in (MS..9_000 * MS).step_by(10_000) {
        assert!(ends[1].channel.is_unanswered());
        if let Some(greeting) = ends[1].greeting(now) {
            greetings.push((now, greeting));
        }
    }
    let waits: Vec<_> = greetings.windows(2).map(|pair| (pair[1].0 - pair[0].0) / MS).collect();
    assert_eq!(waits, [100, 200, 400, 800, 1_600, 1_600, 1_600, 1_600], "later and later: {waits:?}");
    let (now, last) = greetings.pop().unwrap();
    ends[0].take(&last, now).unwrap();
    let answer = ends[0].datagram().unwrap();
    ends[1].take(&answer, now).unwrap();
    assert!(!ends[1].channel.is_unanswered());
    assert_eq!(ends[1].greeting(now + 60_000 * MS), None);
    assert_eq!(ends[0].greeting(now + 60_000 * MS), None, "only who has asked for the session greets");
}

/// Each end initiates a session, so there are two, and each end completes the handshake of its own session first.
#[test]
fn two_that_ask_at_once_hear_each_other_for_as_long_as_they_run() {
    let mut ends = ends(&keys());
    let mut under_way = [0, 1].map(|me| ends[me].knock(0).unwrap());
    // Cookies, initiations, responses and first datagrams cross.
    for step in 1..6 {
        let [to_second, to_first] = under_way;
        under_way = [ends[0].take(&to_first, step * MS), ends[1].take(&to_second, step * MS)]
            .map(|reply| reply.unwrap().unwrap_or_default());
    }
    assert!(under_way.iter().all(Vec::is_empty) && ends.iter().all(|end| end.opened.len() == 1));
    for second in 1..7_300 {
        let now = second * 1_000 * MS;
        let hellos = [0, 1].map(|me| (1 - me, ends[me].knock(now)));
        let mut sent: Vec<_> = hellos.into_iter().filter_map(|(to, hello)| Some((to, hello?))).collect();
        assert!(sent.is_empty() || second >= 3_600, "{second} s: a session is renewed once an hour");
        for me in [0, 1] {
            let datagram = ends[me].datagram().unwrap();
            let taken = ends[1 - me].take(&datagram, now);
            assert_eq!(taken, Ok(None), "{second} s");
        }
        while let Some((to, bytes)) = sent.pop() {
            sent.extend(ends[to].take(&bytes, now).unwrap().map(|reply| (1 - to, reply)));
        }
        assert!(ends.iter().all(|end| end.channel.sessions.iter().count() <= 4), "{second} s");
    }
}

/// The answer of the earlier start was still in flight, or an attacker has delayed it.
#[test]
fn an_answer_of_an_earlier_start_ends_no_later_session_whenever_it_comes() {
    let keys = keys();
    for comes_before_its_first_datagram in [false, true] {
        let mut ends = ends(&keys);
        let hello = ends[0].knock(0).unwrap();
        let cookie = ends[1].take(&hello, 0).unwrap().unwrap();
        let initiation = ends[0].take(&cookie, 0).unwrap().unwrap();
        let late = ends[1].take(&initiation, 0).unwrap().unwrap();
        ends[1] = end(&keys, 1, 77, DIGESTS);
        let hello = ends[1].knock(MS).unwrap();
        let cookie = ends[0].take(&hello, MS).unwrap().unwrap();
        let initiation = ends[1].take(&cookie, MS).unwrap().unwrap();
        let response = ends[0].take(&initiation, MS).unwrap().unwrap();
        let first = ends[1].take(&response, MS).unwrap().unwrap();
        let order = if comes_before_its_first_datagram { [late, first] } else { [first, late] };
        for bytes in order {
            ends[0].take(&bytes, 2 * MS).unwrap();
        }
        for second in 1..30 {
            for me in [0, 1] {
                let datagram = ends[me].datagram().unwrap();
                assert_eq!(ends[1 - me].take(&datagram, second * 1_000 * MS), Ok(None), "{second} s");
                assert_eq!(ends[me].knock(second * 1_000 * MS), None);
            }
        }
    }
}
