"""Faults for the protocol: those that cargo-mutants proposes, and those that are written down as lines of a file."""
import hashlib, json, shutil, subprocess
from pathlib import Path
from typing import NamedTuple

from copies import ROOT


class Edit(NamedTuple):
    """A fault as a change of one file: what stands from `start` to `end` becomes `new`."""
    path: str
    start: int
    end: int
    new: str

    def applied(self, text):
        return text[: self.start] + self.new + text[self.end :]


def proposed():
    """What cargo-mutants proposes."""
    if shutil.which("cargo-mutants") is None:
        subprocess.run(["cargo", "install", "cargo-mutants", "--locked"], check=True)
    listed = subprocess.run(["cargo", "mutants", "--list", "--json", "-p", "imrs-protocol"], cwd=ROOT,
                            check=True, capture_output=True, text=True)
    return json.loads(listed.stdout)


def key(mutant):
    """Names a mutant by what it changes, not by where: lines above it may move."""
    return hashlib.sha256(mutant["diff"].split("@@", 2)[2].encode() + mutant["file"].encode()).hexdigest()[:16]


def sample(mutants, seed, count):
    order = lambda m: hashlib.sha256(f"{seed} {key(m)}".encode()).hexdigest()
    return sorted(mutants, key=order)[:count]


def edit_of_mutant(mutant):
    lines = (ROOT / mutant["file"]).read_text().splitlines(keepends=True)
    at = lambda place: len("".join(lines[: place["line"] - 1])) + place["column"] - 1
    return Edit(mutant["file"], at(mutant["span"]["start"]), at(mutant["span"]["end"]), mutant["replacement"])


class Fault(NamedTuple):
    """A fault written by hand: lines of a file that are taken out, and what comes in."""
    title: str
    claim: str
    path: str
    old: str
    new: str


def written(path):
    """The faults that a file lists: what is wrong, which claim should say so, in which file, the lines out and in."""
    found = []
    for block in path.read_text().split("\n# ")[1:]:
        title, *lines = block.splitlines()
        field = lambda name: next(line.removeprefix(name) for line in lines if line.startswith(name))
        part = lambda sign: "".join(line[2:] + "\n" for line in lines if line[:1] == sign)
        found.append(Fault(title.strip(), field("claim: "), field("file: "), part("-"), part("+")))
    return found


def edit_of_fault(fault):
    """None where its lines do not stand in its file exactly once."""
    text = (ROOT / fault.path).read_text()
    start = text.find(fault.old)
    return Edit(fault.path, start, start + len(fault.old), fault.new) if text.count(fault.old) == 1 else None
