"""Faults in one program (.ci/schemata.py), as a copy of the tree: what .ci/detection and .ci/planted run."""
import fcntl, hashlib, json, os, re
from typing import NamedTuple

from copies import QUICK, ROOT, TARGET, Copy, limited, tracked
from faults import Edit, edit_of_fault, written
from schemata import Program

# Of a random cell that differs, a smaller one that differs, too, is of no use here, and takes long to find.
SHRINKS = "model/tests/guard/mod.rs", "let small = shrink(tape(seed), seed);", "let small = tape(seed);"
# How each program is built.
BUILDS = {
    "quick": ["build", *QUICK],
    "imrs": ["build", "--workspace", "--bin", "imrs"],
    "all": ["test", "--workspace", "--test", "all", "--no-run"],
    "--lib": ["test", "-p", "imrs-protocol", "--lib", "--no-run"],
    "tests": ["test", "-p", "imrs-model", "--test", "all", "--no-run"],
    "--test": ["test", "-p", "imrs-protocol", "--test", "all", "--no-run"],
}


class Entry(NamedTuple):
    number: int
    key: str
    kind: str
    name: str
    edit: Edit


def by_hand(path, kind):
    """The faults of a file, but for their numbers."""
    found = []
    for fault in written(path):
        edit = edit_of_fault(fault)
        if edit is None:
            raise SystemExit(f"{path}: the lines of a fault do not stand in {fault.path} exactly once: {fault.title}")
        name = hashlib.sha256((fault.path + fault.old + fault.new).encode()).hexdigest()[:16]
        found.append((name, kind, fault.title, edit))
    return found


def numbered(found):
    return [Entry(number, *entry) for number, entry in enumerate(found, 1)]


