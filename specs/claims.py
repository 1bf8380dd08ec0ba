#!/usr/bin/env python3
"""Brings the numbers and charts of claims.md up to date; the prose around them stays as it is.

    cargo run -- verify --format json | python3 specs/claims.py
    cargo run --release -- verify --full --format json | python3 specs/claims.py --full

The first rewrites what stands between `<!-- NAME -->` and `<!-- end -->`, where NAME is a claim's name, or `run`. The second writes
claims-full.md: every verdict at the large bounds, with states and time.
"""

import datetime
import json
import pathlib
import re
import sys

PAGE = pathlib.Path(__file__).with_name("claims.md")
FULL = pathlib.Path(__file__).with_name("claims-full.md")
MESSAGES = {
    "no-stale-delivery", "class-2-resolves", "at-most-once", "no-global-clock", "nothing-waits-for-ever",
    "query-order", "penalty-is-fair", "eviction", "one-active",
    "fenced-orders",
}
LONGEST_CHART = 16
# Of the table of confirmation rules, the charts that differ.
CHARTS_UNDER_LOSS = {("no-confirmation", 2), ("every-complete", 2), ("first-complete", 3)}


def number(value):
    return f"{value:,}"


def bounds(verdict):
    b = verdict["bounds"]
    parts = [f"{b[key]} {word}" for key, word in (("loss", "lost"), ("dup", "doubled"), ("crash", "crash")) if b[key]]
    parts = ["any number lost" if part == "255 lost" else part for part in parts]
    parts.append("no time, any order" if b["delay"] is None else f"delay {b['delay']}")
    what = "send" if verdict["name"] in MESSAGES else "attempt"
    times = b["rounds"]
    parts.append("endless" if times is None else f"{times} {what}{'s' if times > 1 else ''}")
    parts += [f"{key} {b[key]}" for key in ("time_out", "resend") if b[key] is not None]
    if b["margin"] is not None and b["time_out"] is not None:
        parts.append(f"margin {b['margin']}")
    return ", ".join(parts)


def table(head, rows):
    lines = [head, ["---"] * len(head)] + rows
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def verdicts(name, mine):
    if name == "rendezvous-under-loss":
        head = ["rule", "members", "least losses, sent once", "least losses, with re-sending", "states"]
        found = lambda v, key: "not searched" if v["found"][key] is None else v["found"][key]
        once, again = "least_losses_to_strand", "least_losses_with_resending"
        rows = [[v["rule"], v["parties"], found(v, once), found(v, again), number(v["states"])] for v in mine]
        return table(head, rows)
    head = ["rule", "tasks" if name in MESSAGES else "members", "outcome", "bounds", "states", "transitions", "depth"]
    extra = {
        "all-or-none": [("least margin", "least_safe_margin"), ("closed form", "closed_form_margin")],
        "one-active": [("least margin", "least_safe_margin"), ("closed form", "closed_form_margin")],
        "penalty-is-fair": [("least K", "least_bound_ticks"), ("closed form", "bound_ticks")],
        "they-meet-again": [("k", "attempts")],
    }.get(name, [])
    rows = []
    for v in mine:
        row = [v["rule"], v["parties"], v["outcome"], bounds(v), number(v["states"]), number(v["transitions"]), v["depth"]]
        rows.append(row + ["" if v["found"][key] is None else v["found"][key] for _, key in extra])
    return table(head + [word for word, _ in extra], rows)


def charts(name, mine):
    shown, seen = [], set()
    for v in mine:
        found = v["counterexample"]
        if not found or v["rule"] in seen or len(found["chart"].splitlines()) > LONGEST_CHART:
            continue
        if name == "rendezvous-under-loss" and (v["rule"], v["parties"]) not in CHARTS_UNDER_LOSS:
            continue
        seen.add(v["rule"])
        what = "tasks" if name in MESSAGES else "members"
        about = "" if v["about"] == mine[0]["about"] else f" {v['about'][0].upper()}{v['about'][1:]}."
        title = f"Under the rule `{v['rule']}` this claim fails with {v['parties']} {what}. The chart shows a shortest run that breaks it, of {found['length']} steps.{about}"
        shown.append(f"{title}\n\n```text\n{found['chart'].rstrip()}\n```")
    return shown


def run(claims):
    states = number(sum(v["states"] for v in claims))
    collision = max(v["collision_probability"] for v in claims)
    wrong = sum(not v["as_expected"] for v in claims)
    word = "all as expected" if wrong == 0 else f"{wrong} NOT as expected"
    return (
        f"Run on {datetime.date.today().isoformat()}: {len(claims)} verdicts, {word}, {states} states. The probability that two states\n"
        f"shared their 64 bits, so that one was passed over, is at most {collision:.0e} for any of them."
    )


def full(claims):
    wrong = sum(not v["as_expected"] for v in claims)
    cut = sum(not v["complete"] for v in claims)
    page = PAGE.read_text()
    without = [name for name in re.findall(r"^## `(.*)`$", page, re.M) if name not in {v["name"] for v in claims}]
    lines = [
        "# The large bounds",
        "",
        "Written by `specs/claims.py --full`. What each claim says is in [claims.md](claims.md); seconds are of one exploration among others",
        "side by side, and depend on the machine.",
        "",
        f"Run on {datetime.date.today().isoformat()}: {len(claims)} verdicts, {wrong} not as expected, {cut} not complete,",
        f"{number(sum(v['states'] for v in claims))} states, {sum(v['seconds'] for v in claims):.0f} s of one core.",
        "",
    ]
    if without:
        lines += [f"Not in this run: {', '.join(f'`{name}`' for name in without)}.", ""]
    head = ["claim", "rule", "tasks", "outcome", "as expected", "bounds", "found", "states", "bytes", "seconds"]
    found = lambda v: ", ".join(f"{k.replace('_', ' ')} {x}" for k, x in v["found"].items() if x is not None)
    rows = [
        [v["name"], v["rule"], v["parties"], v["outcome"], "yes" if v["as_expected"] else "NO", bounds(v), found(v),
         number(v["states"]), v["longest_state"], f"{v['seconds']:.1f}"]
        for v in claims
    ]
    return "\n".join(lines) + "\n" + table(head, rows) + "\n"


def main():
    claims = json.load(sys.stdin)["claims"]
    if "--full" in sys.argv:
        return FULL.write_text(full(claims))
    page = PAGE.read_text()
    blocks = {"run": run(claims)}
    for name in dict.fromkeys(v["name"] for v in claims):
        mine = [v for v in claims if v["name"] == name]
        blocks[name] = "\n\n".join([verdicts(name, mine)] + charts(name, mine))
    for name, block in blocks.items():
        pattern = re.compile(rf"(<!-- {re.escape(name)} -->\n).*?(<!-- end -->)", re.S)
        page, times = pattern.subn(lambda m: f"{m[1]}\n{block}\n\n{m[2]}", page)
        if times != 1:
            sys.exit(f"claims.md has {times} places for `{name}`, and must have one")
    PAGE.write_text(page)


main()
