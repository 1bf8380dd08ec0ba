"""Many faults in one program: a process has the one whose number the environment names (`IMRS_FAULT`).

Compiling takes longer than judging. So every function with faults gets one body for each of them beside its own, and
chooses among them when it is called; it is `const` no more. A fault outside a function, or in one that returns an `impl`
type, fits in no such body: it is compiled alone.
"""
import json, re

from copies import ROOT
from faults import Edit

LIBRARY = "protocol/src/lib.rs"
SWITCH = """extern crate std;

/// The number of the fault that this process has.
pub fn fault() -> u32 {
    static FAULT: std::sync::LazyLock<u32> = std::sync::LazyLock::new(|| {
        std::env::var("IMRS_FAULT").map_or(0, |number| number.parse().expect("the number of a fault"))
    });
    *FAULT
}
"""


def masked(text):
    """The text with blanks for comments, strings and characters: what is left has its braces in pairs."""
    blank = lambda found: re.sub(r"[^\n]", " ", found.group())
    token = r"""//[^\n]*|/\*.*?\*/|b?r(#*)".*?"\1|b?"(?:\\.|[^"\\])*"|b?'(?:\\[^\n]*?|[^'\\\n])'"""
    return re.sub(token, blank, text, flags=re.DOTALL)


def functions(text):
    """The outermost functions: where each begins, and where its body opens and closes."""
    text, found = masked(text), []
    for name in re.finditer(r"\bfn\s+\w+", text):
        if found and name.start() < found[-1][2]:
            continue
        at, depth = name.end(), 0
        while depth or text[at] not in "{;":
            depth += (text[at] in "([") - (text[at] in ")]")
            at += 1
        if text[at] == ";":
            continue
        opens, depth = at, 1
        while depth:
            at += 1
            depth += (text[at] == "{") - (text[at] == "}")
        found.append((text.rfind("\n", 0, name.start()) + 1, opens, at))
    return found


def place(text, edit):
    """The function in whose body an edit lies, if it can have several bodies."""
    for begins, opens, closes in functions(text):
        if opens < edit.start and edit.end <= closes:
            signature, shorter = text[begins:opens], None
            while signature != shorter:
                signature, shorter = re.sub(r"\([^()]*\)", "", signature), signature
            if not re.search(r"->.*\bimpl\b", signature, flags=re.DOTALL):
                return begins, opens, closes
    return None


class Program:
    """A program with these faults, by their numbers from 1 on: the texts of its files, and where each fault stands in them."""

    def __init__(self, edits):
        self.texts, self.arms, self.outside = {}, {}, set()
        by_path = {}
        for number, edit in edits.items():
            by_path.setdefault(edit.path, {})[number] = edit
        for path, of_file in by_path.items():
            self.put(path, of_file)
        library = self.texts.get(LIBRARY) or (ROOT / LIBRARY).read_text()
        library = library.replace('#[cfg(feature = "checker")]\nextern crate std;\n', "")
        self.texts[LIBRARY] = library.replace("#![no_std]\n", "#![no_std]\n#![allow(warnings)]\n").replace(
            "extern crate alloc;\n", "extern crate alloc;\n" + SWITCH)

    def put(self, path, edits):
        text = (ROOT / path).read_text()
        bodies = {}
        for number, edit in edits.items():
            body = place(text, edit)
            if body is None:
                self.outside.add(number)
            else:
                bodies.setdefault(body, {})[number] = edit
        built, at, arms = "", 0, []
        library = "crate" if path.startswith("protocol/src/") else "imrs_protocol"
        for (begins, opens, closes), of_body in sorted(bodies.items()):
            signature = re.sub(r"\bconst (?=fn\b)", "", text[begins : opens + 1])
            built += text[at:begins] + signature + f"match {library}::fault() {{\n"
            for number, edit in of_body.items():
                first = built.count("\n") + 1
                moved = Edit(path, edit.start - opens, edit.end - opens, edit.new)
                built += f"{number} => " + moved.applied(text[opens : closes + 1]) + "\n"
                arms.append((first, built.count("\n"), number))
            built += "_ => " + text[opens : closes + 1] + "\n}}"
            at = closes + 1
        if bodies:
            self.texts[path] = built + text[at:]
            self.arms[path] = arms

    def broken(self, messages):
        """The faults that the compiler complains of, in its messages as JSON; what it says of nobody's is an error."""
        found, others = set(), []
        for line in messages.splitlines():
            message = json.loads(line).get("message") if line.startswith("{") else None
            if not message or message["level"] != "error" or not message["spans"]:
                continue
            spans = [(span["file_name"], span["line_start"]) for span in message["spans"]]
            hits = {number for name, line in spans for first, last, number in self.arms.get(name, ())
                    if first <= line <= last}
            found |= hits
            if not hits:
                others.append(message["rendered"])
        if others:
            raise SystemExit("".join(others))
        return found
