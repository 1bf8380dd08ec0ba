//! Random cells: together these small cells use every statement, expression, option, usage and fault of the language.
//!
//! A cell is made from random bytes, and a smaller byte makes a smaller part of the cell. So fewer and smaller bytes make a
//! smaller cell, and a large cell that fails can be shrunk.

use std::fmt::Write;

/// A source of random numbers: some bytes, followed by zeros.
pub struct Tape<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Tape<'a> {
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub(super) fn below(&mut self, limit: usize) -> usize {
        let byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        usize::from(byte) * limit / 256
    }

    /// True with this probability in percent; false after the last byte.
    pub(super) fn chance(&mut self, percent: usize) -> bool {
        self.below(100) >= 100 - percent
    }

    pub(super) fn one<'b>(&mut self, of: &[&'b str]) -> &'b str {
        of[self.below(of.len())]
    }
}

/// The use of a port in a random cell.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Use {
    /// The owner sends messages of class 1.
    Status,
    /// The owner sends messages of class 2.
    Order,
    /// The owner receives messages of the class with this number.
    Told(u8),
    /// The owner sends queries.
    Ask,
    /// The owner receives queries.
    Asked,
    Meet,
}

pub(super) struct Port {
    pub(super) name: String,
    pub(super) of: Use,
    pub(super) owner: usize,
    pub(super) users: Vec<usize>,
    /// The types of the fields of the port's messages, and the type of the answer.
    pub(super) carries: &'static [&'static str],
    pub(super) answer: Option<&'static str>,
    /// Whether the receivers of the port's messages take them by a handler.
    pub(super) handled: bool,
}

/// What a task does with a port.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Sends,
    Takes,
    Asks,
    Answers,
    Meets,
}

impl Port {
    pub(super) fn role(&self, task: usize) -> Option<Role> {
        let owns = self.owner == task;
        if !owns && !self.users.contains(&task) {
            return None;
        }
        Some(match (self.of, owns) {
            (Use::Status | Use::Order, true) | (Use::Told(_), false) => Role::Sends,
            (Use::Status | Use::Order, false) | (Use::Told(_), true) => Role::Takes,
            (Use::Ask, true) | (Use::Asked, false) => Role::Asks,
            (Use::Ask, false) | (Use::Asked, true) => Role::Answers,
            (Use::Meet, _) => Role::Meets,
        })
    }

    pub(super) fn is_command(&self) -> bool {
        matches!(self.of, Use::Order | Use::Told(2) | Use::Ask | Use::Asked)
    }

    /// The tasks that receive a message which this task sends on the port.
    pub(super) fn others(&self, task: usize) -> Vec<usize> {
        match self.of {
            _ if self.owner == task => self.users.clone(),
            Use::Meet => {
                let all = std::iter::once(self.owner).chain(self.users.iter().copied());
                all.filter(|&other| other != task).collect()
            }
            _ => vec![self.owner],
        }
    }

    fn usage(&self, owns: bool) -> &'static str {
        match (self.of, owns) {
            (Use::Status | Use::Order, true) | (Use::Told(_), false) => "send",
            (Use::Status | Use::Order, false) | (Use::Told(_), true) => "receive",
            (Use::Ask, true) | (Use::Asked, false) => "query",
            (Use::Ask, false) | (Use::Asked, true) => "response",
            (Use::Meet, _) => "waitfor",
        }
    }
}

/// Two kinds of pauses: one is longer than any wait in the cell, the other is short.
const PAUSES: [&str; 2] = ["pause ta", "pause tb up to 9 msec"];
pub(super) const TASKS: [&str; 3] = ["ta", "tb", "tc"];
const CARRIES: [&[&str]; 9] = [
    &["int8"],
    &["int8"],
    &["int8"],
    &[],
    &["Note"],
    &["bool", "int8"],
    &["int16"],
    &["real"],
    &["word", "int32"],
];

