"""The wire protocol: two implementations byte for byte, CRC by zlib, and nothing wrong ever accepted."""

import itertools
import re
import shutil
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorlens_runtime.errors import DataError
from motorlens_runtime.line.framing import (
    MAX_BODY,
    MAX_PAYLOAD,
    Channel,
    Frame,
    Hello,
    HelloAssembler,
    Kind,
    Status,
    crc32_rows,
    decode,
    decode_run,
    encode,
    hello_frames,
    samples_frame,
    samples_per_frame,
    status_frame,
)

HEADER = Path(__file__).resolve().parents[2] / "firmware_sim" / "include"
HELLO = Hello(
    "drive-1", 77, (10000, 1),
    (Channel("voltage", "V", "i2", 0.129, 0.0, -2048, 2047), Channel("current", "mA", "i2", 37.0, 0.0, -2048, 2047)),
    firmware="fünf", simulated=True,
)  # fmt: skip

frames = st.builds(
    Frame,
    kind=st.integers(0, 255),
    sequence=st.integers(0, 65535),
    t0_us=st.integers(0, 2**32 - 1),
    payload=st.binary(max_size=MAX_PAYLOAD),
    flags=st.integers(0, 15),
)


def received(parts, data, cuts=()):
    decoder = parts.Decoder()
    edges = [0, *sorted(cuts), len(data)]
    runs = [run for a, b in itertools.pairwise(edges) for run in decoder.feed(data[a:b])]
    return [frame for run in runs for frame in run.frames()], decoder


def slow_decode(body):
    """COBS and the frame as the paper and the document say, byte by byte."""
    out, at = b"", 0
    while at < len(body):
        code = body[at]
        piece = body[at + 1 : at + code]
        if code == 0 or len(piece) != code - 1:
            return None
        out += piece
        at += code
        if at < len(body):
            out += b"\0"
    if len(out) < 12 or zlib.crc32(out[:-4]) != int.from_bytes(out[-4:], "little") or out[1] >> 4 != 1:
        return None
    return Frame(
        out[0], int.from_bytes(out[2:4], "little"), int.from_bytes(out[4:8], "little"), out[8:-4], out[1] & 15
    )


@given(frames)
def test_a_frame_comes_back(frame):
    wire = encode(frame)
    assert wire.count(0) == 1 and wire[-1] == 0 and len(wire) == 8 + len(frame.payload) + 4 + 2
    assert decode(wire[:-1]) == slow_decode(wire[:-1]) == frame


@settings(deadline=None)
@given(st.lists(frames, max_size=40), st.lists(st.integers(0, 3000), max_size=20))
def test_a_stream_comes_back_however_it_is_cut(parts, sent, cuts):
    data = b"".join(map(encode, sent))
    got, decoder = received(parts, data, [cut for cut in cuts if cut < len(data)])
    assert got == sent and decoder.bad_frames == 0


