"""The command line: every command explains itself, and every mistake gets one line and the right exit status."""

import os
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from helpers.processes import LIMIT_S

from motorlens_runtime import cli

COMMANDS = sorted(point.name for point in entry_points(group="motorlens.commands"))
ROOT = Path(__file__).resolve().parents[1]
MOTOR = "models/motors/mellah2016.toml"


def motorlens(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; from motorlens_runtime.cli import main; sys.exit(main())",
            *arguments,
        ],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=ROOT,
        env={**os.environ, **environment},
        check=False,
    )


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(command: str) -> None:
    done = motorlens(command, "--help")
    assert done.returncode == 0, done.stderr
    _, marked, example = done.stdout.replace("examples:", "example:").partition("example:")
    assert marked and f"motorlens {command}" in example
    assert "--json" in done.stdout


def printed_without_loading(heavy: set[str], script: str) -> str:
    """What a script of Python prints; it must not have loaded any of these modules."""
    probe = f"import sys\n{script}\nloaded = {heavy} & set(sys.modules)\nsys.exit(f'loaded {{loaded}}' if loaded else 0)"
    done = subprocess.run(
        [sys.executable, "-c", probe], capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_overview_names_every_command_without_loading_what_is_heavy() -> None:
    heavy = {"numpy", "torch", "scipy", "sympy", "numba", "onnxruntime", "matplotlib"}
    overview = "from motorlens_runtime.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass"
    said = printed_without_loading(heavy, overview)
    assert all(command in said for command in COMMANDS)


@pytest.mark.fit
def test_no_estimate_waits_for_what_it_does_not_need() -> None:
    """A third of a second at each start: `scipy.signal` brings all of `scipy.stats`."""
    heavy = {"torch", "scipy.signal", "scipy.stats", "scipy.interpolate", "matplotlib", "polars"}
    estimates = (
        "from motorlens_workbench import diagnose, ladder; from motorlens_workbench.compare import comparison\n"
        "assert 'scipy.optimize' in sys.modules"
    )
    assert printed_without_loading(heavy, estimates) == ""


@pytest.mark.fit
@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        ([], 2, "COMMAND"),
        (["fly"], 2, "invalid choice: 'fly'"),
        (["simulate", MOTOR, "--scenario", "dutty", "-o", "x.csv"], 1, "--scenario dutty: unknown"),
        (["simulate", MOTOR, "--effect", "columb_friction.tau_c=1", "-o", "x.csv"], 1, "did you mean 'coulomb_friction'?"),
        (["simulate", MOTOR, "--effect", "coulomb_friction.tau_c=-1", "-o", "x.csv"], 1, "outside 0 to"),
        (["simulate", "nowhere.toml", "-o", "x.csv"], 1, "nowhere.toml: No such file or directory"),
        (["simulate", MOTOR, "--noise", "0.5", "-o", "x.csv"], 1, "say of which channel"),
        (["simulate", "README.md", "-o", "x.csv"], 1, "not a motor file; it is TOML, *.toml, or the name of a shipped one"),
        (["look", "docs"], 1, "docs: a folder; name the recordings in it, as docs/*.csv"),
        (["look", MOTOR], 1, f"a motor file is given as --motor {MOTOR}"),
    ],
)  # fmt: skip
def test_a_mistake_gets_one_line(arguments: list[str], status: int, said: str) -> None:
    done = motorlens(*arguments)
    assert done.returncode == status
    assert said in done.stderr
    if status == 1:
        assert done.stderr.count("\n") == 1
        assert done.stderr.startswith(f"motorlens {arguments[0]}: ")


@pytest.mark.fit
@pytest.mark.parametrize(
    ("given", "then"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3"), ({"OMP_NUM_THREADS": "3"}, "")]
)
def test_blas_has_one_thread_in_every_command_unless_the_user_says_otherwise(
    given: dict[str, str], then: str
) -> None:
    script = """
import subprocess, sys
from motorlens_runtime import cli
assert "numpy" not in sys.modules
cli._parser = lambda *a, **k: 1 / 0
try:
    cli.main([])
except ZeroDivisionError:
    pass
subprocess.run([sys.executable, "-c", "import os; print(os.environ.get('OPENBLAS_NUM_THREADS', ''))"])
"""
    clean = {k: v for k, v in os.environ.items() if k not in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env=clean | given,
        timeout=LIMIT_S,
        check=True,
    )
    assert done.stdout.strip() == then


def test_what_nobody_foresaw_is_one_line_that_says_where(capsys, monkeypatch) -> None:
    from motorlens_runtime.commands import infer

    def broken(arguments):
        return int("seven")

    monkeypatch.setattr(infer, "run", broken)
    assert cli.main(["infer", "x.csv", "--sensor", "s", "-o", "-"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert (
        line.startswith("motorlens infer: a mistake of motorlens") and "ValueError: invalid literal" in line
    )
    monkeypatch.setenv("MOTORLENS_TRACEBACK", "1")
    with pytest.raises(ValueError, match="seven"):
        cli.main(["infer", "x.csv", "--sensor", "s", "-o", "-"])


def test_a_missing_extra_is_named(tmp_path: Path) -> None:
    (tmp_path / "sympy.py").write_text(
        "raise ModuleNotFoundError(\"No module named 'sympy'\", name='sympy')\n"
    )
    done = motorlens("simulate", MOTOR, "-o", str(tmp_path / "x.csv"), PYTHONPATH=str(tmp_path))
    assert done.returncode == 1
    assert (
        done.stderr
        == "motorlens simulate: needs sympy, which is not installed: pip install 'motorlens[workbench]'\n"
    )


def test_the_runtimes_own_commands_are_found_as_the_entry_points_say():
    points = {point.name: point.value for point in entry_points(group="motorlens.commands")}
    own = {name for name, module in points.items() if module.startswith("motorlens_runtime.")}
    assert len(own) >= 6
    for name in own:
        assert cli._modules(name) == {name: points[name]}
    assert cli._modules("simulate") == cli._modules(None) == points