/// A random cell.
pub struct Cell<'a> {
    pub(super) tape: Tape<'a>,
    pub(super) text: String,
    pub(super) tasks: usize,
    pub(super) ports: Vec<Port>,
    /// The task whose text is being written now.
    pub(super) here: usize,
    /// How many loops enclose the written statement. The next fields: whether it is in a handler, or in an atomic section.
    pub(super) loops: usize,
    pub(super) handler: bool,
    pub(super) atomic: bool,
    pub(super) deep: usize,
    pub(super) works: bool,
    /// Whether the task that is being written has a timer.
    pub(super) timer: bool,
    /// The ports that the task has used so far.
    pub(super) used: Vec<usize>,
    /// Whether a couple exchanges roles.
    pub(super) mutual: bool,
    pub(super) looped: bool,
    /// The extern tasks, whose bodies are outside the cell.
    pub(super) outside: Vec<usize>,
    /// The random bytes for the bodies of extern tasks, if these tasks get bodies.
    pub(super) filled: Option<Tape<'a>>,
}

/// The text of the cell that these random bytes make.
pub fn cell(bytes: &[u8]) -> String {
    written(bytes, None).text
}

/// The same cell, but with a body for each extern task, made from other random bytes. Such a body is one behaviour that the
/// extern task may have. Also returns the extern tasks. `None` if the cell has none.
pub fn filled(bytes: &[u8], bodies: &[u8]) -> Option<(String, Vec<usize>)> {
    let cell = written(bytes, Some(Tape::new(bodies)));
    (!cell.outside.is_empty()).then_some((cell.text, cell.outside))
}

fn written<'a>(bytes: &'a [u8], filled: Option<Tape<'a>>) -> Cell<'a> {
    let mut cell = Cell {
        tape: Tape::new(bytes),
        text: String::new(),
        tasks: 2,
        ports: Vec::new(),
        here: 0,
        loops: 0,
        handler: false,
        atomic: false,
        deep: 0,
        works: false,
        timer: false,
        used: Vec::new(),
        mutual: false,
        looped: false,
        outside: Vec::new(),
        filled,
    };
    cell.write();
    cell
}

