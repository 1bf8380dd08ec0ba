//! Random cells: small ones, of every statement, expression, option, usage and fault of the language.
//!
//! A cell is made of what a source of numbers gives, and a lower number makes less: so a shorter source of smaller numbers
//! makes a smaller cell, and the failure of a large one shrinks to the failure of a small one.

use std::fmt::Write;

/// Where random numbers come from. Past its end there are zeros.
pub struct Tape<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Tape<'a> {
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    fn below(&mut self, limit: usize) -> usize {
        let byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        usize::from(byte) * limit / 256
    }

    /// True so often in a hundred times, and false where nothing is left.
    fn chance(&mut self, percent: usize) -> bool {
        self.below(100) >= 100 - percent
    }

    fn one<'b>(&mut self, of: &[&'b str]) -> &'b str {
        of[self.below(of.len())]
    }
}

/// What a port is for.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Use {
    /// Its owner tells others something, of class 1.
    Status,
    /// Its owner gives orders, of class 2.
    Order,
    /// Its owner is told something, of this class.
    Told(u8),
    /// Its owner asks.
    Ask,
    /// Its owner is asked.
    Asked,
    Meet,
}

struct Port {
    name: String,
    of: Use,
    owner: usize,
    users: Vec<usize>,
    /// The types of what it carries, and of the answer.
    carries: &'static [&'static str],
    answer: Option<&'static str>,
    /// Whether those who take its messages do so by a handler.
    handled: bool,
}

/// What a task does at a port.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    Sends,
    Takes,
    Asks,
    Answers,
    Meets,
}

impl Port {
    fn role(&self, task: usize) -> Option<Role> {
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

    fn is_command(&self) -> bool {
        matches!(self.of, Use::Order | Use::Told(2) | Use::Ask | Use::Asked)
    }

    /// Those who take a message that this task sends here.
    fn others(&self, task: usize) -> Vec<usize> {
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

const TASKS: [&str; 3] = ["ta", "tb", "tc"];
const CARRIES: [&[&str]; 7] =
    [&["int8"], &[], &["Note"], &["bool", "int8"], &["int16"], &["real"], &["word", "int32"]];

/// A random cell.
pub struct Cell<'a> {
    tape: Tape<'a>,
    text: String,
    tasks: usize,
    ports: Vec<Port>,
    /// Which task is written.
    here: usize,
    /// Whether the statement stands in a loop, a handler, an atomic part.
    loops: usize,
    handler: bool,
    atomic: bool,
    deep: usize,
    works: bool,
    /// Whether this task has a timer.
    timer: bool,
    /// The ports that it has used.
    used: Vec<usize>,
    /// Whether a couple exchanges roles.
    mutual: bool,
    looped: bool,
}

/// The cell that a source of numbers makes.
pub fn cell(bytes: &[u8]) -> String {
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
    };
    cell.write();
    cell.text
}

impl Cell<'_> {
    fn put(&mut self, words: &str) {
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
        // Where one comes to a meeting for ever and the others do not, the rounds differ more and more: nothing packed
        // holds them.
        let meets = self.ports.iter().any(|port| port.of == Use::Meet);
        self.looped = self.tape.chance(if meets { 20 } else { 70 });
        for task in 0..self.tasks {
            self.task(task);
        }
        self.rest();
    }

