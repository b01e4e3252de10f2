"""`mqtt://127.0.0.1:1883?device=press-7`: a Homie 5 device that controllers find by themselves. Needs the extra `publish`.

`homie/5/DEVICE/$description` says what there is, `$state` whether it lives (its last will is "lost"), `motor/speed` and the
others hold the newest value, `motor/quality` the OPC UA name of its status, `$alert/NAME` each alarm that is on. Beside it,
`motorlens/DEVICE/estimates` has every row as JSON, as in `jsonl`, and `motorlens/DEVICE/events` the events.
Source: the Homie convention 5 (homieiot.github.io).

Options: `device` (default: the sensor's name), `prefix` for another root than `homie`, `user`, `password_file`, `tls=1`.

Values are sent once and not again (QoS 0); a broker that is slow or away costs values, which are counted, never memory or
time. Its thread reconnects by itself, and announces the device anew each time.
"""

import hashlib
import json
import re
import threading
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, parse_qsl

from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import OpcUa, opc_ua
from motorlens_runtime.options import Options
from motorlens_runtime.publish import Header, address_of
from motorlens_runtime.publish.jsonl import documents

# Messages handed over and not yet on the wire; beyond, new ones are dropped.
_MOST_WAITING = 1000
_UNITS = {"rad/s": "rad/s", "K": "K", "degC": "°C", "ohm": "Ω"}


def open_url(url: SplitResult, header: Header) -> "MqttPublisher":
    """See `publish`."""
    pairs = {key: value for key, value in parse_qsl(url.query) if key not in ("rate", "decimate")}
    options = Options(pairs, f"{url.scheme}://{url.hostname or ''}")
    device = options.text("device", header.device or header.sensor)
    prefix = options.text("prefix", "homie")
    user, password_file = options.text("user", ""), options.text("password_file", "")
    secure = options.integer("tls", 0, 0, 1) == 1
    options.finish()
    if re.search(r"[+#\0]", prefix):
        raise DataError(f"{url.geturl()}: prefix {prefix!r} holds a wildcard")
    host, port = address_of(url, 8883 if secure else 1883)
    try:
        password = Path(password_file).read_text(encoding="utf-8").strip() if password_file else None
    except OSError as error:
        raise DataError(f"{password_file}: {error.strerror}") from None
    return MqttPublisher(host, port, header, device, prefix, (user, password) if user else None, secure)


def topic_id(text: str) -> str:
    """A name as Homie allows it in a topic: lower case, digits and hyphens.

    >>> topic_id("Press 7 (left)")
    'press-7-left'
    """
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "motor"


