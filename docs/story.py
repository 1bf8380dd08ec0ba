#!/usr/bin/env python3
"""Makes the moving picture of the README from a real terminal: docs/story.cell is checked, mended, checked again and run; a node is killed,
and the monitor names it. The terminal is a tmux; each screen that differs from the one before becomes a frame of one animated SVG.

Usage: docs/story.py [path of the imrs command; default target/debug/imrs]
"""

import html
import os
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

import picture
from picture import CELL_H, CELL_W, INK, PAPER, Screen, Style, pieces

HERE = Path(__file__).resolve().parent
IMRS = Path(sys.argv[1] if len(sys.argv) > 1 else HERE.parent / "target/debug/imrs").resolve()
COLUMNS, ROWS = 100, 26
# Nobody reads faster, and typing is not waited for.
LEAST, MOST = 0.06, 5.0


def spans(line, style):
    """A line of a screen as SVG, at the height 0."""
    out = []
    for x, width, part, ink, paper, extra in pieces(line, style):
        if paper:
            out.append(f'<rect x="{x:.1f}" width="{width:.1f}" height="{CELL_H}" fill="{paper}"/>')
        if part.strip():
            fill = "" if ink == INK else f' fill="{ink}"'
            out.append(f'<text x="{x:.1f}" y="13.5" textLength="{width:.1f}"{fill}{extra}>{html.escape(part)}</text>')
    return "".join(out)


def animated(frames, title):
    """Frames, each a screen and how long it stands, as one SVG. A line that stands in several frames is written once."""
    lines, bodies, rules = {}, [], []
    total = sum(length for _, length in frames)
    passed = 0.0
    for number, (screen, length) in enumerate(frames):
        style, body = Style(), []
        for row, line in enumerate(screen.split("\n")[:ROWS]):
            text = spans(line.rstrip(), style)
            if text:
                at = lines.setdefault(text, len(lines))
                body.append(f'<use href="#l{at}" y="{12 + row * CELL_H}"/>')
        bodies.append(f'<g class="f" style="animation-name:k{number}">{"".join(body)}</g>')
        begin, end = 100 * passed / total, 100 * (passed + length) / total
        first = "visible" if number == 0 else "hidden"
        rules.append(f"@keyframes k{number}{{0%{{visibility:{first}}}{begin:.3f}%{{visibility:visible}}{end:.3f}%{{visibility:hidden}}}}")
        passed += length
    width, height = COLUMNS * CELL_W + 24, ROWS * CELL_H + 24
    defs = "".join(f'<g id="l{at}">{text}</g>' for text, at in lines.items())
    style = f".f{{visibility:hidden;animation:{total:.2f}s step-end infinite}}.f:first-of-type{{visibility:visible}}" + "".join(rules)
    return "\n".join([
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" viewBox="0 0 {width:.0f} {height:.0f}" '
        f'role="img" aria-label="{html.escape(title)}">',
        f"<title>{html.escape(title)}</title>", f"<style>{style}</style>",
        f'<rect width="100%" height="100%" rx="8" fill="{PAPER}"/>',
        '<g font-family="ui-monospace,SFMono-Regular,Menlo,DejaVu Sans Mono,monospace" font-size="14" '
        f'fill="{INK}" xml:space="preserve"><defs>{defs}</defs>', *bodies, "</g></svg>", ""])


class Film:
    """What a terminal shows, from moment to moment."""

    def __init__(self, screen):
        self.screen, self.frames, self.last = screen, [], None

    def look(self, seconds):
        """Looks for so long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.take()
            time.sleep(0.05)

    def take(self):
        shown, now = self.screen.tmux("capture-pane", "-p", "-e"), time.monotonic()
        if self.last is None or shown != self.last[0]:
            if self.last is not None:
                self.frames.append((self.last[0], min(max(now - self.last[1], LEAST), MOST)))
            self.last = (shown, now)

    def until(self, pattern, seconds=90):
        """Looks until the screen shows this."""
        end = time.monotonic() + seconds
        while not re.search(pattern, self.screen.tmux("capture-pane", "-p")):
            self.take()
            if time.monotonic() > end:
                sys.exit(f"waited in vain for {pattern}:\n{self.screen.tmux('capture-pane', '-p')}")
            time.sleep(0.05)
        self.take()

    def type(self, text):
        """Types a line as a person would, and enters it."""
        for begin in range(0, len(text), 3):
            self.screen.tmux("send-keys", "-l", "--", text[begin:begin + 3])
            self.look(0.05)
        self.look(0.3)
        self.screen.tmux("send-keys", "Enter")


def main():
    picture.WIDTH = COLUMNS
    folder = Path(tempfile.mkdtemp(prefix="imrs-story"))
    (folder / "bin").mkdir()
    (folder / "bin/imrs").symlink_to(IMRS)
    text = (HERE / "story.cell").read_text()
    (folder / "lift.cell").write_text(text)
    screen = Screen(ROWS)
    film = Film(screen)
    try:
        screen.tmux("send-keys", f"export PS1='$ ' TERM=tmux-256color LC_ALL=C.UTF-8 XDG_RUNTIME_DIR={folder} "
                    f"XDG_STATE_HOME={folder} PATH={folder}/bin:$PATH; cd {folder}; clear", "Enter")
        time.sleep(1)
        film.type("imrs verify lift.cell | head -15")
        film.until(r"help: let the others")
        film.look(4)
        film.type("sed -i 's/time_out = 2 sec/time_out = 5 sec/' lift.cell")
        film.look(0.5)
        film.type("imrs verify lift.cell | tail -1")
        film.until(r"nothing found")
        film.look(2.5)
        film.type("imrs run lift.cell --kill hoist@8s --for 40s > run.txt 2>&1 &")
        film.look(1)
        film.type("imrs monitor")
        film.until(r"NODE/TASK/PORT")
        film.look(2)
        screen.tmux("send-keys", "3")
        film.until(r"can never arrive")
        film.look(4)
    finally:
        # The nodes of the cell end with it, and would otherwise outlive the terminal.
        for keys in (["C-c"], ["kill %1", "Enter"]):
            screen.tmux("send-keys", *keys)
            time.sleep(1)
        screen.tmux("kill-server")
        shutil.rmtree(folder, ignore_errors=True)
    film.frames.append((film.last[0], MOST))
    (HERE / "story.svg").write_text(animated(film.frames, "A cell is checked, mended, checked again and run; a node dies, and the monitor names it"))
    print("made", HERE / "story.svg", len(film.frames), "frames", sum(length for _, length in film.frames), "s")


main()
