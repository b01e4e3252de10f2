"""What holds for every test: one thread a worker, machine code shared by all, no process that outlives its test, its tier.

Tiers, by what a test costs: no mark, up to half a second of a processor; `fit`; `blind`; and `long`, which `make test`
leaves out (see CONTRIBUTING.md). What a test has used is measured, and those that belong elsewhere are listed in the end.
"""

import ctypes
import gc
import os
import sys
from collections.abc import Iterator

import psutil
import pytest
from helpers.dealing import TIERS, dealt
from helpers.machine_code import share
from hypothesis import settings
from hypothesis.internal.conjecture import providers

# The workers of pytest-xdist share out the cores; libraries that start a thread a core would fight over them, and sums in
# parallel come out in another order. Set before anything imports them, and inherited by the programs that tests start.
for _name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

# What Python compiles is kept, as numba's code is, for the next run and for the programs that tests start: reading 130 files
# of tests anew and rewriting their assertions takes each worker six seconds.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# What Python itself keeps for as long as a process lives that has started workers.
_LASTING = ("multiprocessing.resource_tracker", "multiprocessing.forkserver")
# A program that has been told to end may need a moment on a busy machine.
_GRACE_S = 60.0
# A test of the quick tier uses half a second, one that is not long some ten seconds, or more where nothing shorter shows it;
# a first compilation or import may fall on anyone.
_QUICK_S, _SHORT_S = 2.0, 60.0
_costly: dict[str, tuple[float, str]] = {}
# What each file of tests has used of a processor, fixtures and programs included, and how long it took, with what it waited
# for: said of so long a run, so many files of it.
_LONG_S, _SHOWN = 60.0, 25
_by_file: dict[str, tuple[float, float]] = {}
# Whether what was imported is looked through again.
_thawed: list[bool] = []

# A change lands or not for what it does, not for what was drawn: the same examples in each run, and as many seconds as a
# busy machine needs. `--hypothesis-profile search` draws new ones.
settings.register_profile("suite", derandomize=True, deadline=None)
settings.register_profile("search", deadline=None)
settings.load_profile("suite")
# Hypothesis also draws constants of our modules that happen to be imported: examples would depend on the tests before.
_of_modules = providers._get_local_constants
providers._get_local_constants = lambda: (
    providers.Constants() if settings.default.derandomize else _of_modules()
)


def pytest_configure(config: pytest.Config) -> None:
    worker = os.environ.get("PYTEST_XDIST_WORKER", "alone")
    assert config.cache is not None
    # Not in the process that only hands out tests.
    if worker != "alone" or not config.getoption("numprocesses", None):
        share(config.cache.mkdir("numba"), config.cache.mkdir(f"numba-{worker}"))
    if sys.platform == "linux":
        # Whoever loses its parent becomes a child of ours, so that nothing escapes `no_process_outlives_its_test`.
        ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Deal the tests out, so that each worker begins with its share of what is long: the rest fills the gaps at the end."""
    shares = dealt(items, int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))
    items[:] = [item for share in shares for item in share]


def pytest_collection_finish() -> None:
    """What all tests have imported stays: looking through it took the collector a quarter of a second and more, at each
    `motorlens run` anew, which collects before it begins."""
    gc.collect()
    gc.freeze()
    # Noted where it happens: to count what is frozen takes a twentieth of a second, and was asked after each test.
    thaw = gc.unfreeze

    def unfreeze() -> None:
        thaw()
        _thawed.append(True)

    gc.unfreeze = unfreeze


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """Note what the fixtures of a test have used that no test before has made."""
    yield from _measured(item, "setup")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Note what a test itself has used, programs it has waited for included; its fixtures may serve others too."""
    yield from _measured(item, "call")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Iterator[None]:
    """Note what was used until all that a test has started had ended."""
    yield from _measured(item, "teardown")
    if _thawed:
        gc.freeze()  # a `motorlens run` has let go of all
        _thawed.clear()


def _measured(item: pytest.Item, phase: str) -> Iterator[None]:
    before = _processor_s()
    yield
    item.user_properties.append((f"{phase}_s", _processor_s() - before))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    used = {name: value for name, value in report.user_properties if isinstance(value, float)}
    call_s = used.get("call_s", 0.0)
    if report.when == "call" and call_s > _QUICK_S and not set(TIERS) & set(report.keywords):
        _costly[report.nodeid] = call_s, "fit"
    if report.when == "call" and call_s > _SHORT_S and "long" not in report.keywords:
        _costly[report.nodeid] = call_s, "long"
    file = report.nodeid.partition("::")[0]
    used_s, lasted_s = _by_file.get(file, (0.0, 0.0))
    _by_file[file] = used_s + sum(used.values()) * (report.when == "teardown"), lasted_s + report.duration


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    whole = sum(used_s for used_s, _ in _by_file.values())
    if whole > _LONG_S:
        terminalreporter.section(f"{whole:.0f} s of a processor; those of each file, and how long it took")
        for name, (used_s, lasted_s) in sorted(_by_file.items(), key=lambda pair: -max(pair[1]))[:_SHOWN]:
            terminalreporter.write_line(f"{used_s:6.1f} s {lasted_s:6.1f} s  {name}")
    if _costly:
        terminalreporter.section("make them cheaper, or mark them")
        for name, (used_s, mark) in sorted(_costly.items(), key=lambda pair: -pair[1][0]):
            terminalreporter.write_line(f"{used_s:6.1f} s of a processor  {mark:4}  {name}")


def _processor_s() -> float:
    """Seconds of a processor that this process and the programs it has waited for have used."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.fixture(autouse=True)
def no_process_outlives_its_test() -> Iterator[None]:
    """Fails a test that leaves a program behind, and ends that program."""
    before = _descendants()
    yield
    if not (new := _new_since(before)):
        return
    _, left = psutil.wait_procs(new, timeout=_GRACE_S)
    words = [_words(process) for process in left]
    for process in left:
        process.kill()
    psutil.wait_procs(left, timeout=_GRACE_S)
    if words:
        pytest.fail("still runs after the test: " + "; ".join(words), pytrace=False)


def _descendants() -> set[psutil.Process]:
    try:
        # Asks the kernel alone, in a microsecond; a list of all processes takes a thousand times that.
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return set()
    return set(psutil.Process().children(recursive=True))


def _new_since(before: set[psutil.Process]) -> list[psutil.Process]:
    """Programs of this test; what a fixture of a longer life has started, and its children, are not."""
    lasting = {process.pid for process in before}
    return [
        process
        for process in _descendants() - before
        if _words(process) and not lasting & {parent.pid for parent in _parents(process)}
    ]


def _parents(process: psutil.Process) -> list[psutil.Process]:
    try:
        return process.parents()
    except psutil.NoSuchProcess:
        return []


def _words(process: psutil.Process) -> str:
    """Its number and command line; empty if it has ended, or is Python's own."""
    try:
        if process.status() == psutil.STATUS_ZOMBIE:
            return ""
        line = " ".join(process.cmdline())
    except psutil.NoSuchProcess:
        return ""
    return "" if any(name in line for name in _LASTING) else f"process {process.pid}: {line}"
