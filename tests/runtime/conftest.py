"""What the tests of the runtime share."""

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from motorlens_runtime.estimate.bank import FilterBank
from motorlens_runtime.estimate.features import FeatureMap
from motorlens_runtime.estimate.gate import Gate
from motorlens_runtime.line.framing import Decoder
from motorlens_runtime.sensor.core_library import core


@pytest.fixture(scope="module", params=["python", "core"])
def engine(request: pytest.FixtureRequest) -> Iterator[str]:
    """Who computes: Python, or the C core. What asks for it is run against both.

    A fixture that loads a sensor must ask for it too, so that the sensor is loaded for the one or the other.
    """
    if request.param == "core" and core().library is None:
        pytest.skip(f"no C core: {core().reason}")
    with pytest.MonkeyPatch.context() as patched:
        if request.param == "python":
            patched.setenv("MOTORLENS_CORE", "off")
        yield request.param


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
