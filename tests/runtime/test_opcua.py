"""The OPC UA publisher as a client of the standard sees it."""

import asyncio
import math
import warnings

import numpy as np
import pytest
from helpers.ports import free_place
from helpers.processes import LIMIT_S, eventually

from motorlens_runtime.errors import DataError, DeviceError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.publish import Header, open_publisher
from motorlens_runtime.sensor.specification import Output

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # what the library's own imports say is not our concern
    asyncua = pytest.importorskip("asyncua", reason="the extra `opcua` is not installed")
ua = asyncua.ua

HEADER = Header(
    "press", "1.2", "ab" * 32, (Output("speed", "rad/s", 100.0), Output("temperature", "degC", 40.0))
)


def estimates(speed, temperature, quality=0, n=1):
    values = np.tile([speed, temperature], (n, 1)).astype(float)
    return Estimates(np.arange(n) * 1000, values, values / 16, np.full(n, quality, dtype=np.uint32))


@pytest.fixture(scope="module")
def publisher():
    publisher = open_publisher(f"opcua://{free_place()}?device=press-7&rate=10", HEADER)
    yield publisher
    publisher.close()


def read(publisher, *names):
    """DataValues of the device's variables, through a client of its own."""

    async def ask():
        async with asyncua.Client(publisher.endpoint, LIMIT_S) as client:
            space = await client.get_namespace_index("urn:motorlens")
            nodes = [client.get_node(ua.NodeId(f"press-7.{name}", space)) for name in names]
            return [await node.read_data_value(raise_on_bad_status=False) for node in nodes]

    return asyncio.run(ask())


def published(publisher, rows):
    publisher.publish(rows)
    publisher._writing.result(LIMIT_S)


@pytest.mark.fit
def test_values_units_status_and_nothing_before_the_first_row(publisher):
    before = read(publisher, "speed_rad_s")[0]
    assert before.StatusCode.value == ua.StatusCodes.BadWaitingForInitialData
    published(publisher, estimates(123.5, 61.25))
    names = ("speed_rad_s", "speed_sd_rad_s", "temperature_C", "temperature_sd_C", "quality_word")
    values = read(publisher, *names)
    assert [value.Value.Value for value in values] == [123.5, 123.5 / 16, 61.25, 61.25 / 16, 0]
    assert all(value.StatusCode.is_good() for value in values)
    assert values[0].SourceTimestamp is not None
    units = [read(publisher, f"{name}.unit")[0].Value.Value for name in ("speed_rad_s", "temperature_C")]
    assert [unit.UnitId for unit in units] == [12865, 4408652]  # OPC 10000-8, table of UNECE codes
    assert units[1].DisplayName.Text == "°C"


@pytest.mark.parametrize(
    ("word", "code"),
    [
        (Quality.WARM_UP, ua.StatusCodes.UncertainInitialValue),
        (Quality.STALE, ua.StatusCodes.UncertainLastUsableValue),
        (Quality.OUTSIDE_ENVELOPE, ua.StatusCodes.UncertainEngineeringUnitsExceeded),
        (Quality.BRIDGED, ua.StatusCodes.UncertainSubstituteValue),
        (Quality.SATURATED, ua.StatusCodes.UncertainSensorNotAccurate),
        (Quality.SIMULATED, ua.StatusCodes.UncertainSimulatedValue),
        (Quality.NOT_FINITE, ua.StatusCodes.BadSensorFailure),
    ],
)
def test_the_quality_word_is_the_standards_status_code(publisher, word, code):
    published(publisher, estimates(math.nan if word == Quality.NOT_FINITE else 1.0, 2.0, word))
    value, number = read(publisher, "speed_rad_s", "quality_word")
    assert value.StatusCode.value == code
    assert number.Value.Value == int(word)


def test_alarms_that_are_on(publisher):
    publisher.event({"alarm": "hot", "active": True})
    publisher.event({"alarm": "fast", "active": True})
    publisher.event({"alarm": "fast", "active": False})
    eventually(lambda: read(publisher, "alarms")[0].Value.Value == ["hot"], "the alarm that is on")


def test_no_client_can_write(publisher):
    async def attempt():
        async with asyncua.Client(publisher.endpoint, LIMIT_S) as client:
            space = await client.get_namespace_index("urn:motorlens")
            await client.get_node(ua.NodeId("press-7.speed_rad_s", space)).write_value(0.0)

    with pytest.raises(ua.UaStatusCodeError, match=r"BadUserAccessDenied|BadNotWritable"):
        asyncio.run(attempt())


def test_rows_that_come_faster_than_they_are_written_are_counted(publisher):
    before = publisher.dropped
    published(publisher, estimates(1.0, 2.0, n=50))
    assert publisher.dropped - before == 49


@pytest.mark.fit
def test_a_port_that_is_taken_and_options_that_are_not_known(publisher):
    place = publisher.endpoint.removeprefix("opc.tcp://").partition("/")[0]
    with pytest.raises(DeviceError, match=r"cannot listen there: .*address already in use"):
        open_publisher(f"opcua://{place}", HEADER)
    with pytest.raises(DataError, match="no option 'devise'; did you mean 'device'"):
        open_publisher("opcua://127.0.0.1:1?devise=x", HEADER)


def test_a_server_that_does_not_start_is_said_in_words(monkeypatch):
    """Its error has none of its own: `str(TimeoutError())` is empty."""

    async def waits(self):
        await asyncio.sleep(LIMIT_S)

    monkeypatch.setattr("motorlens_runtime.publish.opcua.OpcUaPublisher._start", waits)
    monkeypatch.setattr("motorlens_runtime.publish.opcua._START_S", 0.1)
    place = free_place()
    with pytest.raises(DeviceError, match=rf"{place}/motorlens: the server did not start within 0\.1 s; "):
        open_publisher(f"opcua://{place}", HEADER)
