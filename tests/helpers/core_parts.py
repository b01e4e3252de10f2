"""The parts of the C core, each with the interface of its Python counterpart, so that one test judges both.

A part is called sample by sample through ctypes: slow, and all that the core itself does.
"""

import ctypes

import numpy as np

from motorlens_runtime.estimate.core_estimator import gate_state_of, put_gate_state
from motorlens_runtime.estimate.features import FeatureMap
from motorlens_runtime.estimate.gate import Gated, limits_of
from motorlens_runtime.line.framing import Frame, run_of
from motorlens_runtime.sensor.backend import TILE
from motorlens_runtime.sensor.core_library import (
    BankMemory,
    DecoderMemory,
    FeatureTable,
    FrameTable,
    GateMemory,
    core,
    f64,
    i64,
    limits,
    u32,
)

_BACKWARDS = 2**32 - 1


class Sample(ctypes.Structure):
    """`motorlens_sample`."""

    _fields_ = [
        ("time_ns", i64), ("voltage_V", f64), ("current_A", f64), ("ambient_C", f64), ("flags", u32),
    ]  # fmt: skip


def library():
    found = core().library
    found.motorlens_bank_advance.argtypes = [ctypes.c_void_p, ctypes.c_void_p, i64, ctypes.c_void_p]
    found.motorlens_gate_inspect.argtypes = [ctypes.c_void_p, ctypes.c_void_p, i64, *[ctypes.c_void_p] * 3]
    found.motorlens_gate_inspect.restype = u32
    found.motorlens_decoder_feed.argtypes = [ctypes.c_void_p, ctypes.c_void_p, i64, ctypes.c_void_p]
    found.motorlens_decoder_feed.restype = i64
    return found


def table_of(kind, kept, **columns):
    """A table of the core with arrays behind its pointers; `kept` keeps them alive."""
    kinds = {"tau_s": np.float64, "plus": np.uint16, "minus": np.uint16}
    table = kind()
    for name, values in columns.items():
        if isinstance(values, int | float):
            setattr(table, name, values)
        else:
            array = np.array(values, dtype=kinds.get(name, np.uint8))
            kept.append(array)
            setattr(table, name, array.ctypes.data)
    return table


class CoreBank:
    """As `bank.FilterBank`; steps are whole nanoseconds."""

    def __init__(self, signals, tau_s):
        self.tau_s, self._kept, self._library = np.array(tau_s), [], library()
        self._table = table_of(
            FeatureTable, self._kept, filters=len(tau_s), tau_s=tau_s, filter_signal=range(len(tau_s))
        )

    def start(self, values=None):
        state, n = BankMemory(), len(self.tau_s)
        state.dt_s = -1.0
        state.reach[:n] = [1.0] * n
        if values is not None:
            state.before[:n] = np.asarray(values).tolist()
        return state

    def values(self, state):
        values = np.empty(len(self.tau_s))
        self._library.motorlens_bank_values(
            *map(
                ctypes.c_void_p, (ctypes.addressof(self._table), ctypes.addressof(state), values.ctypes.data)
            )
        )
        return values

    def advance(self, state, dt_s, signals, rows=None):
        state = BankMemory.from_buffer_copy(state)
        filtered = np.empty((len(self.tau_s), len(dt_s)))
        columns = np.ascontiguousarray(signals.T, dtype=np.float64)
        place = ctypes.addressof(self._table), ctypes.addressof(state)
        for k, dt_ns in enumerate(np.round(dt_s * 1e9).astype(np.int64).tolist()):
            self._library.motorlens_bank_advance(*place, dt_ns, columns[k].ctypes.data)
            filtered[:, k] = self.values(state)
        return state, filtered if rows is None else filtered[:, rows]


