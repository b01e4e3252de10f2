"""The one command, `motorlens`: finds its subcommands through entry points and turns errors into one line.

A subcommand is one module with a docstring (its first line is the help line, the rest the epilog with an
example), `add_arguments(parser)` and `run(arguments) -> int`. Modules keep heavy imports inside `run`, so that
listing the commands stays instant and a missing extra hurts only the command that needs it.

Exit status: 0 done, 1 the data or the model is at fault, 2 wrong usage.
"""

import argparse
import importlib
import importlib.util
import json
import os
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from motorlens_runtime.errors import MotorlensError

# Which extra brings a module that the light runtime does not install.
EXTRAS = {
    "torch": "train", "onnx": "train", "scipy": "workbench", "sympy": "workbench", "numba": "workbench",
    "matplotlib": "workbench", "tomlkit": "workbench", "paho": "publish", "pyarrow": "publish",
    "cantools": "can", "asyncua": "opcua", "mcap": "mcap", "dask": "fleet", "distributed": "fleet",
}  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Run `motorlens` with the given arguments (default: those of the process) and return the exit status."""
    # Before numpy is imported, and handed down to every process that is started: our matrices are small, and BLAS's threads
    # would spin beside ours for several times the processor time.
    if not {"OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"} & os.environ.keys():
        os.environ["OPENBLAS_NUM_THREADS"] = "1"
    arguments = list(sys.argv[1:] if argv is None else argv)
    chosen = arguments[0] if arguments else None
    parser = _parser(_modules(chosen), chosen)
    parsed = parser.parse_args(arguments)
    try:
        return int(parsed.run(parsed))
    except MotorlensError as error:
        return _fail(parsed.command, " ".join(str(error).split()))
    except ModuleNotFoundError as error:
        root = (error.name or "").partition(".")[0]
        if root not in EXTRAS:
            raise
        return _fail(
            parsed.command, f"needs {root}, which is not installed: pip install 'motorlens[{EXTRAS[root]}]'"
        )
    except BrokenPipeError:
        # The reader of our output has gone (`| head`); that is its right, not an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(parsed.command, f"{where}{error.strerror or error}")
    except KeyboardInterrupt:
        return _fail(parsed.command, "interrupted", status=130)
    except MemoryError:
        return _fail(parsed.command, "this needs more memory than there is; try a shorter recording")
    except Exception as error:
        if os.environ.get("MOTORLENS_TRACEBACK"):
            raise
        return _fail(parsed.command, _mistake(error))


def _modules(chosen: str | None) -> dict[str, str]:
    """Modules by the name of their command: of the chosen one alone where it is the runtime's own."""
    own = f"motorlens_runtime.commands.{chosen}"
    if chosen and chosen.isidentifier() and importlib.util.find_spec(own):
        return {chosen: own}
    # Imported here: it reads what every installed distribution says of itself.
    from importlib.metadata import entry_points

    return {point.name: point.value for point in entry_points(group="motorlens.commands")}


class _Version(argparse.Action):
    """`--version`: looked up where it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *arguments: object) -> None:
        from importlib.metadata import version

        parser.exit(message=f"motorlens {version('motorlens')}\n")


def write_json(document: dict[str, Any], target: str | None) -> None:
    """Write `document` to the file `target`, to standard output if it is "-", nowhere if it is None."""
    if target is None:
        return
    text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
    else:
        Path(target).write_text(text, encoding="utf-8")


def add_json_argument(parser: argparse.ArgumentParser) -> None:
    """Give a subcommand the `--json FILE` that every subcommand has."""
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON; - is standard output")


def _parser(modules: dict[str, str], chosen: str | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="motorlens",
        description="Virtual sensor for brushed DC motors, and the workbench that tells which physics is missing.",
        epilog="example: motorlens infer recording.csv --sensor mellah2016 -o estimates.csv",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and end")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    # Only the chosen command is imported in full; the overview needs the help line of each.
    for name in sorted(modules) if chosen not in modules else [chosen]:
        assert name is not None
        module = importlib.import_module(modules[name])
        summary, epilog = _documentation(module)
        command = commands.add_parser(
            name,
            help=summary,
            description=summary,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


def _documentation(module: ModuleType) -> tuple[str, str]:
    summary, _, rest = (module.__doc__ or "").strip().partition("\n")
    return summary, rest.strip()


def _mistake(error: Exception) -> str:
    """One line on an error that nobody foresaw: what, and where in our code."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [
        frame
        for frame in frames
        if "motorlens" in Path(frame.filename).name or "motorlens_" in frame.filename
    ]
    at = ours[-1] if ours else frames[-1]
    what = " ".join(f"{type(error).__name__}: {error}".split())[:200]
    return (
        f"a mistake of motorlens, not yours: {what} (in {Path(at.filename).name}, line {at.lineno}); please report it, with "
        "what MOTORLENS_TRACEBACK=1 shows beside it"
    )


def _fail(command: str, message: str, status: int = 1) -> int:
    print(f"motorlens {command}: {message}", file=sys.stderr)
    return status
