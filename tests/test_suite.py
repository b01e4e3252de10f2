"""The tests themselves: no wait without an end, no program that nobody ends, every test in a tier that is known."""

import ast
import importlib
from collections.abc import Iterator
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


def calls(path: Path) -> Iterator[tuple[str, ast.Call]]:
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(HERE)))
def test_every_program_ends(path: Path) -> None:
    for name, call in calls(path):
        where = f"{path.name}:{call.lineno}"
        given = {keyword.arg for keyword in call.keywords}
        if name in ("subprocess.run", "subprocess.check_output", "subprocess.check_call"):
            assert "timeout" in given, f"{where}: {name} without a timeout"
        if name.endswith("Popen"):
            assert str(path.relative_to(HERE)) in STARTERS, f"{where}: use Program of helpers/processes.py"
        if name.endswith((".communicate", ".wait")) and "process" in name.lower():
            assert call.args or "timeout" in given, f"{where}: {name} without a limit"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(HERE)))
def test_no_loop_sleeps_for_ever(path: Path) -> None:
    """`while not done: sleep` never ends when what it waits for has died; `eventually` does."""
    if path.name == "processes.py":
        return
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.While) and all(_is_sleep(statement) for statement in node.body):
            raise AssertionError(f"{path.name}:{node.lineno}: a loop that only sleeps; use eventually")


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(HERE)))
def test_no_limit_judges_the_speed_of_the_machine(path: Path) -> None:
    """A limit of a few seconds passes on an idle machine and fails on one that is busy; `LIMIT_S` ends what hangs."""
    for name, call in calls(path):
        for keyword in call.keywords:
            if keyword.arg == "timeout" and isinstance(keyword.value, ast.Constant):
                limit = keyword.value.value
                assert limit is None or limit >= LIMIT_S, f"{path.name}:{call.lineno}: {name}, {limit} s"


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