class Built:
    """A program with these faults: its checker, its command and its tests, each built when it is run."""

    def __init__(self, name, chosen):
        self.copy = Copy(name)
        self.bin = TARGET / "faults" / name
        self.manifest = self.bin / "manifest.json"
        edits = {entry.number: entry.edit for entry in chosen}
        digest = hashlib.sha256(repr(edits).encode())
        for name in tracked("protocol", "model", "language", "runtime", "client", "testkit", "src", "tests", "examples", ".ci/schemata.py"):
            digest.update((ROOT / name).read_bytes())
        with self.alone():
            if self.known.get("stamp") != digest.hexdigest():
                self.note(stamp=digest.hexdigest(), unfit=sorted(self.fill(edits)), programs={}, examples={})
        self.unfit = set(self.known["unfit"])

    def alone(self):
        """One of several runs beside each other builds, the others wait."""
        self.bin.mkdir(parents=True, exist_ok=True)
        lock = (self.bin / "lock").open("w")
        fcntl.flock(lock, fcntl.LOCK_EX)
        return lock

    @property
    def known(self):
        return json.loads(self.manifest.read_text()) if self.manifest.exists() else {}

    def note(self, **more):
        new = self.manifest.with_suffix(".new")
        new.write_text(json.dumps({**self.known, **more}, indent=1))
        new.replace(self.manifest)

    def fill(self, edits):
        """Fills the copy with the faults that the compiler takes, and returns the others."""
        unfit, (path, shrinks, instead) = set(), SHRINKS
        text = (ROOT / path).read_text()
        if text.count(shrinks) != 1:
            raise SystemExit(f"{path}: where are cells made smaller?")
        while True:
            program = Program({number: edit for number, edit in edits.items() if number not in unfit})
            self.copy.fill({**program.texts, path: text.replace(shrinks, instead)})
            check = self.copy.cargo("check", *QUICK, "--message-format=json")
            if check.returncode == 0:
                return unfit | program.outside
            broken = program.broken(check.stdout)
            if not broken:
                raise SystemExit(check.stderr)
            unfit |= broken

    def program(self, name):
        """Where a program is: `quick`, `imrs`, or the tests of a crate, as `model all` and `protocol --lib`."""
        if name not in self.known["programs"]:
            with self.alone():
                if name not in self.known["programs"]:
                    self.note(programs={**self.known["programs"], **self.build(name.split()[-1])})
        return self.known["programs"][name]

    def build(self, what):
        built = self.copy.cargo(*BUILDS[what], "--message-format=json")
        if built.returncode:
            raise SystemExit(built.stderr)
        messages = [json.loads(line) for line in built.stdout.splitlines() if line.startswith("{")]
        found = {}
        for message in messages:
            name = message.get("executable") and message["target"]["name"]
            if what in ("quick", "imrs"):
                if name == what:
                    # Another build would write over it.
                    found[name] = str(self.bin / name)
                    (self.bin / name).write_bytes(open(message["executable"], "rb").read())
                    (self.bin / name).chmod(0o755)
            elif name and message["profile"]["test"]:
                folder = os.path.relpath(os.path.dirname(message["manifest_path"]), self.copy.folder.resolve())
                found[f"{folder} {what}"] = message["executable"]
        return found

    def run(self, number, program, arguments, cpu, folder=".", **env):
        """The exit code of a program with a fault, None where it does not end, and what it says."""
        return limited([self.program(program), *arguments], self.copy.folder / folder, cpu, 8 * cpu + 60, 8 * 10**9,
                       IMRS_FAULT=str(number), **env)

    def claims(self, number, cpu, *claim):
        """The first row that comes out other than expected; None where none does."""
        code, output = self.run(number, "quick", claim, cpu)
        # A row that was cut short says nothing.
        return output.strip().splitlines()[-1] if code == 1 and not output.strip().endswith(": Unknown") else None

    def guard(self, number, first, last, piece, cpu):
        """The first of these random cells that runs otherwise than it was searched, by its seed; None where none does."""
        for begin in range(first, last + 1, piece):
            env = dict(IMRS_CELLS=str(min(piece, last + 1 - begin)), IMRS_SEED=str(begin))
            _, output = self.run(number, "model all", ["guard::random_cells_run", "--nocapture"], cpu, "model", **env)
            if differs := re.search(r"(IMRS_SEED=\d+) IMRS_CELLS=1 differs", output):
                return differs.group(1)
        return None

    def fused(self, number, cpu):
        """Where the test of random cells sees that a fused step differs from its small steps; None where it does not. Another panic is none."""
        code, output = self.run(number, "protocol --test", ["fused::a_fused_step_equals_the_small_steps", "--exact"], cpu, "protocol")
        differs = re.search(r"panicked at (\S*tests/support/fused\.rs:\d+)", output)
        return differs.group(1) if code == 101 and differs else None

    def zones(self, number, cpu):
        """Where a comparison of the search by zones with that at every tick fails; None where none does, and the empty text where one did not end. The
        seeds of the gate come first."""
        for seed, cells in (1, 120), (121, 200):
            env = dict(IMRS_SEED=str(seed), IMRS_CELLS=str(cells), RUST_TEST_THREADS="1")
            code, output = self.run(number, "model tests", ["zones::"], cpu, "model", **env)
            if code is None or code < 0:
                return ""
            if code == 101:
                where = re.search(r"panicked at (\S+:\d+):\d+:\n(.{0,160})", output)
                what = f"{where[1]}: {where[2]}" if where else "a test fails"
                return what.replace(f"{self.copy.folder}/model/../", "")
        return None

    def verdict(self, number, cell, cpu):
        """What is said of a cell; None where the checker does not end, or does not look at all of it."""
        arguments = ["verify", cell, "--jobs", "1", "--within", "600s", "--format", "json"]
        code, output = self.run(number, "imrs", arguments, cpu)
        if code not in (0, 1, 2, 3):
            return None
        said = sorted(set(re.findall(r"^(?:error|warn)\[\w+\].*\n +--> .*", output, flags=re.MULTILINE)))
        begins = output.find('{"version"')
        told = json.JSONDecoder().raw_decode(output[begins:])[0] if begins >= 0 else {}
        found = [f"{finding['kind']} {finding['line']}:{finding['column']}" for finding in told.get("findings", [])]
        return {"code": code, "found": sorted(found), "said": said, "refused": told.get("not_checked")}

    def examples(self, cpu):
        """Each example with the seconds that it takes without a fault, and what is said of it, where it takes no more than these."""
        self.program("imrs")
        with self.alone():
            if not self.known["examples"]:
                found = {}
                for cell in (name for name in tracked("examples") if name.endswith(".cell")):
                    before = os.times().children_user
                    verdict = self.verdict(0, cell, cpu)
                    if verdict is not None:
                        found[cell] = [os.times().children_user - before, verdict]
                self.note(examples=dict(sorted(found.items(), key=lambda pair: pair[1][0])))
        return [(cell, *said) for cell, said in self.known["examples"].items()]
