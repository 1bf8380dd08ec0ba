//! Tests `imrs verify --explore`, which serves the state space of a claim to a browser on this machine.

use crate::support::{PATIENCE, imrs, run, runtime_dir, wait_until};
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};

/// The process of the server. Dropping this kills it.
struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The server's JSON answer to a GET.
fn get(address: &str, path: &str) -> Value {
    // The command prints its address before the server listens.
    wait_until("the server is there", || TcpStream::connect(address).is_ok());
    let mut stream = TcpStream::connect(address).expect("a server");
    stream.set_read_timeout(Some(PATIENCE)).expect("a time limit");
    write!(stream, "GET {path} HTTP/1.0\r\n\r\n").expect("asked");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("answered");
    let (head, body) = answer.split_once("\r\n\r\n").expect("a head and a body");
    assert!(head.contains("200"), "{head}");
    serde_json::from_str(body).unwrap_or_else(|error| panic!("{error}: {body}"))
}

/// Starts the server of a claim. Returns it with its address.
fn explore(claim: &str) -> (Server, String) {
    let folder = runtime_dir();
    let mut command = imrs(folder.path(), &["verify", "--claim", claim, "--explore", "127.0.0.1:0"]);
    let child = command.stdout(Stdio::piped()).spawn().expect("the command starts");
    let mut server = Server(child);
    let mut line = String::new();
    BufReader::new(server.0.stdout.take().expect("a pipe")).read_line(&mut line).expect("where it is");
    let address = line.split("http://").nth(1).and_then(|rest| rest.split('/').next()).expect("an address");
    (server, address.to_owned())
}

#[test]
fn a_claim_is_walked_through_in_a_browser() {
    for claim in ["no-false-release", "penalty-is-fair"] {
        let (_server, address) = explore(claim);
        let status = get(&address, "/.status");
        assert_eq!(status["properties"][0][1], "claim", "{status}");
        let first = get(&address, "/.states");
        let states = first.as_array().expect("states");
        assert_eq!(states.len(), 1, "{first}");
        let followers = get(&address, "/.states/0");
        let next = followers.as_array().expect("what may happen");
        let drawn = next.iter().any(|state| state["svg"].as_str().is_some_and(|svg| svg.starts_with("<svg")));
        let told = next.iter().any(|state| state["outcome"].as_str().is_some_and(|words| !words.is_empty()));
        assert!(drawn && told, "{followers}");
    }
}

#[test]
fn others_are_kept_out_and_a_claim_is_asked_for() {
    let open = run(&["verify", "--claim", "no-false-release", "--explore", "0.0.0.0:0"]);
    assert!(open.code == Some(2) && open.err.contains("other machines can reach it"), "{open:?}");
    let none = run(&["verify", "--explore", "127.0.0.1:0"]);
    assert_eq!(none.code, Some(2), "{none:?}");
}
