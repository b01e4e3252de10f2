"""Frames on a bad line: every kind of damage, and what the decoder makes of it. Part 2 of `hil.py`."""

import time
from collections.abc import Callable

import numpy as np

from motorlens_firmware_sim import faults
from motorlens_runtime.line.framing import MAX_BODY, Decoder, samples_frame


def damages(rng: np.random.Generator, chunk: int) -> dict[str, Callable[[bytes], bytes]]:
    """What is done to the bytes of `chunk` frames, by name."""
    return {
        "bit errors 1e-5": lambda d: faults.flip_bits(d, 1e-5, rng),
        "bit errors 1e-4": lambda d: faults.flip_bits(d, 1e-4, rng),
        "bit errors 1e-3": lambda d: faults.flip_bits(d, 1e-3, rng),
        "bytes dropped": lambda d: faults.drop_bytes(d, 1e-3, rng),
        "bytes inserted": lambda d: faults.insert_bytes(d, 1e-3, rng),
        "bytes doubled": lambda d: faults.repeat_bytes(d, 1e-3, rng),
        "bytes swapped": lambda d: faults.swap_bytes(d, 1e-3, rng),
        "bursts": lambda d: faults.burst(d, 300, chunk // 100, rng),
        "line stuck": lambda d: stuck(d, rng),
        "frames cut, doubled, exchanged": lambda d: shuffled(d, rng),
    }


def injected(total: int) -> list[tuple[str, bool]]:
    """All kinds of damage to `total` frames; everything accepted is compared with what was sent."""
    rng = np.random.default_rng(1)
    chunk = min(total // 10, 50_000)
    kinds = damages(rng, chunk)
    gates, accepted_all, bad_all, started = [], 0, 0, time.process_time()
    longest = 0
    for name, damage in kinds.items():
        wrong = missing = accepted = bad = frames = 0
        for first in range(0, total // len(kinds), chunk):
            codes = rng.integers(-2048, 2048, (chunk, 5, 2)).astype(np.int16)
            wire = [
                samples_frame(rows, schema=1, sequence=(first + k) & 0xFFFF, t0_us=first + k)
                for k, rows in enumerate(codes)
            ]
            clean = b"".join(wire)
            noisy = damage(clean)
            decoder, runs = Decoder(), []
            for at in range(0, len(noisy), 1 << 16):
                runs += decoder.feed(noisy[at : at + (1 << 16)])
                longest = max(longest, len(decoder._rest))
            index = np.concatenate([run.t0_us.astype(np.int64) - first for run in runs])
            for run in runs:
                k = run.t0_us.astype(np.int64) - first
                inside = (k >= 0) & (k < chunk)
                content = np.ascontiguousarray(run.payload[:, 2:]).view("<i2").reshape(len(run), -1)
                right = inside & (run.kind == 2) & (content.shape[1] == 10)
                right &= (
                    (content == codes.reshape(chunk, -1)[np.clip(k, 0, chunk - 1)]).all(axis=1)
                    if content.shape[1] == 10
                    else False
                )
                wrong += int((~right).sum())
            if len(noisy) == len(clean) and not name.startswith("frames"):
                missing += len(np.setdiff1d(untouched(clean, noisy, wire), index))
            accepted, bad, frames = accepted + len(index), bad + decoder.bad_frames, frames + chunk
        print(
            f"{name}: {frames} frames, {accepted} accepted, {bad} damaged pieces, {wrong} wrong, {missing} good ones missed"
        )
        gates += [
            (f"{name}: nothing wrong accepted", wrong == 0),
            (f"{name}: back at the next delimiter", missing == 0),
        ]
        accepted_all, bad_all = accepted_all + accepted, bad_all + bad
    print(
        f"{accepted_all} frames accepted, {bad_all} damaged, {time.process_time() - started:.0f} s of processor time"
    )
    return [*gates, ("bounded memory", longest <= MAX_BODY), ("there were faults", bad_all > total // 100)]


def untouched(clean: bytes, noisy: bytes, wire: list[bytes]) -> np.ndarray:
    """Frames of which no byte, nor the zero before them, was changed."""
    changed = np.frombuffer(clean, dtype=np.uint8) != np.frombuffer(noisy, dtype=np.uint8)
    total = np.concatenate(([0], np.cumsum(changed)))
    ends = np.cumsum([len(frame) for frame in wire])
    starts = np.concatenate(([0], ends[:-1] - 1))
    return np.flatnonzero(total[ends] == total[starts])


def stuck(data: bytes, rng: np.random.Generator) -> bytes:
    """Stretches of a line that is held low or high."""
    stream = np.frombuffer(data, dtype=np.uint8).copy()
    for start in rng.integers(0, len(stream) - 5000, 50):
        stream[start : start + rng.integers(1, 5000)] = rng.choice([0x00, 0xFF, 0x55])
    return stream.tobytes()


def shuffled(data: bytes, rng: np.random.Generator) -> bytes:
    """Frames cut short, sent twice, or exchanged with the next."""
    frames = data.split(b"\0")[:-1]
    out = []
    for k, frame in enumerate(frames):
        chance = rng.random()
        if chance < 0.01:
            out.append(frame[: rng.integers(1, len(frame))])
        elif chance < 0.02:
            out += [frame, frame]
        elif chance < 0.03 and k:
            out.insert(-1, frame)
        else:
            out.append(frame)
    return b"\0".join(out) + b"\0"
