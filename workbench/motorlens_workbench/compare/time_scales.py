"""At which pace a model fails: the error's power by time scale of the motor, and by order of the shaft."""

from collections.abc import Sequence

import numpy as np

from motorlens_physics.scenario import TimeConstants
from motorlens_workbench.compare.overlay import Overlay


def bands_of(channel: str, overlays: Sequence[Overlay], pace: TimeConstants) -> dict[str, float]:
    """Share of the error's power by time scale; the borders are the geometric means between the motor's time constants."""
    borders = (
        1 / (2 * np.pi * np.sqrt(pace.mechanical_s * pace.thermal_s)),
        1 / (2 * np.pi * np.sqrt(pace.electrical_s * pace.mechanical_s)),
    )
    power = {"thermal": 0.0, "mechanical": 0.0, "electrical": 0.0}
    for o in overlays:
        if channel not in o.run.channels:
            continue
        frequency, density = o.spectrum(channel)
        band = np.searchsorted(borders, frequency)
        for k, name in enumerate(power):
            power[name] += float(density[band == k].sum())
    whole = sum(power.values())
    return {name: value / whole if whole > 0 else 0.0 for name, value in power.items()}


def orders_of(
    overlays: Sequence[Overlay], highest: int = 60, fewest_turns: float = 3.0
) -> tuple[tuple[float, float], ...]:
    """The strongest whole orders of the shaft in the speed error, where the shaft's angle was measured."""
    found = np.zeros(highest)
    counted = 0
    for o in overlays:
        angle = o.run.angle
        if angle is None or "speed" not in o.run.channels:
            continue
        if abs(angle[-1] - angle[0]) < 2 * np.pi * fewest_turns:
            continue
        error = o.error_of("speed")
        waves = np.exp(-1j * np.outer(np.arange(1, highest + 1), angle))
        found += np.abs(waves @ error) * 2 / len(error)
        counted += 1
    if not counted:
        return ()
    strongest = np.argsort(-found)[:3]
    return tuple((float(k + 1), float(found[k] / counted)) for k in strongest)
