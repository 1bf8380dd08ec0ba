//! Runs a script without a node: the test takes the part of its communication task.

use imrs_protocol::script::*;
use imrs_protocol::*;
use std::collections::BTreeMap;

pub const ASK: PortId = PortId(0);
pub const TELL: PortId = PortId(1);
pub const LIFT: PortId = PortId(2);
pub const PEER: TaskId = TaskId(7);

/// The effects of a step of a script, in words.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Said {
    pub words: Vec<String>,
    pub requests: Vec<Request>,
    pub statements: Vec<Address>,
    /// The alternative that the driver chooses at once, if any.
    pub choice: Option<u16>,
    pub fragments: BTreeMap<u8, Contents>,
    pub answers: BTreeMap<(Option<TaskId>, u8), Contents>,
}

impl ScriptOutbox for Said {
    fn communication(&self) -> Option<(&CommTask, &NodeTable)> {
        None
    }
    fn asked(&mut self, request: &Request) {
        self.words.push(words(request));
        self.requests.push(*request);
    }
    fn run(&mut self, action: Action<'_>) {
        let Action { level, action, arguments, least, most } = action;
        self.words.push(format!("run {action} {arguments:?} at {level} takes {least}..{most}"));
    }
    fn cut_short(&mut self, level: u8) {
        self.words.push(format!("cut short {level}"));
    }
    fn choose(&mut self, alternatives: u16) -> Option<u16> {
        if self.choice.is_none() {
            self.words.push(format!("choose {alternatives}"));
        }
        self.choice
    }
    fn ended(&mut self, end: End) {
        self.words.push(format!("ended {end:?}"));
    }
    fn statement(&mut self, at: Address) {
        self.statements.push(at);
    }
    fn unanswered(&mut self, message: ReplyTo) {
        self.words.push(format!("unanswered {}", message.source));
    }
    fn fragment(&self, index: u8) -> Option<Contents> {
        self.fragments.get(&index).copied()
    }
    fn answer(&self, _: PortId, task: Option<TaskId>, index: u8) -> Option<Contents> {
        self.answers.get(&(task, index)).copied()
    }
}

/// A request in words.
pub fn words(request: &Request) -> String {
    let time = |t: &Option<Ticks>| t.map_or_else(String::new, |t| format!(" for {t}"));
    match request {
        Request::Send { port, to, contents, time_out } => {
            format!("send {port} {to:?} {:?}{}", contents.as_bytes(), time(time_out))
        }
        Request::Part { port, index, contents } => format!("part {port} {index} {:?}", contents.as_bytes()),
        Request::Get { port, source, time_out } => {
            let port = port.map_or("any".into(), |p| p.to_string());
            let source = source.map_or_else(String::new, |s| format!(" from {s}"));
            format!("get {port}{source}{}", time(time_out))
        }
        Request::Reply { to, contents } => {
            format!("reply {} {} {:?}", to.port, to.source, contents.as_bytes())
        }
        Request::Arrive { port, arguments, time_out } => {
            format!("arrive {port} {arguments:?}{}", time(time_out))
        }
        Request::Order(order) => format!("order {:?}", order.ranked()),
        Request::Handle { port, handled } => format!("handle {port} {handled}"),
        Request::Delay { id, length } => format!("delay {} {length}", id.0),
        Request::Start { id, length } => format!("start {} {length}", id.0),
        Request::Stop { id } => format!("stop {}", id.0),
        Request::Boundary => "boundary".into(),
        Request::Work => "work".into(),
        Request::Done => "done".into(),
        Request::Return => "return".into(),
        Request::Atomic(opens) => format!("atomic {opens}"),
        Request::Lease => "lease".into(),
        Request::Publish(contents) => format!("publish {:?}", contents.as_bytes()),
        Request::Cancel => "cancel".into(),
        Request::Abandon => "abandon".into(),
        Request::End => "end".into(),
    }
}

/// A script and its program. Every step is taken with shortcuts and without them. The rig checks that the packed form gives
/// the same state back.
pub struct Rig {
    pub program: Program,
    pub code: Code,
    pub script: Script,
    pub said: Said,
}

impl Rig {
    /// A rig with the script that `write` builds. The program ends after the operations that `write` adds.
    pub fn new(write: impl FnOnce(&mut ProgramBuilder)) -> Self {
        let mut builder = ProgramBuilder::new("test");
        write(&mut builder);
        builder.end();
        Self::of(builder.finish().expect("a checked program"))
    }

