"""Runs the studies of measured.toml and writes docs/measured.md and the table of the README from what they print.

    python benchmarks/collect.py                 all of them: hours
    python benchmarks/collect.py --quick         those that take up to two minutes
    python benchmarks/collect.py --only paper    those whose title holds a word
    python benchmarks/collect.py --write         runs nothing, writes the documents from what was printed before

What was not run keeps what it printed before, with the commit it was printed at; a study that fails is shown as failed, with
the last line that it said of that, beside its figures.
Exit status 1 if one fails.
"""

import argparse
import ast
import datetime
import json
import os
import platform
import re
import shlex
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
TABLE, STORE = ROOT / "benchmarks" / "measured.toml", ROOT / "docs" / "measured.json"
PAGE, README = ROOT / "docs" / "measured.md", ROOT / "README.md"
QUICK_MINUTES, USUAL_MINUTES = 2, 10
# A study may take so many times its estimate: machines differ, and are busy.
PATIENCE = 10
BEGIN, END = "<!-- written by make bench -->", "<!-- end of what make bench writes -->"
# How a study says how far it is (`motorlens_runtime.progress`, and in words of its own): no figure, and no reason to fail.
PROGRESS = re.compile(r" \d+ %, \d+ s left|^\d+(/| of )\d+ |: done after \d+ s$")
Entry = dict[str, Any]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="those that take up to two minutes")
    parser.add_argument("--only", metavar="WORD", help="those whose title holds this word")
    parser.add_argument("--write", action="store_true", help="run nothing, write the documents")
    arguments = parser.parse_args()
    table = studies()
    word = (arguments.only or "").lower()
    if not any(word in study["title"].lower() for study in table["study"]):
        parser.error(f"no study of measured.toml has '{arguments.only}' in its title")
    store: dict[str, Entry] = json.loads(STORE.read_text(encoding="utf-8")) if STORE.exists() else {}
    failed = False
    for study in table["study"]:
        chosen = study["minutes"] <= QUICK_MINUTES or not arguments.quick
        chosen = chosen and word in study["title"].lower()
        if chosen and not arguments.write:
            store[study["title"]] = entry = measured(study)
            failed |= entry["status"] != 0
            STORE.write_text(json.dumps(store, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    PAGE.write_text(page(table["study"], store), encoding="utf-8")
    README.write_text(with_table(README.read_text(encoding="utf-8"), table, store), encoding="utf-8")
    return int(failed)


def studies() -> Entry:
    """The table, and a study for every benchmark that it does not name: its first line and its plain command."""
    table = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    commands = " ".join(study["command"] for study in table["study"])
    for script in sorted(TABLE.parent.glob("*.py")):
        if script.name not in commands and script != Path(__file__):
            summary = (
                ast.get_docstring(ast.parse(script.read_text(encoding="utf-8"))) or script.stem
            ).partition("\n")[0]
            command = f"python benchmarks/{script.name}"
            table["study"].append(
                {"title": summary.rstrip("."), "command": command, "minutes": USUAL_MINUTES}
            )
    return table


def measured(study: Entry) -> Entry:
    """Run one study; what it printed, and where and when."""
    print(f"collect: {study['title']}: {study['command']}", file=sys.stderr, flush=True)
    load, begun = os.getloadavg()[0], time.monotonic()
    status, out, error = 0, "", ""
    (ROOT / "out").mkdir(exist_ok=True)
    for command in study["command"].split(" && "):
        words = shlex.split(command)
        words[0] = str(Path(sys.executable).with_name(words[0]))
        try:
            done = subprocess.run(
                words, cwd=ROOT, capture_output=True, text=True, timeout=60 * PATIENCE * study["minutes"]
            )
            status, out, error = done.returncode, out + done.stdout, done.stderr
        except subprocess.TimeoutExpired:
            status, error = -1, f"not done after {PATIENCE * study['minutes']} minutes"
        if status:
            break
    keep = re.compile(study.get("keep", ""))
    lines = [line.rstrip() for line in out.splitlines() if keep.search(line)]
    said = [line.strip() for line in error.splitlines() if line.strip() and not PROGRESS.search(line)]
    return {
        "command": study["command"], "commit": commit(), "date": datetime.date.today().isoformat(), "machine": machine(),
        "load": round(load, 1), "seconds": round(time.monotonic() - begun), "status": status, "lines": lines,
        **({"error": said[-1]} if status and said else {}),
    }  # fmt: skip


def commit() -> str:
    """The commit of the checkout, with a plus if files differ from it."""
    git = ["git", "-C", str(ROOT)]
    name = subprocess.run(
        [*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True
    ).stdout.strip()
    changed = subprocess.run(
        [*git, "status", "--porcelain", "--", ".", ":!docs/measured.*", ":!README.md"],
        capture_output=True,
        text=True,
    )
    return (name or "unknown") + ("+" if changed.stdout.strip() else "")


def machine() -> str:
    """Processor, cores, memory, system, Python."""
    info = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*:\s*(.+)", info.read_text()) if info.exists() else []
    pages = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return (
        f"{os.cpu_count()} x {names[0] if names else platform.processor() or platform.machine()}, {pages / 2**30:.0f} GB, "
        f"{platform.system()} {platform.release().partition('-')[0]}, Python {platform.python_version()}"
    )


def page(studies: list[Entry], store: dict[str, Entry]) -> str:
    """docs/measured.md."""
    now = commit()
    text = [
        "# What was measured", "",
        "Written by `make bench` (`benchmarks/collect.py`); do not edit. Each block is what the command printed, with the "
        "commit, the load of the machine when it began and the seconds it took.", "",
        f"Commit {now}, {machine()}.", "",
    ]  # fmt: skip
    for study in studies:
        text += [f"## {study['title']}", "", f"    {study['command']}", ""]
        entry = store.get(study["title"])
        if entry is None or entry["command"] != study["command"]:
            text += [f"Not run on this commit; it takes about {study['minutes']} minutes.", ""]
            continue
        elsewhere = "" if entry["machine"] == machine() else f", {entry['machine']}"
        why = f" `{entry['error']}`" if "error" in entry else ""
        failed = "" if entry["status"] == 0 else f" **Exit status {entry['status']}.**{why}"
        text += [
            f"At {entry['commit']} on {entry['date']}, load {entry['load']}, {entry['seconds']} s{elsewhere}.{failed}",
            "", "```", *entry["lines"], "```", "",
        ]  # fmt: skip
    return "\n".join(text)


def with_table(readme: str, table: Entry, store: dict[str, Entry]) -> str:
    """The README with its table of figures written anew; itself where it has no place for one."""
    if BEGIN not in readme or END not in readme:
        return readme
    rows = ["| what | measured | commit |", "| --- | --- | --- |"]
    for row in table.get("readme", ()):
        entry = store.get(row["study"], {})
        rows.append(f"| {row['what']} | {said(row, store)} | {entry.get('commit', '')} |")
    before, _, rest = readme.partition(BEGIN)
    return "\n".join([before + BEGIN, *rows, END + rest.partition(END)[2]])


def said(row: Entry, store: dict[str, Entry]) -> str:
    """One figure of the README, from what its study printed."""
    entry = store.get(row["study"])
    if entry is None:
        return "not run"
    match = re.search(row["find"], "\n".join(entry["lines"]), re.MULTILINE)
    return row["say"].format(*match.groups()) if match else "not printed by this commit"


if __name__ == "__main__":
    sys.exit(main())
