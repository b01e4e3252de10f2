"""`opcua://127.0.0.1:4840?device=press-7`: a small OPC UA server, read only. Needs the extra `opcua`.

One object per device; each estimate is a variable named by its column, with its engineering unit, and its status code is
what the quality word means (see `quality.opc_ua`). `quality_word` holds the word, `alarms` the names of those that are on.

It listens on this machine unless another address is given, without encryption: beyond this machine it belongs behind a
gateway. The server runs in a thread; the newest row is written when the one before has been, and those between are counted
as dropped. Starting it takes seconds and some memory; benchmarks/publishers.py prints how much.

Source: OPC 10000-8 (DataAccess) for units, UNECE recommendation 20 for their codes.
"""

import asyncio
import logging
import threading
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any
from urllib.parse import SplitResult, parse_qsl

from asyncua import Server, ua

from motorlens_runtime.errors import DeviceError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import OpcUa, opc_ua
from motorlens_runtime.options import Options
from motorlens_runtime.publish import Header, address_of

DEFAULT_PORT = 4840
_NAMESPACE = "urn:motorlens"
_UNECE = "http://www.opcfoundation.org/UA/units/un/cefact"
# Unit -> its UNECE common code and how people write it.
_UNITS = {"rad/s": ("2A", "rad/s"), "K": ("KEL", "K"), "degC": ("CEL", "°C"), "ohm": ("OHM", "Ω")}
# Ends the wait for a start that does not come, and for a stop that a client holds up: a start takes a second of a processor,
# which a busy machine may be minutes in giving.
_START_S = 600.0
_STOP_S = 30.0


def open_url(url: SplitResult, header: Header) -> "OpcUaPublisher":
    """See `publish`."""
    pairs = {key: value for key, value in parse_qsl(url.query) if key not in ("rate", "decimate")}
    options = Options(pairs, f"opcua://{url.hostname or ''}")
    device = options.text("device", header.device or header.sensor)
    options.finish()
    host, port = address_of(url, DEFAULT_PORT)
    return OpcUaPublisher(host, port, header, device)


@dataclass(frozen=True)
class _Nodes:
    values: list[Any]
    sigma: list[Any]
    word: Any
    alarms: Any


