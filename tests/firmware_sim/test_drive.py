"""The simulated drive: converter against arithmetic, telemetry against the receiver, faults against their own rates."""

import math
import termios
import threading
import time

import numpy as np
import pytest
from helpers.processes import LIMIT_S

from motorlens_firmware_sim.adc import Adc
from motorlens_firmware_sim.faults import burst, drop_bytes, flip_bits, insert_bytes, repeat_bytes, swap_bytes
from motorlens_firmware_sim.port import PtyPort
from motorlens_firmware_sim.telemetry import Drive, sendings
from motorlens_runtime.cli import main
from motorlens_runtime.errors import DeviceError
from motorlens_runtime.line.framing import Decoder, Flag, HelloAssembler, Kind


def test_converter_by_hand() -> None:
    # 12 bits over +-10 V: one code is 10/2048 = 4.8828125 mV; 1 V is code 204.8, rounded to 205.
    adc = Adc(12, 10.0)
    assert adc.step == 0.0048828125
    codes = adc.convert(np.array([0.0, 1.0, -1.0, 10.0, -10.0, 99.0]))
    assert codes.tolist() == [0, 205, -205, 2047, -2048, 2047]
    assert adc.value(codes)[1] == pytest.approx(1.0009765625)
    assert adc.saturated(codes).tolist() == [False, False, False, True, True, True]


def test_quantisation_noise_is_that_of_a_uniform_error() -> None:
    # Bennett 1948: a busy signal is read with an error of step/sqrt(12) rms.
    adc = Adc(10, 5.0)
    values = np.random.default_rng(3).uniform(-4.9, 4.9, 200_000)
    rms = np.sqrt(np.mean((adc.value(adc.convert(values)) - values) ** 2))
    assert rms == pytest.approx(adc.step / math.sqrt(12), rel=0.01)


@pytest.mark.parametrize(("rows", "per_frame"), [(1000, 10), (1003, 10), (57, 1), (300, 200)])
def test_every_sample_arrives_in_order_at_its_time(rows: int, per_frame: int) -> None:
    drive = Drive(Adc(12, 30.0), Adc(12, 5.0), rate_Hz=500, rows_per_frame=per_frame)
    codes = np.random.default_rng(0).integers(-2000, 2000, (rows, 2)).astype(np.int16)
    decoder, hello, got, stamps, sequences = Decoder(), HelloAssembler(), [], [], []
    described = None
    for sending in sendings(drive, codes):
        for run in decoder.feed(sending.data):
            for frame in run.frames():
                sequences.append(frame.sequence)
                if frame.kind == Kind.HELLO:
                    described = hello.feed(frame) or described
                elif frame.kind == Kind.SAMPLES:
                    stamps.append(frame.t0_us)
                    got.append(np.frombuffer(frame.payload[2:], dtype="<i2").reshape(-1, 2))
    assert decoder.bad_frames == 0
    assert described == drive.hello
    np.testing.assert_array_equal(np.concatenate(got), codes)
    assert sequences == list(range(len(sequences)))
    expected = np.cumsum([0, *(len(block) for block in got[:-1])]) * 2000  # 500 Hz: 2000 us a sample
    assert stamps == expected.tolist()


def test_saturation_is_flagged_in_its_frame_only() -> None:
    drive = Drive(Adc(12, 30.0), Adc(12, 5.0), rate_Hz=10, rows_per_frame=5)
    codes = np.zeros((40, 2), dtype=np.int16)
    codes[22, 1] = 2047
    flags = []
    decoder = Decoder()
    for sending in sendings(drive, codes):
        for run in decoder.feed(sending.data):
            flags += [frame.flags for frame in run.frames() if frame.kind == Kind.SAMPLES]
    assert [bool(flag & Flag.SATURATED) for flag in flags] == [k == 4 for k in range(8)]
    assert [bool(flag & Flag.RESTART) for flag in flags] == [
        k < 2 for k in range(8)
    ]  # the first second after boot


@pytest.mark.parametrize("late_s", [0.0, 0.6])
def test_nothing_is_sent_before_the_reader_has_flushed_the_port(
    late_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As late as a busy machine makes it; what is sent then is all there."""
    monkeypatch.setattr("motorlens_firmware_sim.port._UNFLUSHED_S", LIMIT_S)
    with PtyPort() as port, open(port.name, "rb", buffering=0) as reader:

        def flush() -> None:
            time.sleep(late_s)
            flushed.set()
            termios.tcflush(reader, termios.TCIFLUSH)

        flushed, thread = threading.Event(), threading.Thread(target=flush)
        thread.start()
        port.wait_for_reader()
        assert flushed.is_set()
        assert port.write(b"all of it", patience_s=LIMIT_S) == 9
        assert reader.read(20) == b"all of it"
        thread.join()


def test_a_reader_that_does_not_flush_is_not_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("motorlens_firmware_sim.port._UNFLUSHED_S", 0.1)
    with PtyPort() as port, open(port.name, "rb", buffering=0):
        port.wait_for_reader()
        assert port.has_reader()


def test_a_port_carries_all_bytes_unchanged() -> None:
    everything = bytes(range(256)) * 8
    with PtyPort() as port:
        assert not port.has_reader()
        with open(port.name, "rb", buffering=0) as reader:
            assert port.has_reader()
            assert port.write(everything, patience_s=1.0) == len(everything)
            got = b""
            while len(got) < len(everything):
                got += reader.read(4096)
        assert not port.has_reader()
    assert got == everything


def test_a_link_that_cannot_be_made_is_said() -> None:
    with pytest.raises(DeviceError, match="--link /nowhere/at/all"):
        PtyPort("/nowhere/at/all")


def test_faults_happen_at_their_rates() -> None:
    data = np.random.default_rng(1).integers(0, 256, 200_000, dtype=np.uint8).tobytes()
    rng = np.random.default_rng(2)
    flipped = np.unpackbits(
        np.frombuffer(flip_bits(data, 0.01, rng), np.uint8) ^ np.frombuffer(data, np.uint8)
    )
    assert flipped.mean() == pytest.approx(0.01, rel=0.05)
    assert len(drop_bytes(data, 0.05, rng)) == pytest.approx(190_000, rel=0.005)
    assert len(insert_bytes(data, 0.05, rng)) == pytest.approx(210_000, rel=0.005)
    assert len(repeat_bytes(data, 0.05, rng)) == pytest.approx(210_000, rel=0.005)
    assert sorted(swap_bytes(data, 0.5, rng)) == sorted(data)
    assert swap_bytes(b"abcd", 1.0, rng) == b"badc"
    broken = np.frombuffer(burst(data, 100, 5, rng), np.uint8) != np.frombuffer(data, np.uint8)
    assert 400 < broken.sum() <= 500


def test_an_unknown_core_is_one_clear_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive", "--board", "z80", "--duration", "0.1"]) == 1
    said = capsys.readouterr()
    assert not said.out and said.err.count("\n") == 1
    assert "--board z80: choose cortex-m0, cortex-m3, cortex-m4f, cortex-m7f" in said.err