    pub fn of(program: Program) -> Self {
        Self { script: Script::new(&program), code: Code::new(&program), program, said: Said::default() }
    }

    pub fn step(&mut self, input: ScriptInput) -> Vec<String> {
        self.compared(&input).unwrap_or_else(|difference| panic!("{difference}"));
        same_when_packed(&self.program, &self.script);
        std::mem::take(&mut self.said.words)
    }

    /// Takes an input with the program's shortcuts and without them, and compares the results (D188).
    pub fn compared(&mut self, input: &ScriptInput) -> Result<(), String> {
        let (mut script, mut said) = (self.script.clone(), self.said.clone());
        let [mut with, mut without] = [Requests::default(), Requests::default()];
        script.step(&self.program, &Code::plain(), input, &mut without, &mut said);
        self.script.step(&self.program, &self.code, input, &mut with, &mut self.said);
        let same = (&script, &said, without) == (&self.script, &self.said, with);
        if same {
            self.compare_get(script)
        } else {
            Err(format!("{input:?}: {script:?} {said:?}, not {:?} {:?}", self.script, self.said))
        }
    }

    /// If the script predicts the GET after its REPLY (D200), compares the prediction with a copy of the script that
    /// gets the acceptance of the REPLY.
    fn compare_get(&self, mut script: Script) -> Result<(), String> {
        let Some((at, get)) = script.get_after_reply(&self.program, &self.code) else { return Ok(()) };
        let (mut goes_on, mut said, mut requests) = (script.clone(), Said::default(), Requests::default());
        goes_on.waits_in_get(at);
        let accepted = ScriptInput::Signal(Signal::Accepted(1));
        script.step(&self.program, &Code::plain(), &accepted, &mut requests, &mut said);
        if script == goes_on && said.requests == [get] && said.words == [words(&get)] {
            Ok(())
        } else {
            Err(format!("{get:?} at {at}: {script:?} {said:?}, not {goes_on:?}"))
        }
    }

    pub fn begin(&mut self) -> Vec<String> {
        self.step(ScriptInput::Begin)
    }

    pub fn tell(&mut self, signal: Signal) -> Vec<String> {
        self.step(ScriptInput::Signal(signal))
    }

    /// Answers the script's request with an acceptance.
    pub fn accept(&mut self) -> Vec<String> {
        self.tell(Signal::Accepted(1))
    }

    pub fn acted(&mut self, level: u8, ok: bool, value: i32) -> Vec<String> {
        self.step(ScriptInput::Acted { level, ok, value })
    }

    /// The value of a variable of the script.
    pub fn var(&self, slot: Slot) -> i64 {
        let Slot::Task(at) = slot else { panic!("{slot:?} is no variable of the task") };
        self.script.var(at).expect("a variable")
    }
}

/// Packs a script, reads it back and compares; returns the bytes.
pub fn same_when_packed(program: &Program, script: &Script) -> Vec<u8> {
    let frame = Frame { rounds: &[], sequences: &[Frame::SEQUENCE; 16], incarnations: true };
    let bytes = Encode::bytes(&frame, |w| script.clone().walk(program, w)).expect("it fits");
    let mut loaded = Script::new(program);
    let garbage: Vec<u8> = (0..=255).collect();
    Decode::read(&garbage, true, |r| loaded.walk(program, r));
    assert_eq!(Decode::read(&bytes, true, |r| loaded.walk(program, r)), bytes.len(), "{script:?}");
    assert_eq!(loaded, *script);
    bytes
}

/// A message whose id is `age` numbers before the sender's next id.
pub fn message(port: PortId, class: Class, age: u32, bytes: &[u8]) -> Delivery {
    let sequence = Frame::SEQUENCE.plus(Seq24::MODULUS - age);
    let id = MessageId { incarnation: Incarnation(3), sequence };
    Delivery {
        from: ReplyTo { port, source: PEER, id },
        class,
        budget: Ticks(9),
        contents: Contents::new(bytes).expect("short"),
        fragments: 1,
    }
}

pub fn status(bytes: &[u8]) -> Signal {
    Signal::Message(message(TELL, Class::Status, 1, bytes))
}

pub fn command(bytes: &[u8]) -> Signal {
    Signal::Message(message(TELL, Class::Command, 1, bytes))
}

pub fn call(port: PortId, age: u32, bytes: &[u8]) -> Signal {
    Signal::Interrupt(Call::Message(message(port, Class::Command, age, bytes)))
}

pub fn replied(bytes: &[u8]) -> Signal {
    Signal::Outcome(Outcome::Reply(Contents::new(bytes).expect("short")))
}
