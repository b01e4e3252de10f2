"""What was left out of a recording or taken otherwise than as recorded, in words that are the same in every command."""

from collections.abc import Mapping, Sequence

from motorlens_physics.estimate.run import UNIT_OF, Run
from motorlens_physics.recording import said_once


def notes_of(runs: Sequence[Run]) -> list[str]:
    """One sentence each, none if the recordings were taken as they are."""
    return said_once((run.name, note) for run in runs for note in (*_left_out(run), *_taken(run)))


def _left_out(run: Run) -> list[str]:
    said = []
    for channel, step in run.coarse.items():
        stays = (
            f"stays within one step of its converter, {step:.3g} {UNIT_OF[channel]}"
            if step
            else "never changes"
        )
        said.append(f"the {channel} {stays}: that tells of its sensor and not of the motor; it was left out.")
    if run.saturated:
        said.append(f"left out, at the end of the converter's range: {_counted(run.saturated)}.")
    if run.repeats:
        said.append(
            f"left out, the one before again to all digits and so no new readings: {_counted(run.repeats)}."
        )
    if run.spikes:
        said.append(f"left out, alone as no motor makes or follows them: {_counted(run.spikes)}.")
    return said


def _taken(run: Run) -> list[str]:
    said = []
    if run.bare:
        said.append(
            "a load torque of exactly 0 throughout says that nothing is on the shaft: what torque is missing is the motor's "
            "own."
        )
    if run.mean_speed and not run.from_angle:
        said.append(
            "each speed is taken as the mean since the sample before, as one that is counted from an encoder is; the "
            "recording is likelier so."
        )
    voltage, load = run.noise.between if run.noise is not None else (False, False)
    if voltage:
        said.append(
            "the voltage changes between samples, not at them, as the command of another program does. When within a sample "
            "is not known: what follows a change tells of the motor only as far as that does not matter. The recording is "
            "likelier so."
        )
    if load:
        said.append(
            "the load torque changes between samples, not at them, as that of a brake does once the rotor turns. What "
            "follows a change tells of the motor only as far as its moment does not matter. The recording is likelier so."
        )
    if run.hum:
        told = " and ".join(
            f"{amplitude:.2g} {UNIT_OF[channel]} at {frequency:.5g} Hz out of the {channel}"
            for (channel, frequency), amplitude in run.hum.items()
        )
        said.append(f"hum of the mains was taken out, {told}.")
    return said


def _counted(samples: Mapping[str, int]) -> str:
    return " and ".join(
        f"{count} sample{'s' if count > 1 else ''} of {name}" for name, count in samples.items()
    )
