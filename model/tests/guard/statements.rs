//! The statements and the expressions of random cells.

use super::cells::{Cell, Role, TASKS, Tape};
use std::fmt::Write;

impl Cell<'_> {
    pub(super) fn statements(&mut self, own: &[usize], most: usize) {
        for _ in 0..=self.tape.below(most) {
            self.statement(own);
        }
    }

    pub(super) fn statement(&mut self, own: &[usize]) {
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

    pub(super) fn may_use(&self, at: usize) -> bool {
        let port = &self.ports[at];
        let takes = matches!(port.role(self.here), Some(Role::Takes | Role::Answers));
        !(takes && port.handled)
    }

    pub(super) fn block(&mut self, own: &[usize], word: &str) {
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

    /// Writes a statement that uses no port and takes no time.
    pub(super) fn simple(&mut self) {
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
                self.put("    alive := 1; ");
            }
            _ => self.put("    i := trunc(r); "),
        }
        self.put("\n");
    }

    /// Writes a statement that waits for no other task.
    pub(super) fn takes_time(&mut self) {
        if self.tape.chance(50) { self.put("    delay 2 msec;\n") } else { self.run() }
    }

    pub(super) fn run(&mut self) {
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

    /// Writes the branches of a statement, and its end.
    pub(super) fn branches(&mut self, of: &[&str]) {
        for when in of {
            if self.tape.chance(50) {
                let _ = write!(self.text, " on {when} do ");
                self.simple();
                self.put("skip; end");
            }
        }
        self.put(";\n");
    }

    /// Random expressions of these types, as text.
    pub(super) fn values(&mut self, of: &[&str]) -> String {
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

    /// The variables for the fields of a port's messages, as text.
    pub(super) fn places(&self, at: usize) -> String {
        let place = |of: &&str| match *of {
            "bool" => "f",
            "real" => "r",
            "Note" => "m",
            "int32" | "word" => "j",
            _ => "i",
        };
        self.ports[at].carries.iter().map(place).collect::<Vec<_>>().join(", ")
    }

    pub(super) fn answer(&mut self, at: usize) -> String {
        let asked = self.ports[at].role(self.here) == Some(Role::Answers);
        let word = if asked { "response" } else { "reply" };
        let of: Vec<&str> = self.ports[at].answer.into_iter().collect();
        let values = self.values(&of);
        format!("{word}({values});")
    }

    pub(super) fn use_port(&mut self, at: usize, own: &[usize]) {
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
                    // After a time_out there is no message to which the task could reply.
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

    pub(super) fn number(&mut self, deep: usize) -> String {
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

    pub(super) fn condition(&mut self, deep: usize) -> String {
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
}

impl Cell<'_> {
    /// Writes a body for an extern task, if the task gets one. The body may use ports, and waits for its rate. Its values
    /// are among those that the search tries: zero and one, the same in all fields.
    pub(super) fn body_outside(&mut self, own: &[usize]) {
        let Some(mut tape) = self.filled.take() else { return };
        self.put("  var i: int16; var j: int32; var f: bool; var r: real; var m: Note;\nbegin\n");
        for _ in 0..=tape.below(4) {
            match own.get(tape.below(own.len() + 1)) {
                Some(&at) => self.use_outside(at, &mut tape),
                None => self.put("  delay 10 msec;\n"),
            }
        }
        self.put("  loop delay 10 msec; end;\n");
        self.filled = Some(tape);
    }

    fn use_outside(&mut self, at: usize, tape: &mut Tape<'_>) {
        let one = tape.chance(75);
        let port = &self.ports[at];
        let value = |of: &&str| match (*of, one) {
            ("bool", _) => one.to_string(),
            // The search tries zero, so this body needs no other real.
            ("real", _) => "0.0".into(),
            ("Note", _) => format!("{}, {one}", u8::from(one)),
            _ => u8::from(one).to_string(),
        };
        let said: Vec<String> = port.carries.iter().map(value).collect();
        let answered: Vec<String> = port.answer.iter().map(value).collect();
        let (name, said, answered) = (port.name.clone(), said.join(", "), answered.join(", "));
        let (command, owns) = (port.is_command(), port.owner == self.here);
        let places = self.places(at);
        let _ = match port.role(self.here) {
            Some(Role::Sends) => {
                let word = if owns { "send" } else { "use_send" };
                let leaves = if command { " on time_out do skip; end on refused do skip; end" } else { "" };
                writeln!(self.text, "  {word} {name}({said}){leaves}; delay 10 msec;")
            }
            Some(Role::Takes) => {
                let reply = if command { format!(" reply({answered});") } else { String::new() };
                writeln!(self.text, "  receive {name}({places});{reply}")
            }
            Some(Role::Meets) => {
                writeln!(self.text, "  waitfor {name}({said}) on time_out do skip; end; delay 10 msec;")
            }
            // The extern tasks of random cells neither query nor answer.
            Some(Role::Asks | Role::Answers) | None => Ok(()),
        };
    }
}
