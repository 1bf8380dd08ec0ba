//! Tests a cell whose nodes reach each other over zenoh alone: each node is on a host of its own, where a gateway
//! carries its datagrams (`imrs zenoh`), and all gateways meet at a router on one more host (D211).

use super::cells::{talk, talk_on_loopback};
use super::hosts::{Hosts, are_possible};
use super::net::{Ended, How, Net};
use super::scenes::{NODES, dropped, progress, result};
use crate::support::program::Program;
use crate::support::{bound, imrs, number, run_in, runtime_dir, signal};
use rustix::process::Signal;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::Duration;

/// The host of the router.
const ROUTER: usize = 3;
/// How long the router is stopped each time.
const STALL: Duration = Duration::from_millis(200);

/// A gateway of a cell without links carries nothing. Its session is in router mode, so it is a router alone.
const ONLY_A_ROUTER: &str = "\
cell router;
tick 10 msec;
node r at \"127.0.0.1\" port 7000;
task idle on r
begin
  loop delay 1 sec; end;
end idle;
";

/// How the gateways reach the router.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    Tcp,
    Udp,
    /// QUIC, whose datagrams carry what is sent by best effort.
    Quic,
}

impl Transport {
    const ALL: [Self; 3] = [Self::Tcp, Self::Udp, Self::Quic];

    /// The router's endpoint, and the settings of its side or of the gateways' side.
    fn endpoint(self, dir: &Path) -> (String, String) {
        let address = format!("{}:7447", Hosts::address(ROUTER));
        match self {
            Self::Tcp => (format!("tcp/{address}"), String::new()),
            Self::Udp => (format!("udp/{address}"), String::new()),
            Self::Quic => {
                let of = |name: &str| dir.join(name).display().to_string();
                let tls = format!(
                    "transport: {{ link: {{ tls: {{ root_ca_certificate: \"{cert}\", listen_certificate: \"{cert}\", listen_private_key: \"{key}\", verify_name_on_connect: false }} }} }},",
                    cert = of("router.pem"),
                    key = of("router.key")
                );
                (format!("quic/{address}?rel=0"), tls)
            }
        }
    }
}

/// The processes that carry the datagrams of a run.
pub struct Carried {
    router: Program,
    /// The gateways end before the router.
    gateways: Vec<Program>,
}

impl Carried {
    /// Starts a router and a gateway on the host of each node.
    pub fn start(net: &Net, transport: Transport) -> Self {
        let dir = net.dir.path();
        if transport == Transport::Quic {
            certify(dir);
        }
        let (endpoint, tls) = transport.endpoint(dir);
        let config = |name: &str, mode: &str, role: &str| {
            let text = format!(
                "{{ mode: \"{mode}\", {role}: {{ endpoints: [\"{endpoint}\"] }}, {tls} scouting: {{ multicast: {{ enabled: false }} }} }}"
            );
            written(dir, name, &text)
        };
        let idle = written(dir, "router.cell", ONLY_A_ROUTER);
        let router = carrier(net, ROUTER, &idle, "r", &config("router.json5", "router", "listen"));
        let config = config("gateway.json5", "client", "connect");
        let gateway = |(host, name): (usize, &&str)| carrier(net, host, &net.cell, name, &config);
        Self { router, gateways: net.names.iter().enumerate().map(gateway).collect() }
    }

    /// Stops the router for a while.
    pub fn stall(&self) {
        signal(self.router.pid(), Signal::STOP);
        thread::sleep(STALL);
        signal(self.router.pid(), Signal::CONT);
    }

    /// Ends the gateways and the router. Returns how many datagrams went out and came in.
    pub fn finish(self) -> [u64; 2] {
        let mut all = [0; 2];
        for gateway in self.gateways {
            gateway.interrupt();
            let said = gateway.finish();
            assert!(said.is_well() && said.out.contains(": its gateway is there"), "{said:?}");
            let last = said.out.lines().last().expect("a line");
            let numbers: Vec<u64> = last.split(' ').filter_map(|word| word.parse().ok()).collect();
            let [out, into, refused, _] = numbers[..] else { panic!("{last}") };
            assert_eq!(refused, 0, "{last}");
            all = [all[0] + out, all[1] + into];
        }
        self.router.interrupt();
        let said = self.router.finish();
        assert!(said.is_well(), "{said:?}");
        all
    }
}

fn written(dir: &Path, name: &str, text: &str) -> PathBuf {
    let path = dir.join(name);
    std::fs::write(&path, text).expect("the file is written");
    path
}

/// Starts a gateway on a host, and waits until it carries datagrams.
fn carrier(net: &Net, host: usize, cell: &Path, node: &str, config: &Path) -> Program {
    let [cell, config] = [cell, config].map(|path| path.to_str().expect("UTF-8"));
    let command = imrs(net.dir.path(), &["zenoh", cell, "--node", node, "--config", config]);
    let mut gateway = net.hosts.on(host, || Program::start(command));
    let (_, said) = gateway.line();
    assert!(said.contains("go over zenoh"), "{said}");
    gateway
}

/// Makes a certificate of the router, which all gateways know.
fn certify(dir: &Path) {
    let subject = format!("subjectAltName=IP:{}", Hosts::address(ROUTER));
    let made = Command::new("openssl")
        .args(["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"])
        .args(["-days", "2", "-subj", "/CN=router", "-addext", &subject])
        // The certificate is its own root, and must not be one of an authority.
        .args(["-addext", "basicConstraints=critical,CA:FALSE"])
        .args(["-keyout", "router.key", "-out", "router.pem"])
        .current_dir(dir)
        .output();
    let made = made.expect("openssl");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
}

