"""The C core against Python: the same samples used, words, and bits of every state; estimates to rounding."""

import ctypes
import math
import subprocess

import numpy as np
import pytest
from helpers.sensor_files import make_spec, write_sensor
from hypothesis import example, given, settings
from hypothesis import strategies as st

from motorlens_runtime.cli import main
from motorlens_runtime.errors import DataError, ModelError
from motorlens_runtime.estimate.core_estimator import CoreEstimator, open_estimator
from motorlens_runtime.estimate.decay import decay
from motorlens_runtime.estimate.estimator import Estimates, Estimator
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.sensor import core_library
from motorlens_runtime.sensor.sensor import load_sensor, scales
from motorlens_runtime.sensor.tables import OPERATIONS, allocated

ONE_ENGINE = "it sets the core beside Python"

needs_core = pytest.mark.skipif(
    core_library.core().library is None, reason=f"no C core: {core_library.core().reason}"
)


def damaged_stream(n, seed, period_ns=1_000_000):
    """Two levels of voltage under noise, with jitter, gaps, repeated stamps, NaN, rubbish, and currents that stand still."""
    rng = np.random.default_rng(seed)
    t = np.arange(n)
    voltage = 100 + 80 * np.sign(np.sin(t / 40)) + rng.normal(size=n)
    current = 8 + 3 * np.sin(t / 70) + 0.2 * rng.normal(size=n)
    current[n // 3 : n // 3 + 150] = current[n // 3]
    step_ns = np.full(n, period_ns)
    step_ns[rng.random(n) < 0.05] += rng.integers(1, 400)
    step_ns[rng.integers(0, n, 3)] += rng.integers(0, 5_000_000_000, 3)
    step_ns[rng.integers(0, n, 3)] = 0
    for channel in (voltage, current):
        channel[rng.integers(0, n, n // 50)] = rng.choice([np.nan, np.inf, -np.inf, 1e30, 0.0], n // 50)
    if seed % 3 == 0:
        voltage[:2] = np.nan
    flags = rng.choice(np.array([0, 8, 256], dtype=np.uint32), n)
    return Samples(np.cumsum(step_ns), voltage, current, None, flags)


def blocks(samples, edges):
    for rows in np.split(np.arange(len(samples)), np.sort(edges).astype(int)):
        yield Samples(
            *(None if column is None else column[rows] for column in (
                samples.time_ns, samples.voltage_V, samples.current_A, samples.ambient_C, samples.flags))
        )  # fmt: skip


@pytest.fixture(scope="module", params=["filters", "ambient", "mellah2016", "mellah2016_observer"])
def pair(request, tmp_path_factory):
    """The same sensor for Python and for the core."""
    if request.param.startswith("mellah"):
        path = f"models/sensors/{request.param}.onnx"
    else:
        path = tmp_path_factory.mktemp("sensor") / "s.onnx"
        write_sensor(path, ambient=request.param == "ambient")
    return load_sensor(path, "numpy"), load_sensor(path, "core")


@pytest.mark.fit
@needs_core
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(0, 1500), max_size=8), st.booleans())
# Samples one at a time.
@example(1, [700, 701, 702], False)
def test_the_core_gives_words_and_states_of_python_to_the_bit(pair, seed, edges, with_ambient):
    python, core = pair
    samples = damaged_stream(1500, seed)
    if with_ambient or python.specification.needs_ambient:
        ambient = 20 + 5 * np.sin(np.arange(1500) / 300)
        ambient[::97] = np.nan
        samples = Samples(samples.time_ns, samples.voltage_V, samples.current_A, ambient, samples.flags)
    first, second = Estimator(python, 1e-3), open_estimator(core, 1e-3)
    assert isinstance(second, CoreEstimator)
    parts = list(blocks(samples, edges))
    one, two = ([estimator.push(part) for part in parts] for estimator in (first, second))
    for field in ("time_ns", "quality"):
        assert np.array_equal(*(np.concatenate([getattr(e, field) for e in x]) for x in (one, two))), field
    a, b = first.state, second.state
    assert a.gate == b.gate and a.observer == b.observer and a.bank.count == b.bank.count
    assert np.array_equal(a.bank.before, b.bank.before) and np.array_equal(a.bank.within, b.bank.within)
    # and the state may be handed from the one to the other
    third = Estimator(python, 1e-3, b)
    assert third.state.gate == a.gate and np.array_equal(third.state.bank.within, a.bank.within)


@pytest.mark.fit
@needs_core
def test_estimates_to_rounding_on_a_duty_cycle(pair):
    python, core = pair
    if python.specification.needs_ambient:
        pytest.skip("the duty cycle has no ambient temperature")
    from helpers.duty import measured_duty

    recording = measured_duty(3, 60.0, 200.0)
    samples = Samples(
        np.round(recording.time_s * 1e9).astype(np.int64), recording.channels["voltage"], recording.channels["current"]
    )  # fmt: skip
    first, second = Estimator(python, 5e-3).push(samples), open_estimator(core, 5e-3).push(samples)
    scale = scales(python.specification)
    assert np.array_equal(first.quality, second.quality)
    assert np.max(np.abs(first.values - second.values) / scale) < 1e-12
    assert np.max(np.abs(first.sigma - second.sigma) / scale) < 1e-12
    assert np.ptp(second.values[:, 0]) > 0.1 * scale[0]  # it is a sensor that is compared


@needs_core
def test_the_decay_has_the_same_bits_in_both_and_is_exp():
    library = core_library.core().library
    library.motorlens_decay.restype, library.motorlens_decay.argtypes = ctypes.c_double, [ctypes.c_double]
    rng = np.random.default_rng(0)
    x = -np.concatenate([10 ** rng.uniform(-12, 3, 20000), [0.0, 707.9999, 708.0, 708.0001, 800.0]])
    found = decay(x)
    assert np.array_equal(found, [library.motorlens_decay(float(value)) for value in x])
    exact = np.array([math.exp(value) for value in x])
    near = x >= -708
    assert np.max(np.abs(found[near] / exact[near] - 1)) < 4.5e-16 and not found[~near].any()


@needs_core
def test_time_backwards_leaves_the_state(pair):
    _, core = pair
    samples = damaged_stream(300, 1)
    ambient = np.full(300, 20.0)
    samples = Samples(samples.time_ns, samples.voltage_V, samples.current_A, ambient, samples.flags)
    estimator = open_estimator(core, 1e-3)
    estimator.push(samples)
    before = estimator.state
    with pytest.raises(DataError, match="time runs backwards"):
        estimator.push(samples)
    after = estimator.state
    assert after.gate == before.gate and np.array_equal(after.bank.within, before.bank.within)


@pytest.mark.fit
@needs_core
def test_each_operation_of_an_observer_as_python_computes_it():
    """Random programs over awkward numbers: the register machine against the function that Python compiles."""
    from motorlens_runtime.estimate.observer import _OPERATIONS, _compiled
    from motorlens_runtime.sensor.core_library import OperationTable, ProgramTable

    library = core_library.core().library
    library.motorlens_program_run.argtypes = [ctypes.c_void_p] * 3
    rng = np.random.default_rng(5)
    awkward = [0.0, -0.0, 1.0, -1.0, 1e300, -1e300, 1e-300, 0.5, 2.0, 710.0, -745.0, math.inf, -math.inf, 3.0]
    failures = 0
    for _ in range(1500):
        inputs, constants = 4, [float(rng.choice(awkward)) for _ in range(3)]
        steps, known = [], inputs + len(constants)
        for _ in range(8):
            operation = str(rng.choice(OPERATIONS))
            steps.append([operation, *rng.integers(0, known, _OPERATIONS[operation][0]).tolist()])
            known += 1
        document = {"inputs": ["a"] * 4, "constants": constants, "steps": steps,
                    "outputs": rng.integers(0, known, 5).tolist()}  # fmt: skip
        function = _compiled(document, 4, 5)
        program = allocated(document)
        operations = (OperationTable * len(program.steps))(
            *(
                OperationTable(op, result, (ctypes.c_uint16 * 3)(*a, *[a[0]] * (3 - len(a))))
                for op, result, a in program.steps
            )
        )
        values, outputs = np.array(program.constants), np.array(program.outputs, dtype=np.uint16)
        table = ProgramTable(ctypes.addressof(operations), values.ctypes.data, outputs.ctypes.data, len(program.steps),
                             program.registers, 4, 5)  # fmt: skip
        for _ in range(4):
            given_numbers = np.array(
                [rng.choice(awkward) if rng.random() < 0.5 else rng.normal() for _ in range(4)]
            )
            results = np.zeros(5)
            failed = library.motorlens_program_run(
                ctypes.addressof(table), given_numbers.ctypes.data, results.ctypes.data
            )
            try:
                expected = function(*given_numbers.tolist())
            except (ArithmeticError, ValueError):
                assert failed, document
                failures += 1
                continue
            assert not failed, document
            numbers = ~np.isnan(expected)
            assert results[numbers].tobytes() == np.array(expected)[numbers].tobytes()
            assert np.array_equal(np.isnan(results), np.isnan(expected))
    assert 100 < failures < 5000


def test_without_a_core_python_computes_and_says_why(monkeypatch, tmp_path):
    write_sensor(tmp_path / "s.onnx")
    monkeypatch.setenv("MOTORLENS_CORE", "off")
    assert load_sensor(tmp_path / "s.onnx").backend.name == "numpy"
    with pytest.raises(ModelError, match="switched off"):
        load_sensor(tmp_path / "s.onnx", "core")
    monkeypatch.delenv("MOTORLENS_CORE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "empty"))
    core_library._core.cache_clear()
    with monkeypatch.context() as patched:
        patched.setattr(core_library.shutil, "which", lambda name: None)
        assert "no C compiler" in core_library.core().reason
        core_library._core.cache_clear()
        patched.setattr(core_library.shutil, "which", lambda name: "/bin/false")
        assert "does not compile" in core_library.core().reason
    core_library._core.cache_clear()
    (tmp_path / "other.so").write_bytes(b"not a library")
    monkeypatch.setenv("MOTORLENS_CORE", str(tmp_path / "other.so"))
    assert "does not load" in core_library.core().reason


@needs_core
def test_a_sensor_beyond_its_room_or_functions_is_left_to_python(tmp_path):
    spec = make_spec()
    spec["filters"] *= 20
    write_sensor(tmp_path / "large.onnx", spec=spec)
    with pytest.raises(ModelError, match="room for 96 filters, not for 120"):
        load_sensor(tmp_path / "large.onnx", "core")
    assert load_sensor(tmp_path / "large.onnx").backend.name == "numpy"


@pytest.mark.fit
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("single", [False, True])
def test_no_warning_of_a_strict_compiler(compiler, single, tmp_path):
    import shutil

    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler} here")
    if single:
        sensor = "models/sensors/mellah2016_observer.onnx"
        assert main(["export", sensor, "--c", str(tmp_path / "c")]) == 0
        tmp_path = tmp_path / "c"
    else:
        for source in core_library.source_folder().glob("*.[ch]"):
            (tmp_path / source.name).write_bytes(source.read_bytes())
    subprocess.run(
        [compiler, "-std=c99", "-pedantic", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wshadow",
         "-Werror", "-c", *(path.name for path in sorted(tmp_path.glob("*.c")))],
        check=True, cwd=tmp_path, timeout=600,
    )  # fmt: skip


@needs_core
def test_a_row_that_is_not_finite_harms_no_row_beside_it(pair):
    """Rows are evaluated side by side; each is for itself."""
    _, core = pair
    rng = np.random.default_rng(0)
    features = rng.normal(size=(2, len(core.specification.features), 16)) * 10
    clean = core.backend.evaluate(features)
    features[0, :, 3] = np.nan
    for found, expected in zip(core.backend.evaluate(features), clean, strict=True):
        assert np.isnan(found[0, :, 3]).all()
        found[0, :, 3] = expected[0, :, 3]
        assert np.array_equal(found, expected)


@needs_core
def test_the_exponential_of_the_network_is_exp_to_both_ends_of_its_range():
    """Sixteen rows are computed side by side; what is beyond its range in one of them changes no other."""
    ends = [-np.inf, -1e300, -708.1, -708.0, 0.0, 709.0, 709.1, 1e300, np.inf, np.nan]
    x = np.concatenate([np.random.default_rng(0).uniform(-708, 709, 150), ends])
    features, found, sigma = np.ascontiguousarray(x), np.empty_like(x), np.empty_like(x)
    table, zero, first = core_library.SensorTable(), (ctypes.c_double * 1)(0.0), (ctypes.c_uint16 * 1)(0)
    table.features.features = 1
    table.features.plus = ctypes.addressof(first)
    table.envelope.mean, table.envelope.limit, table.envelope.distrust = ctypes.addressof(zero), math.inf, -1
    step = core_library.StepTable(
        1, 1, 1
    )  # MOTORLENS_EXP of one column: the feature; what it gives is the third
    network = table.network
    network.steps, network.count, network.outputs = ctypes.addressof(step), 1, 1
    network.estimate.start = network.sigma.start = 2
    network.offset = ctypes.addressof(zero)
    core_library.core().library.motorlens_evaluate_features(
        ctypes.addressof(table), len(x), features.ctypes.data, found.ctypes.data, sigma.ctypes.data
    )
    within = np.abs(x) <= 708
    exact = np.array([math.exp(value) for value in x[within]])
    assert np.max(np.abs(found[within] / exact - 1)) < 4.5e-16 and np.array_equal(
        found, sigma, equal_nan=True
    )
    assert found[-10:-7].tolist() == [0.0, 0.0, 0.0] and found[-4:-1].tolist() == [math.inf] * 3
    assert np.isnan(found[-1]) and found[-5] == pytest.approx(math.exp(709.0), rel=1e-15)


def test_estimates_are_what_the_publishers_expect():
    assert [f for f in Estimates.__dataclass_fields__] == ["time_ns", "values", "sigma", "quality"]
    assert Quality.ASSUMED_COLD == 4096
