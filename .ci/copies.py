"""Copies of the tree into which faults are put: what .ci/planted, .ci/mutants and .ci/detection share."""
import os, re, subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "specs/results"
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
# The checker. All members are selected, because they decide the features, and so the build, of the libraries.
QUICK = ["--workspace", "--example", "quick"]


def tracked(*folders):
    """The files of the tree, new ones included, without what git ignores."""
    command = ["git", "ls-files", "-co", "--exclude-standard", "-z", *folders]
    files = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\0")
    return sorted({name for name in files if (ROOT / name).is_file()})


def renamed(name, data, suffix):
    """Gives the members of a copy versions of their own. Cargo would take what was built of one copy for what was built
    of the other, or of the tree itself: it knows a member by its name, its version and its place below the root."""
    if name == "Cargo.toml":
        return re.sub(rb'(\[workspace\.package\]\nversion = "[^"]*)', rb"\1+" + suffix, data)
    if name == "Cargo.lock":
        return re.sub(rb'(name = "imrs(?:-\w+)?"\nversion = "[^"]*)', rb"\1+" + suffix, data)
    return data


class Copy:
    """A copy of the tree below the build folder. It stays there, so that what was built of it stays of use."""

    def __init__(self, name):
        self.name = name
        self.folder = TARGET / "copies" / name

    def fill(self, changed):
        """Makes it the tree, but for these files: their names and texts. Writes only what differs."""
        texts = {name: renamed(name, (ROOT / name).read_bytes(), self.name.encode()) for name in tracked()}
        texts |= {name: text.encode() for name, text in changed.items()}
        for path in self.folder.rglob("*"):
            if path.is_file() and str(path.relative_to(self.folder)) not in texts:
                path.unlink()
        for name, data in texts.items():
            path = self.folder / name
            if not path.exists() or path.read_bytes() != data:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data)

    def cargo(self, *what):
        env = dict(os.environ, CARGO_TARGET_DIR=str(TARGET), CARGO_TERM_COLOR="never")
        return subprocess.run(["cargo", what[0], "--locked", "-q", *what[1:]], cwd=self.folder, env=env, capture_output=True, text=True)


def limited(command, cwd, cpu, seconds, memory=6 * 10**9, **env):
    """The exit code and the output of a command; the code is None where the time ended first. A process of it may use
    `cpu` seconds and so much memory."""
    env = dict(os.environ, CARGO_TARGET_DIR=str(TARGET), CARGO_TERM_COLOR="never", RUST_BACKTRACE="0",
               PROPTEST_MAX_SHRINK_ITERS="0", **env)
    child = subprocess.Popen(["prlimit", f"--cpu={cpu}", f"--as={memory}", *command], cwd=cwd, env=env,
                             stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True)
    try:
        output, _ = child.communicate(timeout=seconds)
        return child.returncode, output
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, 9)
        output, _ = child.communicate()
        return None, output
