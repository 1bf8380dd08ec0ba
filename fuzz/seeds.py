#!/usr/bin/env python3
"""Packs kept inputs of a fuzz target into a text, and unpacks them for cargo-fuzz.

`seeds/TARGET.txt` holds one input a line: its name, a tab, its bytes in hex. The inputs of `cell` are the cell files of
language/tests, so that target has no text of its own.

    fuzz/seeds.py unpack TARGET FOLDER          writes each input into a file of FOLDER
    fuzz/seeds.py pack TARGET FOLDER            keeps the files of FOLDER, and no others
    fuzz/seeds.py add TARGET NAME FILE          keeps FILE, too, under NAME
"""
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def kept(target):
    """The kept inputs of a target by name."""
    if target == "cell":
        files = [*ROOT.glob("language/tests/cells/*.cell"), *ROOT.glob("language/tests/faulty/*.cell")]
        return {f"{file.parent.name}_{file.stem}": file.read_bytes() for file in files}
    lines = (ROOT / f"fuzz/seeds/{target}.txt").read_text().splitlines()
    return {name: bytes.fromhex(digits) for name, digits in (line.split("\t") for line in lines)}


def keep(target, inputs):
    lines = [f"{name}\t{data.hex()}\n" for name, data in sorted(inputs.items())]
    (ROOT / f"fuzz/seeds/{target}.txt").write_text("".join(lines))


def main(what="", target="", *rest):
    if (what, len(rest)) == ("unpack", 1):
        folder = Path(rest[0])
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in kept(target).items():
            (folder / name).write_bytes(data)
    elif target == "cell":
        sys.exit("the inputs of cell are the cell files of language/tests: add one there")
    elif (what, len(rest)) == ("pack", 1):
        keep(target, {file.name: file.read_bytes() for file in Path(rest[0]).iterdir()})
    elif (what, len(rest)) == ("add", 2):
        keep(target, kept(target) | {rest[0]: Path(rest[1]).read_bytes()})
    else:
        sys.exit(__doc__)


main(*sys.argv[1:])