class OpcUaPublisher:
    """Runs the server. `dropped` counts rows that came faster than they could be written.

    Raises:
        DeviceError: it cannot listen there.
    """

    def __init__(self, host: str, port: int, header: Header, device: str) -> None:
        # The library tells of each session and each certificate it does not need.
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)
        self.endpoint = f"opc.tcp://{host}:{port}/motorlens"
        self.dropped = 0
        self._header = header
        self._device = device
        self._active: set[str] = set()
        self._writing: Future[None] | None = None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="opcua", daemon=True)
        self._thread.start()
        self._server = Server()
        try:
            self._nodes = asyncio.run_coroutine_threadsafe(self._start(), self._loop).result(_START_S)
        except TimeoutError:  # an OSError too, and without a word of its own
            self._end_loop()
            raise DeviceError(
                f"{self.endpoint}: the server did not start within {_START_S:g} s; is this PC busy with something else?"
            ) from None
        except OSError as error:
            self._end_loop()
            raise DeviceError(f"{self.endpoint}: cannot listen there: {error.strerror or error}") from None

    def publish(self, estimates: Estimates) -> None:
        """Write the last row, unless the one before is still being written."""
        if not len(estimates):
            return
        if self._writing is not None and not self._writing.done():
            self.dropped += len(estimates)
            return
        self.dropped += len(estimates) - 1
        row = estimates.values[-1].tolist(), estimates.sigma[-1].tolist(), int(estimates.quality[-1])
        self._writing = asyncio.run_coroutine_threadsafe(self._write(*row), self._loop)

    def event(self, event: dict[str, Any]) -> None:
        """Keep the list of alarms that are on."""
        name = str(event.get("alarm", ""))
        self._active = self._active | {name} if event.get("active") else self._active - {name}
        names = ua.Variant(sorted(self._active), ua.VariantType.String)
        asyncio.run_coroutine_threadsafe(self._nodes.alarms.write_value(ua.DataValue(names)), self._loop)

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Stop the server."""
        try:
            asyncio.run_coroutine_threadsafe(self._server.stop(), self._loop).result(_STOP_S)
        except TimeoutError:
            pass  # a client that does not let go is left to the operating system
        self._end_loop()

    async def _start(self) -> _Nodes:
        server = self._server
        await server.init()
        server.set_endpoint(self.endpoint)
        server.set_server_name("motorlens")
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        space = await server.register_namespace(_NAMESPACE)
        folder = await server.nodes.objects.add_object(ua.NodeId(self._device, space), self._device)
        for name, text in (
            ("sensor", self._header.sensor),
            ("sensor_version", self._header.version),
            ("sensor_sha256", self._header.digest),
        ):
            await folder.add_property(ua.NodeId(f"{self._device}.{name}", space), name, text)
        values: list[Any] = []
        sigma: list[Any] = []
        for output in self._header.outputs:
            for nodes, heading in ((values, output.heading), (sigma, output.sd_heading)):
                node = await self._variable(folder, space, heading, 0.0, ua.VariantType.Double)
                code, symbol = _UNITS[output.unit]
                unit = ua.EUInformation(
                    NamespaceUri=_UNECE,
                    UnitId=int.from_bytes(code.encode(), "big"),
                    DisplayName=ua.LocalizedText(symbol),
                    Description=ua.LocalizedText(output.unit),
                )
                await node.add_property(
                    ua.NodeId(f"{self._device}.{heading}.unit", space), "EngineeringUnits", unit
                )
                nodes.append(node)
        word = await self._variable(folder, space, "quality_word", 0, ua.VariantType.UInt32)
        alarms = await self._variable(folder, space, "alarms", [], ua.VariantType.String)
        await server.start()
        return _Nodes(values, sigma, word, alarms)

    async def _variable(self, folder: Any, space: int, name: str, value: Any, kind: Any) -> Any:
        node = await folder.add_variable(ua.NodeId(f"{self._device}.{name}", space), name, value, kind)
        # Until the first estimate there is nothing to be had.
        waiting = ua.StatusCode(ua.StatusCodes.BadWaitingForInitialData)
        if kind == ua.VariantType.Double:
            await node.write_value(ua.DataValue(ua.Variant(value, kind), StatusCode=waiting))
        return node

    async def _write(self, values: list[float], sigma: list[float], word: int) -> None:
        now = datetime.now(UTC).replace(tzinfo=None)
        status = ua.StatusCode(int(opc_ua(word)))
        for node, value in zip([*self._nodes.values, *self._nodes.sigma], [*values, *sigma], strict=True):
            await node.write_value(_value(value, ua.VariantType.Double, status, now))
        good = ua.StatusCode(int(OpcUa.GOOD))
        await self._nodes.word.write_value(_value(word, ua.VariantType.UInt32, good, now))

    def _end_loop(self) -> None:
        try:
            asyncio.run_coroutine_threadsafe(_give_up_the_rest(), self._loop).result(_STOP_S)
        except TimeoutError:
            pass  # what does not let itself be given up ends with the process
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_STOP_S)
        if not self._thread.is_alive():
            self._loop.close()


async def _give_up_the_rest() -> None:
    """End whatever still runs in this loop: a start that took too long, connections of clients."""
    rest = asyncio.all_tasks() - {asyncio.current_task()}
    for task in rest:
        task.cancel()
    await asyncio.gather(*rest, return_exceptions=True)


def _value(value: float, kind: Any, status: Any, now: datetime) -> Any:
    return ua.DataValue(ua.Variant(value, kind), StatusCode=status, SourceTimestamp=now, ServerTimestamp=now)