/// A run of the cell over zenoh. The router is stopped `stalls` times. Also returns how many datagrams went out and came in.
fn zenoh(seed: u64, transport: Transport, stalls: u32) -> (Ended, [u64; 2]) {
    let mut net = Net::on(Hosts::new(NODES.len() + 1, seed), &talk_on_loopback(), NODES);
    let carried = Carried::start(&net, transport);
    net.start_all(&How::default());
    progress(&net);
    for _ in 0..stalls {
        carried.stall();
        progress(&net);
    }
    talk_on(&net);
    let (ended, _) = result(net);
    (ended, carried.finish())
}

/// A run of the cell over UDP.
fn udp(seed: u64) -> Ended {
    let net = Net::started(&talk(), NODES, seed);
    talk_on(&net);
    result(net).0
}

/// Lets the tasks talk for a while: as many meetings as are asked for.
fn talk_on(net: &Net) {
    (0..bound("IMRS_ZENOH_ROUNDS", 2)).for_each(|_| progress(net));
}

/// What a summary says whatever the delays are: how each node and each check ended.
fn outcome(ended: &Ended) -> Vec<Value> {
    let of = |name: &&str| {
        let summary = ended.said.iter().map(|(_, said)| said.last_json());
        let mut of_node = summary.filter(|summary| summary["nodes"][0]["name"] == **name);
        let summary = of_node.next().expect("a summary of each node");
        let ports = summary["ports"].as_array().expect("ports").iter();
        let ports: Vec<_> = ports.map(|port| (port["port"].clone(), port["usage"].clone())).collect();
        serde_json::json!([summary["nodes"][0]["exit"], summary["tasks"], summary["checks"], ports])
    };
    NODES.iter().map(of).collect()
}

/// The longest of the links' delays for each statistic, in microseconds.
fn delays(ended: &Ended) -> [u64; 3] {
    let summaries: Vec<Value> = ended.said.iter().map(|(_, said)| said.last_json()).collect();
    let links = summaries.iter().flat_map(|summary| summary["nodes"][0]["links"].as_array().expect("links"));
    let links: Vec<&Value> = links.collect();
    ["p50_us", "p99_us", "max_us"]
        .map(|stat| links.iter().map(|link| number(&link["delay"][stat])).max().expect("a link"))
}

/// How many datagrams the nodes gave to their sockets, and took from them.
pub fn datagrams(ended: &Ended) -> [u64; 2] {
    let summaries: Vec<Value> = ended.said.iter().map(|(_, said)| said.last_json()).collect();
    let of = |summary: &Value, name: &str| summary["nodes"][0]["link"][name].as_u64().unwrap_or(0);
    ["datagrams_sent", "datagrams_received"]
        .map(|name| summaries.iter().map(|summary| of(summary, name)).sum())
}

#[test]
fn a_cell_over_zenoh_ends_as_over_udp_and_a_stalled_router_makes_nothing_stale() {
    if !are_possible() {
        return;
    }
    println!(
        "| the way | p50 | p99 | longest | datagrams that went out | came in |\n|---|---|---|---|---|---|"
    );
    for round in 0..bound("IMRS_TRIALS", 1) {
        let plain = udp(round);
        let [p50, p99, max] = delays(&plain);
        let [out, into] = datagrams(&plain);
        println!("| UDP | {p50} us | {p99} us | {max} us | {out} | {into} |");
        for transport in Transport::ALL {
            let (ended, [out, into]) = zenoh(round, transport, 0);
            let [p50, p99, max] = delays(&ended);
            println!("| zenoh over {transport:?} | {p50} us | {p99} us | {max} us | {out} | {into} |");
            assert_eq!(outcome(&ended), outcome(&plain), "{transport:?}");
            assert!(into <= out && into > 0, "{into} of {out}");
            // `result` has judged the recordings: nothing was stale, and nothing was carried out twice.
            let (ended, _) = zenoh(round, transport, 10);
            let messages = ended.evidence.messages;
            println!("{transport:?}, stalled: {messages:?}, {} forged", dropped(&ended, &["forged"]));
            assert!(messages.executed > 0 && messages.stale == 0, "{messages:?}");
        }
    }
}

#[test]
fn a_gateway_carries_no_datagram_without_keys() {
    if !are_possible() {
        return;
    }
    let net = Net::on(Hosts::new(NODES.len() + 1, 1), &talk_on_loopback(), NODES);
    let carried = Carried::start(&net, Transport::Tcp);
    let (dir, cell) = (net.dir.path(), net.cell.to_str().expect("UTF-8"));
    let command = imrs(dir, &["run", cell, "--node", NODES[0], "--insecure", "--for", "2s"]);
    let node = net.hosts.on(0, || Program::start(command));
    let _said = node.finish();
    let gateway = carried.gateways.into_iter().next().expect("of the first node");
    gateway.interrupt();
    let said = gateway.finish();
    assert!(said.err.contains("datagrams without keys"), "{said:?}");
    assert!(said.out.contains("node na: 0 datagrams went out, 0 came in, "), "{said:?}");
}

#[test]
fn a_gateway_wants_addresses_on_the_loopback() {
    let dir = runtime_dir();
    let cell = written(dir.path(), "own.cell", &talk());
    let said = run_in(dir.path(), &["zenoh", cell.to_str().expect("UTF-8"), "--node", "na"]);
    assert_eq!(said.code, Some(2), "{said:?}");
    assert!(said.err.contains("node `na` is declared at 10.77.0.1:7000"), "{said:?}");
}
