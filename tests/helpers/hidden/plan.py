"""Which cases a split holds, drawn from its seed: the strata of the benchmark, before anything is simulated."""

from dataclasses import replace
from typing import Any

import numpy as np
from helpers.hidden import effects as hidden_effects
from helpers.hidden.excitation import EXCITATIONS
from helpers.hidden.motors import MOTORS
from helpers.hidden.world import CHANNEL_SETS, Case

# Seeds of the splits lie apart; `subset` is what `make test` runs and comes from the seed of none of the others.
SEEDS = {"dev": 20_261_121, "test": 71_940_268, "subset": 5_318_008}
SHARES = {"none": 0.25, "pair": 0.15, "outside": 0.15}
NOISES = (
    (0.002, "white"),
    (0.01, "white"),
    (0.03, "white"),
    (0.01, "coloured"),
    (0.002, "12bit"),
    (0.002, "10bit"),
)
# Pairs of which the second is (nearly) the first: not drawn together.
_TWINS = (
    {"constant_torque", "load_torque_sensor_offset"},
    {"brush_voltage_drop", "dead_time"},
    {"coulomb_friction", "hysteresis_iron_loss", "directional_friction"},
    {"iron_loss_torque", "temperature_dependent_viscosity"},
    {"temperature_sensor_gain", "temperature_sensor_offset", "ambient_drift"},
    {f"{channel}_sensor_gain" for channel in hidden_effects.CHANNELS},
)


def draw(split: str, n: int, small: bool = False) -> list[Case]:
    """The `n` cases of a split. The first n of a longer plan are not those of a shorter one: n is part of the plan."""
    rng = np.random.default_rng([SEEDS[split], n, int(small)])
    counts = {kind: round(share * n) for kind, share in SHARES.items()}
    counts["single"] = n - sum(counts.values())
    kinds = rng.permutation([kind for kind, count in sorted(counts.items()) for _ in range(count)])
    names = (*hidden_effects.CATALOGUE, *hidden_effects.SENSOR_NAMES)
    singles = _deck(rng, [(name, factor) for name in names for factor in (1.0, 3.0, 10.0)], n)
    outside = _deck(rng, [(name, factor) for name in hidden_effects.OUTSIDE for factor in (3.0, 10.0)], n)
    motors, noises = _deck(rng, list(MOTORS), n), _deck(rng, list(NOISES), n)
    excitations = _deck(rng, ["rich", *EXCITATIONS], n)
    channels = _deck(rng, ["all", *CHANNEL_SETS], n)
    records = _deck(rng, ["fast", "slow", "both", "both"], n)
    cases = []
    for number in range(n):
        kind = str(kinds[number])
        if kind == "single":
            hidden = [singles.pop()]
        elif kind == "outside":
            hidden = [outside.pop()]
        elif kind == "pair":
            hidden = [(name, float(rng.choice((5.0, 10.0)))) for name in _two(rng, names)]
        else:
            hidden = []
        noise, noise_kind = noises.pop()
        case = Case(
            id=f"{split}-{number:04d}", seed=int(rng.integers(1 << 62)), motor=motors.pop(), kind=kind,
            hidden=tuple(hidden), noise=noise, noise_kind=noise_kind, records=records.pop(),
            excitation=excitations.pop(), channels=channels.pop(), pwm_ripple=bool(rng.random() < 0.25),
            stamped=bool(rng.random() < 0.5), small=small,
        )  # fmt: skip
        cases.append(fitting(case, rng))
    return cases


def _deck(rng: np.random.Generator, items: list[Any], n: int) -> list[Any]:
    """At least n items in which each comes up as often as any other, shuffled deck by deck."""
    deck: list[Any] = []
    while len(deck) < n:
        deck += [items[k] for k in rng.permutation(len(items))]
    return deck


def _two(rng: np.random.Generator, names: tuple[str, ...]) -> tuple[str, str]:
    while True:
        one, other = (str(name) for name in rng.choice(names, 2, replace=False))
        needs = needs_of(one) | needs_of(other)
        if not any({one, other} <= twins for twins in _TWINS) and not {"heat", "fast_only"} <= needs:
            return one, other


def needs_of(name: str) -> set[str]:
    """What the record of an effect or fault must hold (see `HiddenEffect.needs`), and the channel of a faulty sensor."""
    motor = next(iter(MOTORS.values()))
    entry = hidden_effects.lookup(name, motor)
    return set(entry.needs) | ({f"channel {entry.equation}"} if ":" in entry.key else set())


def fitting(case: Case, rng: np.random.Generator) -> Case:
    """The case with record, excitation and channels redrawn where they could not show what is hidden at all."""
    needs = set().union(*(needs_of(name) for name, _ in case.hidden)) if case.hidden else set()
    wanted = {need.removeprefix("channel ") for need in needs if need.startswith("channel ")}
    if "load" in needs:
        wanted.add("load_torque")
    if "angle" in needs:
        wanted.add("speed")
    records = ["fast"] if "fast_only" in needs else [
        name for name in ("fast", "slow", "both")
        if not ("heat" in needs and name == "fast") and not ("fast" in needs and name == "slow")
    ]  # fmt: skip
    excitations = [
        name for name in EXCITATIONS
        if not (name == "near_standstill" and needs & {"heat", "load"})
        and not (name == "one_direction" and "reversal" in needs)
    ]  # fmt: skip
    channels = [name for name, held in CHANNEL_SETS.items() if wanted <= set(held)]

    def choose(value: str, allowed: list[str]) -> str:
        return value if value in allowed else str(rng.choice(allowed))

    return replace(
        case, records=choose(case.records, records), excitation=choose(case.excitation, excitations),
        channels=choose(case.channels, channels),
    )  # fmt: skip


def best(case: Case) -> Case:
    """The case as a good engineer would measure it: every channel, both directions, fast and slow, little noise."""
    needs = set().union(*(needs_of(name) for name, _ in case.hidden)) if case.hidden else set()
    records = "fast" if "fast_only" in needs else "both"
    return replace(case, records=records, excitation="rich", channels="all", noise=0.002, noise_kind="white")