    /// One for each task; sometimes the last two share one.
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
            // The ends of a row reach each other through its middle.
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
        if outside {
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
            // What was assigned shows.
            self.put("    if i > 0 and m.n > 0 or m.b or f then run turn i, f takes 1 msec; end;\n");
        }
        if looped {
            // What goes on for ever takes time, and numbers come back to what they were.
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
            if self.tape.chance(30) {
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
                write!(self.text, "  on silence {} 9 msec{when} do f := true; end;\n", self.ports[at].name);
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

    fn statements(&mut self, own: &[usize], most: usize) {
        for _ in 0..=self.tape.below(most) {
            self.statement(own);
        }
    }

    fn statement(&mut self, own: &[usize]) {
        let usable: Vec<usize> = own.iter().copied().filter(|&at| self.may_use(at)).collect();
        match self.tape.below(20) {
            0..10 if !usable.is_empty() => {
                let at = usable[self.tape.below(usable.len())];
                self.use_port(at, own);
            }
            0..12 => self.simple(),
            12 if self.deep < 2 => self.block(own, "if "),
            13 if self.deep < 2 => self.block(own, "while "),
            14 if self.deep < 2 && !self.atomic => {
                self.put("    atomic ");
                self.atomic = true;
                self.simple();
                if self.tape.chance(60) {
                    self.takes_time();
                }
                self.atomic = false;
                self.put("end;\n");
            }
            15 if self.loops > 0 && self.deep > 0 => self.put("    exit;\n"),
            16 => {
                let condition = self.condition(1);
                let _ = writeln!(self.text, "    assert {condition} or true;");
            }
            17 => {
                let condition = self.condition(1);
                let _ = writeln!(self.text, "    if {condition} then abort \"so\"; end;");
            }
            _ => self.run(),
        }
    }

    fn may_use(&self, at: usize) -> bool {
        let port = &self.ports[at];
        let takes = matches!(port.role(self.here), Some(Role::Takes | Role::Answers));
        !(takes && port.handled)
    }

    fn block(&mut self, own: &[usize], word: &str) {
        let condition = self.condition(2);
        self.deep += 1;
        if word == "if " {
            let _ = writeln!(self.text, "    if {condition} then");
            self.statements(own, 2);
            if self.tape.chance(30) {
                let other = self.condition(1);
                let _ = writeln!(self.text, "    elsif {other} then");
                self.statements(own, 1);
            }
            if self.tape.chance(50) {
                self.put("    else\n");
                self.statements(own, 1);
            }
        } else {
            let _ = writeln!(self.text, "    while {condition} do");
            self.loops += 1;
            self.statements(own, 1);
            self.put("    delay 8 msec;\n");
            if self.tape.chance(50) {
                self.put("    exit;\n");
            }
            self.loops -= 1;
        }
        self.deep -= 1;
        self.put("    end;\n");
    }

    /// A statement that uses no port and takes no time.
    fn simple(&mut self) {
        match self.tape.below(8) {
            0 => {
                let value = self.number(2);
                let _ = write!(self.text, "    i := ({value}) mod 3; ");
            }
            1 => self.put("    skip; "),
            2 => {
                let value = self.number(2);
                let _ = write!(self.text, "    j := ({value}) * 0 + 1; ");
            }
            3 => {
                let value = self.condition(2);
                let _ = write!(self.text, "    f := {value}; ");
            }
            4 => {
                let value = self.number(1);
                let _ = write!(self.text, "    m.n := ({value}) mod 2; ");
            }
            5 => {
                let value = self.condition(1);
                let _ = write!(self.text, "    m.b := {value}; ");
            }
            6 => {
                let value = self.tape.one(&["0.5", "1.5", "r / 2.0 - r / 2.0 + 0.25"]);
                let _ = write!(self.text, "    r := {value}; ");
            }
            _ if self.works && self.here < 2 && !self.handler && self.here == 0 => {
                self.put("    alive := 1; ")
            }
            _ => self.put("    i := trunc(r); "),
        }
        self.put("\n");
    }

    /// A statement that waits for nobody.
    fn takes_time(&mut self) {
        if self.tape.chance(50) { self.put("    delay 2 msec;\n") } else { self.run() }
    }

    fn run(&mut self) {
        let action = self.tape.one(&["grip", "turn", "look"]);
        let arguments = if action == "turn" { " i, f" } else { "" };
        let into = match action {
            "look" => " -> f",
            "turn" => " -> i in 0 .. 1",
            _ => "",
        };
        let takes = self.tape.one(&[" takes 3 msec", " takes 1..4 msec", " takes 2..9 msec", ""]);
        let _ = write!(self.text, "    run {action}{arguments}{into}{takes}");
        self.branches(&["failed"]);
    }

    /// Branches of a statement, and its end.
    fn branches(&mut self, of: &[&str]) {
        for when in of {
            if self.tape.chance(50) {
                let _ = write!(self.text, " on {when} do ");
                self.simple();
                self.put("skip; end");
            }
        }
        self.put(";\n");
    }

    /// Values of these types.
    fn values(&mut self, of: &[&str]) -> String {
        let values: Vec<String> = of
            .iter()
            .map(|of| match *of {
                "bool" => self.condition(1),
                "real" => self.tape.one(&["0.5", "r", "r * 0.0 + 1.0"]).into(),
                "Note" => self.tape.one(&["m", "1, true", "i, f"]).into(),
                "word" | "int32" => self.tape.one(&["3", "7"]).into(),
                _ => self.tape.one(&["5", "1", "i", "7"]).into(),
            })
            .collect();
        values.join(", ")
    }

    /// Places for what a port carries.
    fn places(&self, at: usize) -> String {
        let place = |of: &&str| match *of {
            "bool" => "f",
            "real" => "r",
            "Note" => "m",
            "int32" | "word" => "j",
            _ => "i",
        };
        self.ports[at].carries.iter().map(place).collect::<Vec<_>>().join(", ")
    }

    fn answer(&mut self, at: usize) -> String {
        let asked = self.ports[at].role(self.here) == Some(Role::Answers);
        let word = if asked { "response" } else { "reply" };
        let of: Vec<&str> = self.ports[at].answer.into_iter().collect();
        let values = self.values(&of);
        format!("{word}({values});")
    }

    fn use_port(&mut self, at: usize, own: &[usize]) {
        if self.atomic {
            return self.simple();
        }
        self.used.push(at);
        let port = &self.ports[at];
        let (name, command) = (port.name.clone(), port.is_command());
        let (role, carries, answer) = (port.role(self.here), port.carries, port.answer);
        let others = port.others(self.here);
        let within = if self.tape.chance(15) { " within 10 msec" } else { "" };
        match role {
            Some(Role::Sends | Role::Asks) => {
                let word = match role {
                    Some(Role::Asks) => "query",
                    _ if self.ports[at].owner == self.here => "send",
                    _ => "use_send",
                };
                let alone = others.len() > 1 && self.tape.chance(40);
                let to = if alone {
                    format!("{}, ", TASKS[others[self.tape.below(others.len())]])
                } else {
                    String::new()
                };
                let values = self.values(carries);
                let arguments = format!("{to}{values}");
                let arguments = arguments.trim_end_matches(", ");
                let into = match answer.filter(|_| command && (alone || others.len() == 1)) {
                    Some("bool") => " -> f",
                    Some("Note") => " -> m",
                    Some(_) => " -> i",
                    None => "",
                };
                let _ = write!(self.text, "    {word} {name}({arguments}){into}{within}");
                self.branches(if command { &["time_out", "refused"] } else { &[] });
                if command && !alone && others.len() > 1 && answer.is_some() && self.tape.chance(50) {
                    let who = TASKS[others[0]];
                    let _ = writeln!(self.text, "    if {name}.answered({who}) then skip; end;");
                }
            }
            Some(Role::Takes | Role::Answers) => {
                let into = self.places(at);
                let from = if others.len() > 1 && self.tape.chance(30) {
                    format!(" from {}", TASKS[others[self.tape.below(others.len())]])
                } else {
                    String::new()
                };
                let what = if command || self.tape.chance(90) {
                    format!(" {name}({into}){from}")
                } else {
                    String::new()
                };
                let _ = write!(self.text, "    receive{what}{within}");
                if !within.is_empty() {
                    // Who was told nothing answers nobody.
                    let leaves = if command { "abort \"nothing came\"" } else { "skip" };
                    let _ = write!(self.text, " on time_out do {leaves}; end");
                }
                self.put(";\n");
                if command {
                    let (who, mut answer) = (TASKS[others[0]], self.answer(at));
                    if others.len() == 1 && self.tape.chance(20) {
                        answer = answer.replacen('(', &format!(" {name}("), 1);
                        answer = answer.replace(");", &format!(") for {who};"));
                    }
                    let _ = writeln!(self.text, "    {answer}");
                }
            }
            Some(Role::Meets) => {
                let values = self.values(carries);
                let _ = write!(self.text, "    waitfor {name}({values}){within} on time_out do ");
                self.simple();
                self.put("skip; end;\n");
                let who = TASKS[others[0]];
                match self.tape.below(4) {
                    0 if carries == ["int8"] && self.deep < 2 => {
                        let _ =
                            writeln!(self.text, "    if {name}.told({who}) and {name}.u({who}) = 5 then\n");
                        self.deep += 1;
                        self.statement(own);
                        self.deep -= 1;
                        self.put("    end;\n");
                    }
                    1 => {
                        let _ = writeln!(self.text, "    f := {name}.told({who});");
                    }
                    _ => {}
                }
            }
            None => {}
        }
    }

    fn number(&mut self, deep: usize) -> String {
        let deeper = deep.saturating_sub(1);
        match self.tape.below(if deep == 0 { 4 } else { 10 }) {
            0 => "1".into(),
            1 => "i".into(),
            2 => "m.n".into(),
            3 => "2".into(),
            4 => format!("{} + {}", self.number(deeper), self.number(deeper)),
            5 => format!("{} - 1", self.number(deeper)),
            6 => format!("({}) * 2", self.number(deeper)),
            7 => format!("({}) / 2", self.number(deeper)),
            8 => format!("-({})", self.number(deeper)),
            _ => format!("({}) mod 2", self.number(deeper)),
        }
    }

    fn condition(&mut self, deep: usize) -> String {
        let deeper = deep.saturating_sub(1);
        match self.tape.below(if deep == 0 { 4 } else { 9 }) {
            0 => "true".into(),
            1 => "f".into(),
            2 => "m.b".into(),
            3 => "false".into(),
            4 => format!("({} and {})", self.condition(deeper), self.condition(deeper)),
            5 => format!("({} or {})", self.condition(deeper), self.condition(deeper)),
            6 => format!("not ({})", self.condition(deeper)),
            _ => {
                let compare = self.tape.one(&["=", "<>", "<", "<=", ">", ">="]);
                format!("({} {compare} {})", self.number(deeper), self.number(deeper))
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
    }

    fn check(&mut self, what: &str) {
        if self.text.contains("task ta on n0 extern") || self.text.contains("module crew extern") {
            return;
        }
        let number = self.text.matches("\ncheck ").count();
        let _ = writeln!(self.text, "check c{number}: {what};");
    }
}
