"""Draws the entries of a cold reading from a commit: `.ci/read_cold.py COMMIT [NUMBER_OF_COMMENTS NUMBER_OF_PARAGRAPHS]`.
The entries are those with the smallest SHA-256 of commit, path and line. A comment comes with the code below it, a
paragraph with the document's title and the headings above it, because a person who reads has both before the eyes."""
import hashlib, re, subprocess, sys

PAGES = re.compile(r"(README|ARCHITECTURE|CONTRIBUTING|SECURITY|docs/.+|specs/.+)\.md")
GENERATED = re.compile(r"specs/(results/.+|claims-full\.md)")
NO_PROSE = ("|", "```", "<!--", "    ")  # A table, code, a mark.
CODE_LINES = 3
SHORTEST = 60  # Letters of a paragraph. A shorter one leads to a table, a list or code.


def git(*command):
    return subprocess.run(["git", *command], check=True, capture_output=True, text=True).stdout


def comments(lines):
    """Each comment that fills lines of its own: its line, its text and the code that it stands above."""
    is_comment = [bool(re.match(r"\s*//[/!]?( |$)", line)) for line in lines]
    for first, line in enumerate(lines):
        if not is_comment[first] or (first and is_comment[first - 1]):
            continue
        end = next((at for at in range(first, len(lines)) if not is_comment[at]), len(lines))
        code = [line for line in lines[end:end + 8] if not re.match(r"\s*(#\[.*|)$", line)][:CODE_LINES]
        yield first + 1, lines[first:end] + code


def paragraphs(lines):
    """Each block of prose between blank lines: its line, and its text below the headings that it stands under."""
    headings, fenced, block = {}, False, []
    for number, line in enumerate(lines + [""], 1):
        if line.startswith("```") or fenced == "-->" and line.startswith("-->"):
            fenced = not fenced
        elif line.startswith("<!--") and "-->" not in line:
            fenced = "-->"
        heading = not fenced and re.match(r"(#+) ", line)
        if heading:
            depth = len(heading[1])
            headings = {at: text for at, text in headings.items() if at < depth} | {depth: line}
        elif line.strip() and not fenced and not line.startswith(("|", "```", "<!--") if block else NO_PROSE):
            block.append(line)
            continue
        if len(" ".join(block)) >= SHORTEST:
            yield number - len(block), [*headings.values(), *block]
        block = []


def sample(commit, names, split, count):
    """The `count` entries with the smallest digest, in its order: path, line and text."""
    found = []
    for name in names:
        for line, text in split(git("show", f"{commit}:{name}").splitlines()):
            found.append((hashlib.sha256(f"{commit} {name} {line}".encode()).hexdigest(), name, line, text))
    return [entry[1:] for entry in sorted(found)[:count]]


commit = git("rev-parse", sys.argv[1]).strip()
counts = [int(number) for number in sys.argv[2:]] or [100, 50]
files = git("ls-tree", "-r", "--name-only", commit).splitlines()
sources = [name for name in files if name.endswith(".rs")]
pages = [name for name in files if PAGES.fullmatch(name) and not GENERATED.match(name)]
print(f"Drawn from {commit}")
for kind, names, split, count in (("C", sources, comments, counts[0]), ("P", pages, paragraphs, counts[1])):
    for index, (name, line, text) in enumerate(sample(commit, names, split, count), 1):
        print("", f"{kind}{index} {name}:{line}", *text, sep="\n")
