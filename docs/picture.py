#!/usr/bin/env python3
"""Makes the pictures of the monitor from a real run of src/demo/assembly.cell: a cell under load that loses packets and a node.
The terminal is a tmux, and each screen becomes an SVG. The runs, of which one is of a cell of twelve nodes, take two minutes.

Usage: docs/picture.py [path of the imrs command; default target/debug/imrs]
"""

import html
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
IMRS = sys.argv[1] if len(sys.argv) > 1 else str(HERE.parent / "target/debug/imrs")
WIDTH, CELL_W, CELL_H = 120, 8.4, 18
INK, PAPER = "#d8dee9", "#16181d"
BASE = ["#3b4048", "#e06c75", "#98c379", "#e5c07b", "#61afef", "#c678dd", "#56b6c2", "#abb2bf",
        "#6b7280", "#ff7b86", "#b5e890", "#ffd68a", "#82c7ff", "#e29bf5", "#7fdbe6", "#ffffff"]


def indexed(n):
    """One of the 256 colours of a terminal."""
    if n < 16:
        return BASE[n]
    if n >= 232:
        grey = 8 + 10 * (n - 232)
        return f"#{grey:02x}{grey:02x}{grey:02x}"
    levels = [0, 95, 135, 175, 215, 255]
    n -= 16
    return "#%02x%02x%02x" % (levels[n // 36], levels[n // 6 % 6], levels[n % 6])


class Style:
    """What the escapes so far ask for."""

    def __init__(self):
        self.reset()

    def reset(self):
        self.ink = self.paper = None
        self.bold = self.dim = self.underline = self.reverse = False

    def apply(self, codes):
        codes = [int(c or 0) for c in codes.split(";")]
        while codes:
            c = codes.pop(0)
            if c == 0:
                self.reset()
            elif c == 1:
                self.bold = True
            elif c == 2:
                self.dim = True
            elif c == 4:
                self.underline = True
            elif c == 7:
                self.reverse = True
            elif c == 22:
                self.bold = self.dim = False
            elif c == 24:
                self.underline = False
            elif c == 27:
                self.reverse = False
            elif c in (38, 48):
                kind = codes.pop(0)
                colour = indexed(codes.pop(0)) if kind == 5 else "#%02x%02x%02x" % tuple(codes.pop(0) for _ in range(3))
                if c == 38:
                    self.ink = colour
                else:
                    self.paper = colour
            elif c == 39:
                self.ink = None
            elif c == 49:
                self.paper = None
            elif 30 <= c <= 37:
                self.ink = BASE[c - 30]
            elif 90 <= c <= 97:
                self.ink = BASE[c - 82]
            elif 40 <= c <= 47:
                self.paper = BASE[c - 40]
            elif 100 <= c <= 107:
                self.paper = BASE[c - 92]

    def colours(self):
        ink, paper = self.ink or INK, self.paper
        return (paper or PAPER, ink) if self.reverse else (ink, paper)


def pieces(line, style):
    """The pieces of a line that have one look: where each begins, how wide it is, its text, its colours and the rest of its look."""
    column = 0
    for part in re.split(r"(\x1b\[[0-9;]*m)", line):
        escape = re.fullmatch(r"\x1b\[([0-9;]*)m", part)
        if escape:
            style.apply(escape.group(1))
        elif part:
            extra = ' font-weight="bold"' if style.bold else ""
            extra += ' opacity="0.6"' if style.dim else ""
            extra += ' text-decoration="underline"' if style.underline else ""
            yield 12 + column * CELL_W, len(part) * CELL_W, part, *style.colours(), extra
            column += len(part)


def svg(screen, title):
    """A screen with its escapes as a picture."""
    lines = screen.rstrip("\n").split("\n")
    while lines and not re.sub(r"\x1b\[[0-9;]*m", "", lines[-1]).strip():
        lines.pop()
    width, height = WIDTH * CELL_W + 24, len(lines) * CELL_H + 24
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
           f'viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{html.escape(title)}">',
           f"<title>{html.escape(title)}</title>",
           f'<rect width="100%" height="100%" rx="8" fill="{PAPER}"/>',
           '<g font-family="ui-monospace,SFMono-Regular,Menlo,DejaVu Sans Mono,monospace" font-size="14" '
           'xml:space="preserve">']
    style = Style()
    for row, line in enumerate(lines):
        y = 12 + row * CELL_H
        for x, width, part, ink, paper, extra in pieces(line, style):
            if paper:
                out.append(f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{CELL_H}" fill="{paper}"/>')
            # Texts between gaps have places of their own: not every renderer keeps spaces.
            for text in re.finditer(r"\S+(?: \S+)*", part):
                at, length = x + text.start() * CELL_W, len(text.group()) * CELL_W
                out.append(f'<text x="{at:.1f}" y="{y + 13.5:.1f}" textLength="{length:.1f}" fill="{ink}"{extra}>{html.escape(text.group())}</text>')
    return "\n".join(out + ["</g>", "</svg>", ""])


class Screen:
    """A tmux of its own as the terminal."""

    def __init__(self, rows):
        self.server = f"imrs-picture-{os.getpid()}"
        self.tmux("new-session", "-d", "-x", str(WIDTH), "-y", str(rows), "sh")
        self.tmux("set", "-g", "default-terminal", "tmux-256color")

    def tmux(self, *args):
        command = ["tmux", "-L", self.server, "-f", "/dev/null", *args]
        env = {**os.environ, "LC_ALL": "C.UTF-8"}
        return subprocess.run(command, env=env, check=True, capture_output=True, text=True, timeout=10).stdout

    def wait_for(self, *texts):
        end = time.monotonic() + 40
        while time.monotonic() < end:
            shown = self.tmux("capture-pane", "-p")
            if all(t in shown for t in texts):
                return
            time.sleep(0.05)
        sys.exit(f"waited in vain for {texts}:\n{shown}")

    def save(self, name, title, showing=""):
        """Saves the first screen that shows this pattern, or of which this function says that it does."""
        does = showing if callable(showing) else lambda shown: re.search(showing, shown)
        for _ in range(600):
            shown = self.tmux("capture-pane", "-p", "-e", "-N")
            # A terminal that draws half a frame shows another one a moment later.
            time.sleep(0.015)
            if does(shown) and shown == self.tmux("capture-pane", "-p", "-e", "-N"):
                (HERE / name).write_text(svg(shown, title))
                return print("made", HERE / name)
            time.sleep(0.05)
        sys.exit(f"never showed {showing}:\n{shown}")


CELL = str(HERE.parent / "src/demo/assembly.cell")
# Before that the pictures of the living cell are made, with time to spare.
KILLED_AT = 30


def large():
    """The text of a cell of twelve nodes with 108 ports: three rings of four tasks, in which each reports to the one before it."""
    nodes, ports = range(1, 13), "abcdefghi"
    after = lambda n: n + 1 if n % 4 else n - 3
    before = lambda n: n - 1 if n % 4 != 1 else n + 3
    text = ["cell line;", "tick 1 msec;", *(f"node n{n};" for n in nodes)]
    text += [f"link n{n} -- n{after(n)} delay 2 msec;" for n in nodes]
    for n in nodes:
        text += [f"task t{n} on n{n}"]
        text += [f"  port p{n}{p}(v: int16) usage = receive user_list = {{t{after(n)}}} time_out = 900 msec class = 1 bounded_buffer[4];"
                 for p in ports]
        text += [f"  use_port p{before(n)}{p}(v: int16) usage = send;" for p in ports]
        text += ["  var v: int16;", "begin", "  loop", "    run work takes 40..120 msec;"]
        text += [f"    use_send p{before(n)}{p}(v);" for p in ports]
        text += [f"    receive p{n}{p}(v);" for p in ports]
        text += ["  end;", f"end t{n};"]
    return "\n".join(text) + "\n"


class Watched:
    """A cell, and a monitor that watches it in a terminal. Another monitor records what it sees."""

    def __init__(self, cell, task, *faults):
        self.folder = tempfile.mkdtemp(prefix="imrs-picture")
        self.env = {**os.environ, "XDG_RUNTIME_DIR": self.folder, "XDG_STATE_HOME": self.folder}
        record = ["--record", os.path.join(self.folder, "run.imrs")]
        command = [IMRS, "run", cell, "--for", "120s", "--seed", "3", *faults, *record]
        self.nodes = subprocess.Popen(command, env=self.env, stdout=subprocess.DEVNULL)
        self.screen = Screen(30)
        time.sleep(1)
        self.seen = os.path.join(self.folder, "seen.imrs")
        command = [IMRS, "monitor", "--record", self.seen, "--for", f"{KILLED_AT + 5}s"]
        self.recorder = subprocess.Popen(command, env=self.env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.monitor(f"--judge {cell}", "NODE/TASK/PORT", task)

    def monitor(self, options, *texts):
        """Starts a monitor in the terminal, and waits until it shows these texts."""
        environment = f"TERM=tmux-256color XDG_RUNTIME_DIR={self.folder} XDG_STATE_HOME={self.folder} LC_ALL=C.UTF-8"
        self.type(f"clear; {environment} {IMRS} monitor {options}", "Enter")
        self.screen.wait_for(*texts)

    def type(self, *keys):
        self.screen.tmux("send-keys", *keys)

    def leave(self):
        self.nodes.send_signal(signal.SIGINT)
        self.nodes.wait(timeout=20)
        self.recorder.wait(timeout=60)
        self.screen.tmux("kill-server")
        shutil.rmtree(self.folder)


def alive(cell):
    """While all nodes are alive. The pattern of each picture says what it must show."""
    screen = cell.screen
    # Rejected questions, parts that expired, a queue that is neither empty nor full, and a meeting.
    screen.save("monitor-overview.svg", "The overview: ports with messages, what expired and what was rejected",
                r"(?s) part +\x1b[^\n]*[3-7]/8 .* grab [^\n]*[12]/2 .*waitfor lift r\d")
    for _ in range(4):
        cell.type("Tab")
    screen.save("monitor-title.svg", "A selected title: the bottom line says what the column shows", r"SLACK: remaining time")
    cell.type("Escape")
    cell.type(":")
    cell.type("port pr")
    screen.save("monitor-typed.svg", "A typed line: Tab completes it to one of the names behind it", r"port pr.*Tab: ")
    cell.type("ess.part", "Enter")
    screen.save("monitor-port.svg", "A port's queue in the order of service: which messages will likely expire before they are served",
                r"(?s)(.*MISS likely){3}")
    cell.type("5")
    screen.save("monitor-timers.svg", "What runs out when: a wait for an answer, a meeting, a timer of a task",
                r"(?s)(?=.*the answer to )(?=.*its handler begins)")
    one_life(cell)
    cell.type("4")
    screen.save("monitor-timeline.svg", "What happened in each task, side by side: a request times out, another is rejected and asked again",
                is_in_step)


def dead(cell):
    """After the hoist's node was killed."""
    screen = cell.screen
    cell.type("6")
    screen.save("monitor-events.svg", "What happened: messages that expired, requests that timed out, a node that died",
                r"(?s)(?=.*mdead\x1b)")
    cell.type("3")
    screen.wait_for("can never arrive", "GATHERING 2/3")
    screen.save("monitor-rendezvous.svg", "The rendezvous after the hoist's node was killed: both arms wait for it")
    cell.type("1")
    screen.save("monitor-dead.svg", "The overview after a node was killed: its last state is kept, and who waits for it is named",
                r"(?s)BLOCKED BY hoist@nh - DEAD.*waitfor lift.*waitfor lift")
    cell.type("8")
    screen.save("monitor-problems.svg", "The problems of all nodes: the dead node above what waits for it, then the nearest deadlines",
                r"(?s)\A(?!.*waitfor lift r\d).*BLOCKED BY hoist@nh - DEAD.*PROBLEM.*part")
    cell.type("x")
    screen.save("monitor-code.svg", "What a finding means, when it is raised and ends, and what to do", r"What to do")
    cell.type("Escape")
    cell.type("7")
    screen.save("monitor-model.svg", "Whether the nodes do what the verified model does", r"transition kinds seen")
    cell.type("?")
    screen.save("monitor-help.svg", "The help, made from the table of keys", r"KEYS EVERYWHERE")
    cell.type("1")
    cell.type("o")
    screen.save("monitor-settings.svg", "The window of the settings", r"settings: Enter changes")
    cell.type("Escape")
    cell.type("Space")
    cell.type("{")
    for _ in range(60):
        cell.type("[")
    screen.save("monitor-paused.svg", "A pause, some steps before it: the bar shows where something went wrong, and the moment that is shown",
                r"(?s)PAUSED -.*\[ \] step")
    cell.type("Space")


def replayed(cell):
    """What the other monitor recorded."""
    cell.recorder.wait(timeout=60)
    cell.type("q")
    time.sleep(1)
    cell.monitor(f"--replay {cell.seen} --at -20s", "REPLAY")
    cell.type("}")
    cell.screen.save("monitor-replay.svg", "A recording, at a place where something went wrong", r"(?s)REPLAY.*\[ \] step")


def of_twelve_nodes():
    """The overview of a large cell: what is in trouble, and one row for the rest."""
    with tempfile.NamedTemporaryFile("w", suffix=".cell") as file:
        file.write(large())
        file.flush()
        cell = Watched(file.name, "n12", "--kill", "n4@12s")
        try:
            cell.screen.wait_for("DEAD", " 8 nodes")
            cell.type("G")
            cell.type("l")
            cell.screen.save("monitor-large.svg", "A cell of twelve nodes with 108 ports: what is in trouble, and one row for the other nodes, opened",
                             r"(?s)DEAD [2-9]s.* 8 nodes.*n12 ")
        finally:
            cell.leave()


def one_life(cell):
    """The history of a query that the press rejected more than once."""
    cell.type(":")
    cell.type("port press.grab", "Enter")
    cell.screen.wait_for("grab at press", "arm")
    told = r"(?s)CHARGED.*rejected.*rejected.*delivered.*replied.*answered(?!.*now it waits)"
    for _ in range(400):
        # Its row says how often it was rejected, behind the bar of its remaining time.
        if re.search(r"arm[LR] .*\] +[1-9] ", cell.screen.tmux("capture-pane", "-p")):
            cell.type("Enter")
            # The message may be gone, or may have been answered at once.
            time.sleep(1.2)
            if re.search(told, cell.screen.tmux("capture-pane", "-p")):
                break
            cell.type("Escape")
        time.sleep(0.05)
    cell.screen.save("monitor-message.svg", "The history of one message: where it was, how often it was rejected, what each step cost", told)


def is_in_step(shown):
    """Whether the lanes are at the same time, and show what the title says."""
    times = re.findall(r"\d:\d\d\.\d{3}", shown)
    return len(set(times)) > 9 and all(re.search(what, shown) for what in (r"#\d+ timed out", "rejected", "again"))


def main():
    cell = Watched(CELL, "vision", "--loss", "8%", "--kill", f"nh@{KILLED_AT}s")
    try:
        time.sleep(3)
        alive(cell)
        cell.type("1")
        cell.screen.wait_for("DEAD ")
        dead(cell)
        replayed(cell)
    finally:
        cell.leave()
    of_twelve_nodes()


if __name__ == "__main__":
    main()
