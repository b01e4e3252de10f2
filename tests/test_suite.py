"""The tests themselves: no wait without an end, no program that nobody ends, every test in a tier that is known."""

import ast
import importlib
from functools import cache
from pathlib import Path

import pytest
from helpers.processes import LIMIT_S
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


def _is_sleep(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and ast.unparse(statement).startswith("time.sleep(")
