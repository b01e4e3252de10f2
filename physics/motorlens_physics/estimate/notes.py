"""What was left out of a recording or taken otherwise than as recorded, in words that are the same in every command."""

from collections.abc import Mapping

from motorlens_physics.estimate.run import UNIT_OF, Run


def notes_of(run: Run) -> list[str]:
    """One sentence each, none if the recording was taken as it is."""
    return [f"{run.name}: {note}" for note in (*_left_out(run), *_taken(run))]


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
        said.append(f"{_counted(run.saturated)} lie at the end of the converter's range; they were left out.")
    if run.repeats:
        said.append(
            f"{_counted(run.repeats)} are the one before again, to all digits: no new readings; they were left out."
        )
    if run.spikes:
        said.append(
            f"{_counted(run.spikes)} stand alone, as no motor makes or follows them; they were left out."
        )
    return said


def _taken(run: Run) -> list[str]:
    said = []
    if run.mean_speed and not run.from_angle:
        said.append(
            "each speed is taken as the mean since the sample before, as one that is counted from an encoder is; the "
            "recording is likelier so."
        )
    if run.noise is not None and run.noise.between:
        said.append(
            "the voltage changes at any moment between two samples, and not at one of them: of what follows a change that "
            "tells of the motor which its moment does not; the recording is likelier so."
        )
    if run.hum:
        told = " and ".join(
            f"{amplitude:.2g} {UNIT_OF[channel]} at {frequency:.5g} Hz out of the {channel}"
            for (channel, frequency), amplitude in run.hum.items()
        )
        said.append(f"hum of the mains was taken out, {told}.")
    return said


def _counted(samples: Mapping[str, int]) -> str:
    return " and ".join(f"{count} samples of {name}" for name, count in samples.items())
