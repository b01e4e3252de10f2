"""The documents: what they show runs, what they link is there, and no figure in them was typed."""

import importlib.util
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.recording import read_recording
from motorlens_runtime.cli import main

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
spec = importlib.util.spec_from_file_location("collect", ROOT / "benchmarks" / "collect.py")
assert spec is not None and spec.loader is not None
collect = importlib.util.module_from_spec(spec)
spec.loader.exec_module(collect)
TABLE = collect.studies()


def tasks() -> dict[str, list[str]]:
    """The commands of each task of the README, by its heading; continued lines joined, comments gone."""
    found = {}
    for heading, body in re.findall(r"^### (.+?)\n(.*?)(?=^##)", README, flags=re.MULTILINE | re.DOTALL):
        text = "\n".join(re.findall(r"```sh\n(.*?)```", body, flags=re.DOTALL)).replace("\\\n", " ")
        lines = [shlex.join(shlex.split(line, comments=True)) for line in text.splitlines()]
        found[heading] = [line for line in lines if line]
    return found


def run(command: str) -> int:
    """A command of a document, in the folder where one stands; `test_cli` and `test_wheel` start it as a program."""
    words = shlex.split(command)
    assert words[0] == "motorlens"
    return main(words[1:])


def somebodys_csv(folder: Path) -> None:
    """`mine.csv` as the README shows its first lines: German words, decimal commas, duty and supply, milliamperes, rpm."""
    make = "motorlens simulate mellah2016 --scenario load_steps --noise 0.2% -o truth.csv"
    assert run(make) == 0
    truth = read_recording(folder / "truth.csv")
    v, i, w = (truth.channels[q] for q in ("voltage", "current", "speed"))
    load = truth.channels["load_torque"]
    columns = (truth.time_s, 100 * v / 260, np.full(len(v), 260.0), 1000 * i, w * 30 / np.pi, load)
    shown = re.search(r"`(Zeit.*?)`", README)
    assert shown is not None
    rows = [";".join(f"{x:.8g}".replace(".", ",") for x in row) for row in np.column_stack(columns)]
    (folder / "mine.csv").write_bytes(
        ("# bench 3\n" + shown[1] + "\n" + "\n".join(rows) + "\n").encode("cp1252")
    )
    (folder / "truth.csv").unlink()


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 90


def test_there_are_three_tasks_of_at_most_five_commands():
    assert len(tasks()) == 3
    assert all(1 <= len(commands) <= 5 for commands in tasks().values())


@pytest.mark.blind
@pytest.mark.parametrize("task", range(3))
def test_each_task_runs_in_an_empty_folder(task, tmp_path, monkeypatch, capfd):
    heading, commands = list(tasks().items())[task]
    monkeypatch.chdir(tmp_path)
    if any("mine.csv" in command for command in commands):
        somebodys_csv(tmp_path)
    for command in commands:
        capfd.readouterr()
        status = run(command)
        done = capfd.readouterr()
        assert status == 0, f"{heading}: {command}\n{done.out[-2000:]}\n{done.err[-2000:]}"
        for word in ("-o", "--html", "--json"):
            words = shlex.split(command)
            if word in words:
                assert (tmp_path / words[words.index(word) + 1]).stat().st_size > 0
    if "compare" in commands[-1]:  # what was missing was found and added
        assert done.out.startswith("The model follows these recordings to their noise"), done.out


@pytest.mark.parametrize(
    "document", sorted(ROOT.glob("*.md")) + sorted((ROOT / "docs").glob("*.md")), ids=lambda p: p.name
)
def test_links_lead_somewhere(document):
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", document.read_text(encoding="utf-8")):
        if not re.match(r"[a-z]+:", target):
            assert (document.parent / target).exists(), target


def test_every_study_is_run_by_make_bench():
    scripts = {path.name for path in (ROOT / "benchmarks").glob("*.py")} - {"collect.py"}
    named = set(re.findall(r"benchmarks/(\w+\.py)", " ".join(study["command"] for study in TABLE["study"])))
    assert named == scripts
    assert len({study["title"] for study in TABLE["study"]}) == len(TABLE["study"])


def test_what_was_measured_is_what_the_commands_printed():
    """The page and the README's table follow from the store; the head of the page names another commit and machine here."""
    store = json.loads(collect.STORE.read_text(encoding="utf-8"))
    assert set(store) <= {study["title"] for study in TABLE["study"]}
    page = collect.PAGE.read_text(encoding="utf-8")
    for entry in store.values():
        assert "\n".join(["```", *entry["lines"], "```"]) in page
    assert collect.with_table(README, TABLE, store) == README


@pytest.mark.fit
def test_a_study_that_fails_shows_its_figures_and_why_but_no_progress(tmp_path):
    script = tmp_path / "study.py"
    script.write_text(
        "import sys\n"
        "from motorlens_runtime import progress\n"
        "progress._QUIET_S = progress._EVERY_S = 0.0\n"
        "print('speed rms 0.25 rad/s')\n"
        "print('speed: missed by 0.05 rad/s', file=sys.stderr)\n"
        "with progress.Progress(3, 'worlds') as bar:\n"
        "    for k in range(3):\n"
        "        bar.update(k + 1, '(of 3)')\n"
        "print('2/3 world-2', file=sys.stderr)\n"
        "sys.exit(1)\n"
    )
    entry = collect.measured({"title": "t", "command": f"python {script}", "minutes": 1})
    assert (entry["status"], entry["lines"]) == (1, ["speed rms 0.25 rad/s"])
    assert entry["error"] == "speed: missed by 0.05 rad/s"
    page = collect.page([{"title": "t", "command": entry["command"], "minutes": 1}], {"t": entry})
    assert "**Exit status 1.** `speed: missed by 0.05 rad/s`\n\n```\nspeed rms 0.25 rad/s\n```" in page


def test_a_figure_is_taken_from_what_was_printed():
    row = {"study": "s", "find": r"rms +([\d.]+) rad/s", "say": "{} rad/s"}
    entry = {"lines": ["speed  rms  0.25 rad/s", "done"]}
    assert collect.said(row, {"s": entry}) == "0.25 rad/s"
    assert collect.said(row, {}) == "not run"
    assert collect.said(row, {"s": {"lines": ["other"]}}) == "not printed by this commit"
