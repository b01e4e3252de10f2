"""What the tests of the runtime share."""

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from motorlens_runtime.estimate.bank import FilterBank
from motorlens_runtime.estimate.features import FeatureMap
from motorlens_runtime.estimate.gate import Gate
from motorlens_runtime.line.framing import Decoder
from motorlens_runtime.sensor import core_library


@pytest.fixture(scope="module", params=["python", "core"])
def engine(request: pytest.FixtureRequest) -> Iterator[str]:
    """Who computes: Python, or the C core. What asks for it is run against both.

    A fixture that loads a sensor must ask for it too, so that the sensor is loaded for the one or the other.
    """
    if request.param == "core" and core_library.core().library is None:
        pytest.skip(f"no C core: {core_library.core().reason}")
    with pytest.MonkeyPatch.context() as patched:
        if request.param == "python":
            patched.setenv("MOTORLENS_CORE", "off")
        yield request.param


@pytest.fixture(autouse=True)
def not_one_alone(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What asks for the core is run against Python too: it uses `engine`, or its module says why not in `ONE_ENGINE`."""
    found, asked = core_library._core, []

    def ask(choice: str) -> core_library.Core:
        asked.append(choice)
        return found(choice)

    ask.cache_clear = found.cache_clear  # type: ignore[attr-defined]
    monkeypatch.setattr(core_library, "_core", ask)
    yield
    if asked and "engine" not in request.fixturenames and not hasattr(request.module, "ONE_ENGINE"):
        pytest.fail("computes with the C core alone: use the fixture `engine`, or say in ONE_ENGINE why not")


@pytest.fixture(scope="module")
def parts(engine: str) -> SimpleNamespace:
    """Filter bank, feature map, gate and decoder of the engine, with one interface."""
    if engine == "python":
        return SimpleNamespace(
            FilterBank=FilterBank, FeatureMap=FeatureMap, Gate=Gate, Decoder=Decoder, many=9000
        )
    from helpers import core_parts

    return SimpleNamespace(
        FilterBank=core_parts.CoreBank, FeatureMap=core_parts.CoreFeatureMap, Gate=core_parts.CoreGate,
        Decoder=core_parts.CoreDecoder, many=600,
    )  # fmt: skip