@settings(deadline=None)
@given(st.integers(1, 60), st.integers(0, MAX_PAYLOAD), st.integers(0, 2**32 - 1))
def test_many_frames_at_once_are_decoded_as_one_by_one(count, length, seed):
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 256, (count, length)).astype(np.uint8)
    values[rng.random(values.shape) < 0.3] = 0
    bodies = [encode(Frame(2, k, 17 * k, row.tobytes()))[:-1] for k, row in enumerate(values)]
    for at in rng.integers(0, count, count // 4):
        damaged = bytearray(bodies[at])
        damaged[rng.integers(len(damaged))] = rng.integers(1, 256)
        bodies[at] = bytes(damaged)
    run, bad = decode_run(bodies)
    expected = [frame for frame in map(slow_decode, bodies) if frame is not None]
    assert list(run.frames()) == expected and bad == count - len(expected)


@settings(deadline=None)
@given(st.binary(max_size=2000), st.lists(st.integers(0, 2000), max_size=10))
def test_garbage_never_raises_and_never_passes(parts, garbage, cuts):
    got, decoder = received(parts, garbage, [cut for cut in cuts if cut < len(garbage)])
    pieces = [piece for piece in garbage.split(b"\0")[:-1] if piece]
    expected = [frame for frame in map(slow_decode, pieces) if frame is not None]
    assert got == expected and decoder.bad_frames >= len(pieces) - len(expected)


def test_resynchronises_at_the_next_zero_and_memory_is_bounded(parts):
    good = [encode(Frame(2, k, k, bytes([k % 7] * 20))) for k in range(100)]
    got, decoder = received(parts, b"".join(good[:10]) + b"\x55" * 10 + b"".join(good[10:]))
    assert [frame.sequence for frame in got] == [k for k in range(100) if k != 10] and decoder.bad_frames == 1
    decoder = parts.Decoder()
    for _ in range(1000):
        assert decoder.feed(b"\x55" * 4096) == []
        assert len(decoder.held()[0]) <= MAX_BODY
    assert decoder.bad_frames == 1
    assert len(decoder.feed(b"\0" + good[5])) == 1


@given(st.integers(1, 40), st.integers(1, 60), st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_crc_of_rows_is_that_of_zlib(rows, length, seed):
    values = np.random.default_rng(seed).integers(0, 256, (rows, length)).astype(np.uint8)
    assert crc32_rows(values).tolist() == [zlib.crc32(row.tobytes()) for row in values]


@pytest.mark.fit
def test_faults_on_the_line_let_nothing_wrong_through(parts):
    """Bit errors, bursts, lost, added, swapped and repeated bytes on many frames: all that passes was sent."""
    rng, count = np.random.default_rng(1), min(20_000, 10 * parts.many)
    sent = [
        samples_frame(
            rng.integers(-2048, 2048, (10, 2)).astype(np.int16), schema=1, sequence=k & 0xFFFF, t0_us=1000 * k
        )
        for k in range(count)
    ]
    data = np.frombuffer(b"".join(sent), dtype=np.uint8).copy()
    known = set(sent)
    total_bad = 0
    for share in (1e-5, 1e-4, 1e-3):
        noisy = data ^ np.packbits(rng.random(8 * len(data)) < share)
        total_bad += check(parts, noisy, known)
        total_bad += check(parts, noisy[rng.random(len(noisy)) > share], known)
        total_bad += check(
            parts,
            np.insert(data, rng.integers(0, len(data), 200), rng.integers(0, 256, 200).astype(np.uint8)),
            known,
        )
    burst = data.copy()
    for start in rng.integers(0, len(data) - 400, 300):
        burst[start : start + 300] = rng.integers(0, 256, 300)
    total_bad += check(parts, burst, known)
    repeated = np.repeat(data, 1 + (rng.random(len(data)) < 1e-3))
    total_bad += check(parts, repeated, known)
    assert total_bad > count / 2  # the faults were there


def check(parts, noisy, known):
    got, decoder = received(parts, noisy.tobytes(), range(0, len(noisy), 8192))
    assert got and all(encode(frame) in known for frame in got)
    return decoder.bad_frames


def test_hello_in_pieces(parts):
    wire = hello_frames(HELLO, sequence=65534, t0_us=5)
    assert len(wire) == 2
    got, _ = received(parts, b"".join(wire))
    assembler = HelloAssembler()
    assert [assembler.feed(frame) for frame in got] == [None, HELLO]
    # a lost or foreign piece costs that sending only
    assert assembler.feed(got[1]) is None
    assert assembler.feed(got[0]) is None and assembler.feed(Frame(1, 99, 0, got[1].payload)) is None
    assert [assembler.feed(frame) for frame in got] == [None, HELLO]


@pytest.mark.parametrize(
    "text",
    [
        b"", b"{", b"[]", b"1", b"{}", b'{"device":1}', HELLO.to_json().replace(b"10000", b"0"),
        HELLO.to_json().replace(b'"i2"', b'"u9"'), HELLO.to_json().replace(b"0.129", b"NaN"), b"[" * 50_000,
        HELLO.to_json().replace(b'"i2"', b'"f4"', 1),
    ],
)  # fmt: skip
def test_a_hello_that_says_nothing_is_refused(text):
    with pytest.raises(DataError, match="HELLO is not understood"):
        Hello.from_json(text)


def test_a_newer_hello_is_understood():
    assert Hello.from_json(HELLO.to_json().replace(b'{"device"', b'{"colour":"red","device"')) == HELLO


def test_too_long_is_refused():
    with pytest.raises(ValueError, match="a frame holds 240"):
        encode(Frame(2, 0, 0, bytes(241)))
    n = samples_per_frame(2)
    assert n == 59
    samples_frame(np.zeros((n, 2), dtype=np.int16), schema=1, sequence=0, t0_us=0)
    with pytest.raises(ValueError, match="payload"):
        samples_frame(np.zeros((n + 1, 2), dtype=np.int16), schema=1, sequence=0, t0_us=0)


PROGRAM = r"""
#include "motorlens_frame.h"
#include <stdio.h>
int main(void)
{
    motorlens_sender sender = {0};
    uint8_t wire[MOTORLENS_WIRE_MAX];
    int16_t codes[118];
    float values[58];
    static char json[1000];
    size_t n;
    for (int k = 0; k < 118; k++) codes[k] = (int16_t)(k * k * 37 - 2000 * (k % 5 == 0));
    for (int k = 0; k < 58; k++) values[k] = (float)k / 7.0f - 3.0f;
    for (int k = 0; k < 1000; k++) json[k] = (char)(32 + k % 90);
    sender.sequence = 65530;
    for (int count = 0; count < 60; count += 1)
        fwrite(wire, 1, motorlens_samples_i16(&sender, wire, 3, 4294967000u + 10u * (uint32_t)count, 2, codes,
                                              (uint8_t)count, 2), stdout);
    for (int count = 0; count < 30; count += 1)
        fwrite(wire, 1, motorlens_samples_f32(&sender, wire, 9, (uint32_t)count, 0, values, (uint8_t)count, 2), stdout);
    for (uint8_t piece = 0; (n = motorlens_hello(&sender, wire, 7, json, 1000, piece)) != 0; piece++)
        fwrite(wire, 1, n, stdout);
    fwrite(wire, 1, motorlens_status(&sender, wire, 8, 5000000000ull, 1, 2, 4000000000u), stdout);
    if (motorlens_samples_i16(&sender, wire, 3, 0, 0, codes, 60, 2) != 0) return 1;
    return 0;
}
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here")
def test_the_c_header_sends_the_same_bytes(tmp_path):
    (tmp_path / "main.c").write_text(PROGRAM)
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-fsanitize=undefined"]
    subprocess.run(
        ["gcc", *strict, f"-I{HEADER}", "main.c", "-o", "main"], cwd=tmp_path, check=True, timeout=600
    )
    ours = subprocess.run([tmp_path / "main"], capture_output=True, check=True, timeout=600).stdout
    k = np.arange(118)
    codes = (
        (k * k * 37 - 2000 * (k % 5 == 0)).astype(np.int64).astype(np.uint16).view(np.int16).reshape(-1, 2)
    )
    values = (np.arange(58, dtype=np.float32) / np.float32(7) - np.float32(3)).reshape(-1, 2)
    sequence = iter(range(65530, 65530 + 200))
    expected = [
        samples_frame(
            codes[:count], schema=3, sequence=next(sequence), t0_us=4294967000 + 10 * count, flags=2
        )
        for count in range(60)
    ]
    expected += [
        samples_frame(values[:count], schema=9, sequence=next(sequence), t0_us=count) for count in range(30)
    ]
    json = bytes(32 + k % 90 for k in range(1000))
    pieces = [json[at : at + 238] for at in range(0, 1000, 238)]
    expected += [
        encode(Frame(Kind.HELLO, next(sequence), 7, bytes((index, len(pieces))) + piece))
        for index, piece in enumerate(pieces)
    ]
    expected.append(
        status_frame(Status(5_000_000_000, 1, 2, 4_000_000_000), sequence=next(sequence), t0_us=8)
    )
    assert ours == b"".join(expected)


def test_the_document_names_what_the_code_does():
    text = (HEADER.parents[1] / "docs" / "wire-protocol.md").read_text()
    for n, rows in ((20, 1), (36, 5), (56, 10), (96, 20)):
        assert len(samples_frame(np.zeros((rows, 2), dtype=np.int16), schema=1, sequence=0, t0_us=0)) == n
        assert re.search(rf"n = {rows} \| {n} a frame", text)
    example = re.search(r"```json\n(.*?)```", text, re.DOTALL)
    assert example and Hello.from_json(example[1].encode()).device == "drive-7"
