"""What is recovered of a population that is known, and what is odd in it."""

import time
from pathlib import Path

import numpy as np
from fleet_studies.plant import BREAKS, HEATED_S, fleet, make_file
from helpers.plain_fleet import SPREAD, TYPICAL, World


def population(place: Path, motors: int, seed: int, workers: int) -> None:
    """Means, spreads, intervals of single motors, and the broken ones, against the truth."""
    broken = {40 * k + 13: BREAKS[k % len(BREAKS)] for k in range(max(motors // 40, 1))}
    world = World(motors, 5, broken=broken, heated_s=HEATED_S)
    world.write(place / "plant", seed)
    begun, spent = time.monotonic(), time.process_time()
    found = fleet(place / "plant", make_file(place / "make.toml"), place / "out", "--workers", str(workers))
    print(f"{motors} motors, {5 * motors} recordings: {time.monotonic() - begun:.0f} s on {workers or 1} workers"
          + (f", {time.process_time() - spent:.0f} s of processor time" if workers == 0 else ""))  # fmt: skip
    truth = {f"motor_{m:03d}": world.motor(m, seed) for m in range(motors)}
    sound = [m for m in found["motors"] if int(m["motor"][-3:]) not in broken]
    inside, scarce = [], []
    for key, what in found["population"].items():
        if key not in TYPICAL:
            continue
        actual = np.array([truth[m["motor"]][key] for m in sound])
        own = [m["parameters"][key] for m in sound]
        covered = [
            low <= x <= high for x, o in zip(actual, own, strict=True) for low, high in [o["interval_95"]]
        ]
        narrower = np.array([o["sd"] / m["alone"][key] for o, m in zip(own, sound, strict=True)])
        # Poor data: a motor's own recordings tell it worse than knowing that it is one of the make.
        poor = np.array([m["alone"][key] for m in sound]) > SPREAD[key] * np.mean(actual)
        seen = what["between_motors"] > 0
        inside += covered if seen else []
        scarce += narrower[poor].tolist()
        # Of the make itself, and of the motors that were drawn of it: what they are off by themselves, no fit can know.
        drawn = np.exp(np.mean(np.log(actual)))
        off, of_drawn = (what["value"] - np.array([TYPICAL[key], drawn])) / what["sd"]
        spread = f"{what['between_motors']:.4f} +- {what['between_motors_sd']:.4f}" if seen else "not told"
        print(f"  {key:6} mean {off:+5.2f} sd off ({what['sd'] / what['value']:.2%}; {of_drawn:+5.2f} of the motors drawn); "
              f"spread {spread} ({np.std(actual, ddof=1) / np.mean(actual):.4f} true); {np.mean(covered):6.1%} of motors "
              f"inside; sd {np.median(narrower):.2f} of alone"
              + (f", {np.median(narrower[poor]):.2f} where poor ({np.mean(poor):.0%})" if any(poor) else ""))  # fmt: skip
    print(f"  95 % intervals, parameters whose spread is told: {np.mean(inside):.1%} of {len(inside)} hold the truth; "
          f"where data are poor they are {1 - np.median(scarce):.0%} narrower than alone")  # fmt: skip
    order = sorted(found["motors"], key=lambda m: -m["oddness"])
    first = [m["motor"] for m in order[: len(broken)]]
    hits = sum(int(name[-3:]) in broken for name in first)
    odd = [m["motor"] for m in found["motors"] if m["odd"]]
    strangers = [name for name in odd if int(name[-3:]) not in broken]
    print(
        f"  broken: {hits} of {len(broken)} are ranked first; said to be odd: {len(odd)}, {len(strangers)} of them are not"
    )
    for m in order[: len(broken) + 1]:
        print(f"    {m['motor']} {m['oddness']:.1f} {[d['parameter'] for d in m['differences']]}")


def told_apart(place: Path, motors: int, seed: int, workers: int) -> None:
    """All have a drop at the brushes; one in ten drags."""
    drags = {m: {"tau_c": 0.4} for m in range(7, motors, 10)}
    World(motors, 5, make={"V_b": 1.0}, broken=drags, poor=0).write(place / "plant", seed)
    found = fleet(place / "plant", make_file(place / "make.toml"), place / "out", "--workers", str(workers))
    print(f"effects of all, of {motors} motors: {[e['parameter'] for e in found['effects_of_the_make']]}")
    right = 0
    for m in found["motors"]:
        named = {name for d in m["differences"] for name in (d["parameter"], *d["alike"])}
        drag = int(m["motor"][-3:]) in drags
        right += "coulomb_friction.tau_c" in named if drag else not named
    print(f"  effect of one told from that of all: {right} of {motors} motors")
