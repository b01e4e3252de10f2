"""The tests themselves: no wait without an end, no program that nobody ends, every test in a tier that is known."""

import ast
import importlib
import sys
from functools import cache
from pathlib import Path
from subprocess import PIPE

import pytest
from helpers.dealing import dealt
from helpers.processes import LIMIT_S, Program
from hypothesis import given, settings
from hypothesis import strategies as st

HERE = Path(__file__).resolve().parent
FILES = sorted(path for path in HERE.rglob("*.py") if "hidden" not in path.parts)
# Where programs are started that run beside a test; everything else uses `Program`, or `subprocess.run` with a limit.
STARTERS = {"helpers/processes.py", "runtime/test_publishers.py"}


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def calls() -> list[tuple[Path, str, ast.Call]]:
    """Every call in the tests: where, of what."""
    return [
        (path, ast.unparse(node.func), node)
        for path in FILES
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call)
    ]


def at(path: Path, node: ast.expr | ast.stmt) -> str:
    return f"{path.relative_to(HERE)}:{node.lineno}"


def test_every_program_ends() -> None:
    faults = []
    for path, name, call in calls():
        given = {keyword.arg for keyword in call.keywords}
        if name in ("subprocess.run", "subprocess.check_output", "subprocess.check_call"):
            faults += [f"{at(path, call)}: {name} without a timeout"] * ("timeout" not in given)
        if name.endswith("Popen") and str(path.relative_to(HERE)) not in STARTERS:
            faults.append(f"{at(path, call)}: use Program of helpers/processes.py")
        if name.endswith((".communicate", ".wait")) and "process" in name.lower():
            faults += [f"{at(path, call)}: {name} without a limit"] * (
                not call.args and "timeout" not in given
            )
    assert not faults, "\n".join(faults)


def test_no_loop_sleeps_for_ever() -> None:
    """`while not done: sleep` never ends when what it waits for has died; `eventually` does."""
    faults = [
        f"{at(path, node)}: a loop that only sleeps; use eventually"
        for path in FILES
        if path.name != "processes.py"
        for node in ast.walk(tree(path))
        if isinstance(node, ast.While) and all(_is_sleep(statement) for statement in node.body)
    ]
    assert not faults, "\n".join(faults)


def test_no_limit_judges_the_speed_of_the_machine() -> None:
    """A limit of a few seconds passes on an idle machine and fails on one that is busy; `LIMIT_S` ends what hangs."""
    limits = [
        (f"{at(path, call)}: {name}", keyword.value.value)
        for path, name, call in calls()
        for keyword in call.keywords
        if keyword.arg == "timeout" and isinstance(keyword.value, ast.Constant)
    ]
    assert len(limits) > 3
    faults = [f"{where}, {limit} s" for where, limit in limits if limit is not None and limit < LIMIT_S]
    assert not faults, "\n".join(faults)


def test_examples_are_the_same_whatever_was_imported_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[int] = []

    @settings(derandomize=True)
    @given(st.integers())
    def draw(number: int) -> None:
        drawn.append(number)

    draw()
    first = drawn.copy()
    drawn.clear()
    (tmp_path / "full_of_constants.py").write_text(f"NUMBERS = {list(range(10**9, 10**9 + 500))}")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("full_of_constants")
    draw()
    assert len(first) > 50 and drawn == first


COUNTS = """
from numba.core import event
class Counted(event.Listener):
    count = 0
    def on_start(self, seen):
        self.count += seen.data["dispatcher"].py_func.__module__ == "needed_by_all"
    def on_end(self, seen):
        pass
counted = Counted()
event.register("numba:compile", counted)
import needed_by_all
"""
PROGRAM = f"""{COUNTS}
needed_by_all.outer(3.0)
print(counted.count)
"""
WORKER = f"""
import subprocess, sys
from pathlib import Path
sys.path[:0] = [TESTS, FOLDER]
from helpers.machine_code import share
share(Path(FOLDER) / "all", Path(FOLDER) / NAME)
{COUNTS}
print("ready", flush=True)
input()
print(needed_by_all.outer(3.0), counted.count, flush=True)
print(subprocess.check_output([sys.executable, "-c", {PROGRAM!r}], cwd=FOLDER, timeout=LIMIT_S, text=True))
"""


@pytest.mark.fit
def test_what_workers_and_their_programs_need_at_the_same_time_is_compiled_once(tmp_path: Path) -> None:
    (tmp_path / "all").mkdir()
    (tmp_path / "needed_by_all.py").write_text(
        "from numba import njit\n@njit(cache=True)\ndef inner(x):\n    return x + 1\n"
        "@njit(cache=True)\ndef outer(x):\n    return inner(x) * inner(2 * x)\n"
    )
    given = f"TESTS, FOLDER, LIMIT_S = {str(HERE)!r}, {str(tmp_path)!r}, {LIMIT_S}"
    commands = [[sys.executable, "-c", f"{given}\nNAME = {name!r}\n{WORKER}"] for name in "ab"]
    with Program(commands[0], stdin=PIPE) as one, Program(commands[1], stdin=PIPE) as other:
        programs = one, other
        for program in programs:
            assert program.line() == "ready"
        for program in programs:
            program.stdin.write("go\n")
            program.stdin.flush()
        for program in programs:
            assert program.ended() == 0, program.told()
        told = [(program.line(1).split(), program.line(2)) for program in programs]
    assert [result for (result, _), _ in told] == ["28.0", "28.0"]
    assert sorted(int(count) for (_, count), _ in told) == [0, 2]
    assert [by_a_program for _, by_a_program in told] == ["0", "0"]


class Item:
    """As much of a test as `dealt` looks at."""

    def __init__(self, path: str, number: int, mark: str | None = None) -> None:
        self.path, self.number, self._mark = path, number, mark

    def get_closest_marker(self, name: str) -> bool:
        return name == self._mark


def test_one_worker_begins_with_what_is_long_the_others_with_what_is_quick_and_files_stay_together() -> None:
    items = [Item("blind.py", k, "blind") for k in range(7)]
    for name, fits in (("a", 30), ("b", 20), ("c", 12), ("d", 0), ("e", 0)):
        items += [Item(f"{name}.py", k, "fit" if k < fits else None) for k in range(40)]
    shares = dealt(items, 3)  # type: ignore[arg-type]
    # What pytest-xdist sends to each: 207 tests over three, over two, over one.
    assert [len(share) for share in shares] == [69, 69, 69]
    assert {id(item) for share in shares for item in share} == {id(item) for item in items}
    blind = [[item.number for item in share if item.path == "blind.py"] for share in shares]
    assert sorted(map(len, blind)) == [2, 2, 3]
    begins = [[item.path for item in share].index("blind.py") for share in shares]
    assert begins == [0, *(sum(item.path in ("d.py", "e.py") for item in share) for share in shares[1:])]
    assert all(
        share[begin + k].path == "blind.py"
        for share, begin, cases in zip(shares, begins, blind, strict=True)
        for k in range(len(cases))
    )
    assert min(begins[1:]) > 10
    fits = [[item.path for item in share if item.get_closest_marker("fit")] for share in shares]
    assert sorted(map(len, fits)) == [12, 20, 30]
    for share in shares:
        for path in {item.path for item in share} - {"blind.py", "d.py", "e.py"}:
            assert [item.number for item in share if item.path == path] == list(range(40))
    assert [item.path for item in dealt(items, 1)[0]][:7] == ["blind.py"] * 7  # type: ignore[arg-type]


def _is_sleep(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and ast.unparse(statement).startswith("time.sleep(")
