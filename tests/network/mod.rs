//! Tests faults of a network between several hosts. The hosts are network namespaces at a switch in this process, and a
//! seed determines the switch's faults. Real nodes with keys run on the hosts, and `imrs replay --model` judges their
//! recordings.

mod bounds;
mod cells;
mod evidence;
mod frames;
mod guide;
mod hosts;
mod net;
mod overload;
mod pair;
mod scenes;
mod starts;
mod switch;
mod trial;
#[cfg(feature = "zenoh")]
mod zenoh;
#[cfg(feature = "zenoh")]
mod zenoh_demos;

use crate::support::{bound, wait_until};
use hosts::{Hosts, are_possible};
use pair::PAIR;
use scenes::{SCENES, Scene};
use starts::STARTS;
use std::net::UdpSocket;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use trial::{Trial, Trials, row};

#[test]
fn datagrams_pass_from_host_to_host_as_the_switch_decides() {
    if !are_possible() {
        return;
    }
    let hosts = Hosts::new(3, 1);
    let socket = |host| {
        let socket = hosts.on(host, || UdpSocket::bind((Hosts::address(host), cells::PORT)));
        let socket = socket.expect("a socket");
        socket.set_read_timeout(Some(Duration::from_secs(60))).expect("a time");
        socket
    };
    let [a, b] = [socket(0), socket(1)];
    let mut room = [0; 64];
    for number in 0..5_u8 {
        a.send_to(&[number], b.local_addr().expect("its address")).expect("it leaves");
        assert_eq!(b.recv_from(&mut room).expect("it comes"), (1, a.local_addr().expect("its address")));
        assert_eq!(room[0], number);
    }
    assert_eq!(hosts.counts().datagrams, 5, "no noise is counted");
    // The other direction of the link is not cut.
    hosts.cut(0, 1);
    a.send_to(b"cut", b.local_addr().expect("its address")).expect("it leaves");
    b.send_to(b"back", a.local_addr().expect("its address")).expect("it leaves");
    assert_eq!(a.recv(&mut room).expect("it comes"), 4);
    // The switch may read the card of `b` first.
    wait_until("the datagram was cut off", || hosts.counts().cut == 1);
    hosts.heal();
    a.send_to(b"healed", b.local_addr().expect("its address")).expect("it leaves");
    assert_eq!(b.recv(&mut room).expect("it comes"), 6);
    assert_eq!((hosts.counts().cut, hosts.counts().datagrams), (1, 8));
}

/// How many trials run at the same time. Trials mostly wait, so there can be more of them than processors.
const ABREAST: usize = 4;

/// Runs trials of all scenes that are not done yet, several at a time.
fn carry_out(scenes: &[&Scene], count: u64, trials: &Trials) {
    let plans: Vec<(&Scene, u64)> = (0..count)
        .flat_map(|number| scenes.iter().map(move |scene| (*scene, number)))
        .filter(|(scene, number)| !trials.has(scene.name, *number))
        .collect();
    let next = AtomicUsize::new(0);
    thread::scope(|scope| {
        for _ in 0..ABREAST {
            scope.spawn(|| {
                while let Some((scene, number)) = plans.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let begin = Instant::now();
                    let trial = (scene.run)(*number);
                    println!(
                        "{:>6.1} s {}, trial {number}: {}",
                        begin.elapsed().as_secs_f64(),
                        scene.name,
                        trial.model
                    );
                    trials.add(Trial { scene: scene.name.into(), number: *number, ..trial });
                }
            });
        }
    });
}

#[test]
fn faults_between_hosts_have_the_outcomes_that_they_must_have() {
    if !are_possible() {
        return;
    }
    // `.ci/long` runs many trials of each scene.
    let count = bound("IMRS_TRIALS", 1);
    let only = std::env::var("IMRS_SCENE").unwrap_or_default();
    let scenes: Vec<&Scene> =
        SCENES.iter().chain(&STARTS).chain(&PAIR).filter(|scene| scene.name.contains(&only)).collect();
    let trials = Trials::open(std::env::var_os("IMRS_TRIALS_DONE").map(Into::into));
    carry_out(&scenes, count, &trials);
    let trials = trials.finish();
    let mut rows = String::from("| scene | figures |\n|---|---|\n");
    for scene in &scenes {
        let of_scene: Vec<&Trial> = trials.iter().filter(|trial| trial.scene == scene.name).collect();
        assert_eq!(of_scene.len() as u64, count, "{}", scene.name);
        rows += &format!("| {} | {} |\n", scene.name, row(&of_scene, scene.took));
    }
    print!("{rows}");
    println!("total: {}", row(&trials.iter().collect::<Vec<_>>(), ""));
    if only.is_empty() && std::env::var_os("IMRS_BLESS").is_some_and(|value| value == "1") {
        write_rows(&rows);
    }
}

/// Writes the rows of all scenes into the page about faults.
fn write_rows(rows: &str) {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("specs/faults.md");
    let text = std::fs::read_to_string(&page).expect("the page");
    let (before, _) = text.split_once("| scene |").expect("the rows of the scenes");
    let after = text.rsplit_once("<!-- end of the scenes -->").expect("their end").1;
    std::fs::write(page, format!("{before}{rows}\n<!-- end of the scenes -->{after}"))
        .expect("the page is written");
}
