"""What the tests of the runtime share."""

from collections.abc import Iterator

import pytest

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