class MqttPublisher:
    """Hands messages to the client's own thread. `dropped` counts those it could not take."""

    def __init__(
        self,
        host: str,
        port: int,
        header: Header,
        device: str,
        prefix: str = "homie",
        login: tuple[str, str | None] | None = None,
        secure: bool = False,
    ) -> None:
        self._header = header
        name = topic_id(device)
        self._base = f"{prefix}/5/{name}"
        self._plain = f"motorlens/{name}"
        self._description = json.dumps(description(header, device), ensure_ascii=False)
        self._alerts: dict[str, str] = {}
        self._lock = threading.Lock()
        self._waiting = 0
        self._ready = False
        self.dropped = 0
        self._client = Client(CallbackAPIVersion.VERSION2, client_id="")
        self._client.max_queued_messages_set(100)
        self._client.reconnect_delay_set(1, 30)
        self._client.will_set(f"{self._base}/$state", "lost", qos=1, retain=True)
        if login is not None:
            self._client.username_pw_set(*login)
        if secure:
            self._client.tls_set()
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = self._on_disconnect
        self._client.on_publish = self._on_publish
        self._client.connect_async(host, port, keepalive=15)
        self._client.loop_start()

    def publish(self, estimates: Estimates) -> None:
        """Every row as JSON, the last one as properties of the device."""
        if not len(estimates):
            return
        rows = documents(estimates, self._header)
        for row in rows:
            self._send(f"{self._plain}/estimates", json.dumps(row))
        last = rows[-1]
        for output in self._header.outputs:
            for heading, suffix in ((output.heading, ""), (output.sd_heading, "-standard-deviation")):
                value = last[heading]
                if value is not None:  # Homie has no word for a number that is none; quality says it
                    self._send(f"{self._base}/motor/{output.name}{suffix}", repr(value), retain=True)
        word = int(estimates.quality[-1])
        self._send(f"{self._base}/motor/quality", opc_ua(word).name.lower(), retain=True)
        self._send(f"{self._base}/motor/quality-word", str(word), retain=True)

    def event(self, event: dict[str, Any]) -> None:
        """The event as JSON; an alarm also as `$alert`, for as long as it is on."""
        self._send(f"{self._plain}/events", json.dumps(event))
        if "alarm" in event:
            name = topic_id(str(event["alarm"]))
            text = str(event.get("message", name)) if event.get("active") else ""
            with self._lock:
                self._alerts[name] = text
            if self._ready:
                self._client.publish(f"{self._base}/$alert/{name}", text, qos=1, retain=True)

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Say good-bye where somebody listens, and hang up; takes at most half a second."""
        if self._ready:
            farewell = self._client.publish(f"{self._base}/$state", "disconnected", qos=1, retain=True)
            if farewell.rc == MQTTErrorCode.MQTT_ERR_SUCCESS:
                try:
                    farewell.wait_for_publish(0.5)
                except (RuntimeError, ValueError):
                    pass
        self._client.disconnect()
        self._client.loop_stop()

    def _send(self, topic: str, payload: str, retain: bool = False) -> None:
        with self._lock:
            if not self._ready or self._waiting >= _MOST_WAITING:
                self.dropped += 1
                return
            self._waiting += 1
        if self._client.publish(topic, payload, qos=0, retain=retain).rc != MQTTErrorCode.MQTT_ERR_SUCCESS:
            with self._lock:
                self._waiting = max(self._waiting - 1, 0)
                self.dropped += 1

    def _on_connect(
        self,
        client: Client,
        data: Any,
        flags: ConnectFlags,
        reason: ReasonCode,
        properties: Properties | None,
    ) -> None:
        if reason.is_failure:
            return
        client.publish(f"{self._base}/$state", "init", qos=1, retain=True)
        client.publish(f"{self._base}/$description", self._description, qos=1, retain=True)
        with self._lock:
            alerts = dict(self._alerts)
            self._waiting = 0
            self._ready = True
        for name, text in alerts.items():
            client.publish(f"{self._base}/$alert/{name}", text, qos=1, retain=True)
        client.publish(f"{self._base}/$state", "ready", qos=1, retain=True)

    def _on_disconnect(
        self,
        client: Client,
        data: Any,
        flags: DisconnectFlags,
        reason: ReasonCode,
        properties: Properties | None,
    ) -> None:
        with self._lock:
            self._ready = False

    def _on_publish(
        self, client: Client, data: Any, mid: int, reason: ReasonCode, properties: Properties
    ) -> None:
        # Announcements count too, though they were not counted in; the number only has to stay near the truth.
        with self._lock:
            self._waiting = max(self._waiting - 1, 0)


def description(header: Header, device: str) -> dict[str, Any]:
    """`$description` of Homie 5."""
    properties: dict[str, Any] = {}
    for output in header.outputs:
        for suffix, title in (
            ("", output.name),
            ("-standard-deviation", f"standard deviation of {output.name}"),
        ):
            properties[output.name + suffix] = {
                "name": title.capitalize(), "datatype": "float", "unit": _UNITS[output.unit], "settable": False,
            }  # fmt: skip
    codes = ",".join(dict.fromkeys(code.name.lower() for code in OpcUa))
    properties["quality"] = {"name": "Quality", "datatype": "enum", "format": codes, "settable": False}
    properties["quality-word"] = {"name": "Quality word", "datatype": "integer", "settable": False}
    node = {
        "name": "Virtual sensor",
        "type": f"{header.sensor} {header.version}".strip(),
        "properties": properties,
    }
    document = {"homie": "5.0", "name": device, "type": "motorlens", "nodes": {"motor": node}}
    # Another description must have another version; the same one keeps it.
    digest = hashlib.sha256(json.dumps(document, sort_keys=True).encode()).digest()
    return {**document, "version": int.from_bytes(digest[:6], "big")}