impl Cell<'_> {
    pub(super) fn put(&mut self, words: &str) {
        self.text.push_str(words);
    }

    fn write(&mut self) {
        self.tasks += usize::from(self.tape.chance(30));
        self.works = self.tape.chance(10);
        self.mutual = self.works && self.tape.chance(20);
        self.put("cell random;\ntick 1 msec;\n");
        if self.tape.chance(5) {
            self.put("model tick 2 msec;\n");
        }
        self.nodes();
        self.put("type Note is record n: int8; b: bool; end;\n");
        for _ in 0..=self.tape.below(3) {
            self.port();
        }
        // If one member comes to a meeting for ever and the others do not, their rounds drift apart until they do not fit
        // into a packed state.
        let meets = self.ports.iter().any(|port| port.of == Use::Meet);
        self.looped = self.tape.chance(if meets { 20 } else { 70 });
        for task in 0..self.tasks {
            self.task(task);
        }
        self.rest();
    }

    /// Writes a node for each task; sometimes the last two tasks share one node.
    fn nodes(&mut self) {
        let nodes = self.tasks - usize::from(self.tape.chance(10));
        for node in 0..nodes {
            let at = if self.tape.chance(5) {
                format!(" at \"127.0.0.1\" port 40{node:02}")
            } else {
                String::new()
            };
            let _ = writeln!(self.text, "node n{node}{at};");
        }
        let in_row = nodes == 3 && self.tape.chance(30);
        for a in 0..nodes {
            // If the nodes form a row, the ends reach each other through the middle.
            let last = if in_row { nodes.min(a + 2) } else { nodes };
            for b in a + 1..last {
                let delay = self.tape.one(&["1 msec", "1 msec", "2 msec", "1000 usec"]);
                let _ = writeln!(self.text, "link n{a} -- n{b} delay {delay};");
            }
        }
    }

    fn port(&mut self) {
        let of = match self.tape.below(10) {
            0 => Use::Status,
            1 => Use::Order,
            2 => Use::Told(1),
            3 => Use::Told(2),
            4 => Use::Ask,
            5 => Use::Asked,
            _ => Use::Meet,
        };
        let owner = self.tape.below(self.tasks);
        let others: Vec<usize> = (0..self.tasks).filter(|&task| task != owner).collect();
        let users =
            if others.len() > 1 && !self.tape.chance(50) { vec![others[self.tape.below(2)]] } else { others };
        let carries = CARRIES[self.tape.below(CARRIES.len())];
        let answers = matches!(of, Use::Ask | Use::Asked) || of == Use::Order && self.tape.chance(40);
        let answer = answers.then(|| self.tape.one(&["int8", "bool", "Note"]));
        let answer = answer.and_then(|of| ["int8", "bool", "Note"].into_iter().find(|one| *one == of));
        let handled = self.tape.chance(40);
        let name = format!("p{}", self.ports.len());
        self.ports.push(Port { name, of, owner, users, carries, answer, handled });
    }

    fn declare(&mut self, at: usize, task: usize) {
        let port = &self.ports[at];
        let owns = port.owner == task;
        let fields = ["u", "v"];
        let parameters: Vec<String> =
            port.carries.iter().zip(fields).map(|(of, name)| format!("{name}: {of}")).collect();
        let answer = port.answer.map_or(String::new(), |of| format!(" -> {of}"));
        let (name, usage) = (port.name.clone(), port.usage(owns));
        let word = if owns { "port" } else { "use_port" };
        let _ = write!(
            self.text,
            "  {word} {name}({}){answer} usage = {usage}",
            parameters.join("; ").replace(';', ",")
        );
        if !owns {
            self.put(";\n");
            return;
        }
        let (of, carries) = (port.of, port.carries);
        let users: Vec<&str> = port.users.iter().map(|&user| TASKS[user]).collect();
        let _ = write!(self.text, " user_list = {{{}}}", users.join(", "));
        if carries == ["Note"] && self.tape.chance(50) {
            self.put(" message_format = Note");
        }
        let time_out = self.tape.one(if of == Use::Meet {
            &["30 msec", "40 msec"]
        } else {
            &["12 msec", "0.02 sec", "30 msec"]
        });
        let class = match of {
            Use::Status | Use::Told(1) => 1,
            _ => 2,
        };
        let _ = write!(self.text, " time_out = {time_out} class = {class}");
        if of != Use::Meet && self.tape.chance(40) {
            let room = 1 + self.tape.below(2);
            let _ = write!(self.text, " bounded_buffer[{room}]");
        }
        if class == 2 && self.tape.chance(35) {
            let resend = self.tape.one(&["4 msec", "5 msec"]);
            let _ = write!(self.text, " retry = 2 resend = {resend}");
        }
        if class == 1 && self.tape.chance(15) {
            self.put(" latest");
        }
        if of != Use::Meet && self.tape.chance(15) {
            let paper = if self.tape.chance(30) { "paper " } else { "" };
            let _ = write!(self.text, " penalty = {paper}3 msec");
        }
        if of != Use::Meet && self.tape.chance(5) {
            self.put(" rate = 1/10 msec");
        }
        self.put(";\n");
    }

    fn task(&mut self, task: usize) {
        let nodes = self.text.matches("\nnode ").count();
        self.here = task;
        self.used.clear();
        let node = task.min(nodes - 1);
        let name = TASKS[task];
        let module = if self.tape.chance(5) { " module crew" } else { "" };
        let standby = self.works && task == 1;
        let of = if standby { " standby of ta" } else { "" };
        let own: Vec<usize> =
            (0..self.ports.len()).filter(|&at| self.ports[at].role(task).is_some()).collect();
        let plain = |port: &Port| !port.handled && port.of != Use::Asked && port.of != Use::Ask;
        let outside =
            self.tape.chance(6) && !(self.works && task < 2) && own.iter().all(|&at| plain(&self.ports[at]));
        let _ = write!(self.text, "task {name} on n{node}{module}{of}");
        if outside && self.filled.is_none() {
            self.put(" extern rate = 1/10 msec");
        }
        self.put("\n");
        for &at in &own {
            self.declare(at, task);
        }
        if self.works && task < 2 {
            match task {
                0 => self.put(
                    "  port alive(h: int8) usage = response user_list = {tb} time_out = 8 msec class = 2;\n",
                ),
                _ => self.put("  use_port alive(h: int8) usage = query;\n"),
            }
        }
        if outside {
            self.outside.push(task);
            self.body_outside(&own);
            let _ = writeln!(self.text, "end {name};");
            return;
        }
        let (i, j) = (self.tape.one(&["int8", "int16"]), self.tape.one(&["int32", "integer", "word"]));
        self.timer = self.tape.chance(15);
        let timer = if self.timer { " var t: timer;" } else { "" };
        let _ =
            writeln!(self.text, "  var i: {i}; var j: {j}; var f: bool; var r: real; var m: Note;{timer}");
        self.put("begin\n");
        self.handlers(&own);
        let looped = self.looped;
        if standby {
            let taken = own
                .iter()
                .copied()
                .find(|&at| self.ports[at].role(task) == Some(Role::Takes) && !self.ports[at].handled);
            match taken {
                Some(at) => {
                    let name = self.ports[at].name.clone();
                    let into = self.places(at);
                    let answer = if self.ports[at].is_command() { self.answer(at) } else { String::new() };
                    let _ = writeln!(self.text, "  loop receive {name}({into}); {answer} end;");
                }
                None => self.put("  loop delay 10 msec; end;\n"),
            }
            self.put("takeover\n");
        }
        if looped {
            self.put("  loop\n");
            self.loops += 1;
        }
        self.statements(&own, 3);
        for &at in &own {
            let sends = matches!(self.ports[at].role(task), Some(Role::Sends | Role::Asks));
            if self.may_use(at) && !sends && !self.used.contains(&at) {
                self.use_port(at, &own);
            }
        }
        if self.tape.chance(60) {
            // This statement makes the assigned values visible outside of the task.
            self.put("    if i > 0 and m.n > 0 or m.b or f then run turn i, f takes 1 msec; end;\n");
        }
        if looped {
            // An endless loop must take time.
            let pause = self.tape.one(&["10 msec", "7 msec", "20 msec"]);
            let _ = writeln!(self.text, "    delay {pause}; end;");
            self.loops -= 1;
        }
        if self.mutual && task == 0 {
            self.put("takeover\n  loop delay 10 msec; end;\n");
        }
        let _ = writeln!(self.text, "end {name};");
    }

    fn handlers(&mut self, own: &[usize]) {
        let here = self.here;
        let takes = |port: &Port| matches!(port.role(here), Some(Role::Takes | Role::Answers));
        let handled: Vec<usize> =
            own.iter().copied().filter(|&at| self.ports[at].handled && takes(&self.ports[at])).collect();
        let timer = self.timer;
        let silence: Option<usize> = own
            .iter()
            .copied()
            .find(|&at| self.ports[at].role(here) == Some(Role::Takes) && self.ports[at].of == Use::Status)
            .filter(|_| self.tape.chance(30));
        let fence = self.works && self.here == 0 && self.tape.chance(50);
        if !handled.is_empty() || timer {
            let mut ranks: Vec<String> = handled.iter().map(|&at| self.ports[at].name.clone()).collect();
            if timer {
                ranks.insert(self.tape.below(ranks.len() + 1), "t".into());
            }
            if self.tape.chance(20) && !timer {
                ranks.push("timer".into());
            }
            let last = ranks.len() - usize::from(self.tape.chance(30));
            ranks.insert(last, "self".into());
            if self.tape.chance(80) {
                let _ = writeln!(self.text, "  order {};", ranks.join(" > "));
            }
        }
        self.handler = true;
        for at in handled {
            let port = &self.ports[at];
            let (name, asked) = (port.name.clone(), port.role(self.here) == Some(Role::Answers));
            let names: Vec<&str> = port.carries.iter().zip(["hu", "hv"]).map(|(_, name)| name).collect();
            let word = if asked { "query" } else { "receive" };
            let _ = writeln!(self.text, "  on {word} {name}({}) do", names.join(", "));
            if self.tape.chance(50) {
                self.simple();
            }
            if self.tape.chance(50) {
                self.takes_time();
                if self.ports[at].carries == ["int8"] {
                    self.put("    i := hu mod 3;\n");
                }
            }
            if self.ports[at].is_command() {
                let answer = self.answer(at);
                let _ = writeln!(self.text, "    {answer}");
            }
            self.put("    skip;\n  end;\n");
        }
        if timer {
            self.put("  on expiry t do ");
            self.simple();
            self.put("skip; end;\n");
        }
        if let Some(at) = silence {
            let when = if self.tape.chance(50) { " when not f" } else { "" };
            let _ =
                writeln!(self.text, "  on silence {} 9 msec{when} do f := true; end;", self.ports[at].name);
        }
        if fence {
            self.put("  on fence do i := 0; end;\n");
        }
        self.handler = false;
        if timer {
            self.put("  start t 6 msec;\n");
            if self.tape.chance(20) {
                self.put("  stop t;\n");
            }
        }
    }

    fn rest(&mut self) {
        if self.works {
            let mutual = if self.mutual { "<->" } else { "->" };
            let _ = writeln!(
                self.text,
                "couple work ta {mutual} tb lease 20 msec takeover 40 msec every 8 msec via alive;"
            );
        }
        if self.tape.chance(5) {
            self.put("couple tight {ta, tb};\n");
        }
        if self.tape.chance(5) {
            self.put("couple serial ta -> tb;\n");
        }
        if self.tape.chance(5) && self.tasks > 2 {
            self.put("couple loose {ta, tb} over tc;\n");
        }
        let linked = self.text.contains("link n0 -- n1");
        let cut = if linked { "cut n0 -- n1" } else { "fail 1" };
        let all = ["loss 1", "dup 1", "fail 1", "drift 1", "crash ta", "crash tb", cut];
        if self.tape.chance(70) {
            let fault = self.tape.one(&all);
            let other = if self.tape.chance(15) { self.tape.one(&all) } else { fault };
            let both = if other == fault { fault.to_owned() } else { format!("{fault} {other}") };
            let _ = writeln!(self.text, "faults {both};");
        }
        for _ in 0..self.tape.below(3) {
            match self.tape.below(4) {
                0 => self.check("never ta.i = 2"),
                1 => self.check("always ta.i < 3"),
                2 => self.check("ta.r >= 0.0"),
                _ => self.check("ta.f leads ta.i >= 0 within 40 msec"),
            }
        }
        // This part is drawn last, so that seeds which are named elsewhere still make the same cells.
        if self.tape.chance(25) {
            let pause = self.tape.one(&PAUSES);
            let other = if self.tape.chance(15) { self.tape.one(&all) } else { "" };
            let _ = writeln!(self.text, "faults {pause} {other};");
        }
    }

    fn check(&mut self, what: &str) {
        if self.text.contains("task ta on n0 extern") || self.text.contains("module crew extern") {
            return;
        }
        let number = self.text.matches("\ncheck ").count();
        let _ = writeln!(self.text, "check c{number}: {what};");
    }
}