class CoreFeatureMap(FeatureMap):
    """As `features.FeatureMap`, of whose index tables the core's are made."""

    def __init__(self, specification):
        super().__init__(specification)
        self._kept, self._library = [], library()
        first, second = zip(*self.factors, strict=True)
        self._table = table_of(
            FeatureTable, self._kept, signals=len(first), filters=len(self.filter_signals), features=len(self.plus),
            first=first, second=second, filter_signal=self.filter_signals, plus=self.plus, minus=self.minus,
            resistance_ohm=specification.resistance_ohm,
        )  # fmt: skip

    def signals(self, channels):
        made = np.empty((len(channels.voltage_V), self._table.signals))
        for k, (volts, amperes) in enumerate(zip(channels.voltage_V, channels.current_A, strict=True)):
            ambient_C = 0.0 if channels.ambient_C is None else channels.ambient_C[k]
            sample = Sample(0, volts, amperes, ambient_C, 0)
            self._library.motorlens_signals(
                *map(ctypes.c_void_p, (ctypes.addressof(self._table), ctypes.addressof(sample), made[k].ctypes.data))
            )  # fmt: skip
        return made.T

    def features(self, filtered, signals, observed):
        parts = np.concatenate([part for part in (filtered, signals, observed) if part is not None])
        known = np.zeros((len(parts), TILE))
        known[:, : parts.shape[1]] = parts
        features = np.empty((len(self.plus), TILE))
        self._library.motorlens_features_of(
            *map(ctypes.c_void_p, (ctypes.addressof(self._table), known.ctypes.data, features.ctypes.data))
        )
        return features[:, : parts.shape[1]]


class CoreGate:
    """As `gate.Gate`."""

    def __init__(self, specification, period_s):
        from motorlens_runtime.sensor.core_backend import gate_table

        self._table = gate_table(limits_of(specification), specification.needs_ambient)
        self._period_ns, self._library = round(period_s * 1e9), library()

    def inspect(self, state, samples):
        memory, dt_ns, used = GateMemory(), i64(), ctypes.c_int()
        put_gate_state(memory, state)
        rows = []
        for k in range(len(samples)):
            ambient_C = np.nan if samples.ambient_C is None else samples.ambient_C[k]
            flags = 0 if samples.flags is None else int(samples.flags[k])
            sample = Sample(
                int(samples.time_ns[k]), samples.voltage_V[k], samples.current_A[k], ambient_C, flags
            )
            word = self._library.motorlens_gate_inspect(
                ctypes.addressof(self._table), ctypes.addressof(memory), self._period_ns, ctypes.addressof(sample),
                ctypes.addressof(dt_ns), ctypes.addressof(used),
            )  # fmt: skip
            assert word != _BACKWARDS
            rows.append((sample.voltage_V, sample.current_A, dt_ns.value * 1e-9, word, used.value))
        columns = np.array(rows, dtype=np.float64).reshape(-1, 5).T
        voltage, current, dt_s, quality, believed = columns
        return gate_state_of(memory), Gated(
            voltage, current, None, dt_s, quality.astype(np.uint32), believed > 0
        )


class CoreDecoder:
    """As `framing.Decoder`."""

    def __init__(self):
        self._memory, self._library = DecoderMemory(), library()

    @property
    def bad_frames(self):
        return self._memory.bad_frames

    def held(self):
        length = self._memory.length
        return bytes(self._memory.body[:length]), bool(self._memory.overlong), self._memory.bad_frames

    def feed(self, data):
        runs, frame, at = [], FrameTable(), 0
        start = ctypes.cast(ctypes.c_char_p(data), ctypes.c_void_p).value or 0
        while at < len(data):
            at += self._library.motorlens_decoder_feed(
                ctypes.addressof(self._memory), start + at, len(data) - at, ctypes.addressof(frame)
            )
            if frame.payload:
                payload = ctypes.string_at(frame.payload, frame.length)
                runs.append(
                    run_of(
                        [Frame(frame.kind, frame.sequence, frame.t0_us, payload, frame.flags)], len(payload)
                    )
                )
        return runs


assert limits()["LANES"] == TILE
