#!/usr/bin/env python3
"""Makes the pictures of the monitor from a real run: a demo, a tmux as the terminal, its screen as SVG.

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
        column = 0
        for part in re.split(r"(\x1b\[[0-9;]*m)", line):
            escape = re.fullmatch(r"\x1b\[([0-9;]*)m", part)
            if escape:
                style.apply(escape.group(1))
                continue
            if not part:
                continue
            ink, paper = style.colours()
            x, y = 12 + column * CELL_W, 12 + row * CELL_H
            if paper:
                out.append(f'<rect x="{x:.1f}" y="{y:.1f}" width="{len(part) * CELL_W:.1f}" height="{CELL_H}" fill="{paper}"/>')
            if part.strip():
                extra = ' font-weight="bold"' if style.bold else ""
                extra += ' opacity="0.6"' if style.dim else ""
                extra += ' text-decoration="underline"' if style.underline else ""
                out.append(f'<text x="{x:.1f}" y="{y + 13.5:.1f}" textLength="{len(part) * CELL_W:.1f}" fill="{ink}"{extra}>{html.escape(part)}</text>')
            column += len(part)
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
        end = time.monotonic() + 20
        while time.monotonic() < end:
            shown = self.tmux("capture-pane", "-p")
            if all(t in shown for t in texts):
                return
            time.sleep(0.05)
        sys.exit(f"waited in vain for {texts}:\n{shown}")

    def save(self, name, title, showing=""):
        """Saves the first screen that shows this pattern."""
        for _ in range(200):
            shown = self.tmux("capture-pane", "-p", "-e")
            if re.search(showing, shown):
                (HERE / name).write_text(svg(shown, title))
                return print("made", HERE / name)
            time.sleep(0.05)
        sys.exit(f"never showed {showing}:\n{shown}")


VIEWS = [
    ("2", "port", "A port's queue in the order of service", r"fill:"),
    ("4", "timeline", "What happened in each task, side by side", r"each event|a row"),
    ("5", "timers", "What runs out when", r"OWNER"),
    ("6", "events", "What happened", r"DETAIL"),
    ("7", "model", "Whether the nodes do what the verified model does", r"transition kinds seen"),
    ("?", "help", "The help, made from the table of keys", r"KEYS EVERYWHERE"),
]


def watch(name, *args):
    """A monitor on a terminal of its own, while a demo runs."""
    folder = tempfile.mkdtemp(prefix="imrs-picture")
    env = {**os.environ, "XDG_RUNTIME_DIR": folder}
    command = [IMRS, "demo", name, "--for", "60s", "--record", os.path.join(folder, "run.imrs"), *args]
    demo = subprocess.Popen(command, env=env, stdout=subprocess.DEVNULL)
    screen = Screen(30)
    time.sleep(1)
    screen.tmux("send-keys", f"clear; TERM=tmux-256color XDG_RUNTIME_DIR={folder} LC_ALL=C.UTF-8 exec {IMRS} monitor", "Enter")
    screen.wait_for("NODE/TASK/PORT")
    return folder, demo, screen


def leave(folder, demo, screen):
    demo.send_signal(signal.SIGINT)
    demo.wait(timeout=20)
    screen.tmux("kill-server")
    shutil.rmtree(folder)


def weld():
    running = watch("failover-weld", "--kill", "n1@7s")
    screen = running[2]
    try:
        screen.wait_for("dresser", "r1", "r2")
        time.sleep(2)
        screen.save("monitor-overview.svg", "The overview: nodes, tasks and ports of the weld cell while it runs")
        screen.wait_for("DEAD")
        time.sleep(1)
        screen.save("monitor-dead.svg", "The overview after a robot's node was killed: its last state is kept, the standby welds on")
        for key, name, title, showing in VIEWS:
            screen.tmux("send-keys", key)
            screen.save(f"monitor-{name}.svg", title, showing)
        screen.tmux("send-keys", "Escape")
        screen.tmux("send-keys", "4")
        screen.wait_for("TIME")
        for _ in range(60):
            screen.tmux("send-keys", "k")
            screen.tmux("send-keys", "Enter")
            time.sleep(0.1)
            if "CHARGED" in screen.tmux("capture-pane", "-p"):
                break
        screen.save("monitor-message.svg", "The life of one message, hop by hop", r"CHARGED")
    finally:
        leave(*running)


def lift():
    running = watch("beam-lift", "--loss", "5%", "--kill", "hoist@3s")
    screen = running[2]
    try:
        screen.wait_for("DEAD")
        screen.tmux("send-keys", "3")
        screen.wait_for("DEAD", "lift")
        screen.save("monitor-rendezvous.svg", "The rendezvous after the hoist's node was killed: both arms wait for it",
                    r"1\.\d\ds left|\d\d\dms left")
    finally:
        leave(*running)


weld()
lift()
