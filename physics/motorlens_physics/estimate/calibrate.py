"""Calibration: the parameters of a motor from recordings, as a motor file that says what is known and what is not."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.delays import Delay, delays_of
from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.noise import TORQUE
from motorlens_physics.estimate.prepare import prepare_to_fit
from motorlens_physics.estimate.prior import (
    CALIBRATED,
    Prior,
    around,
    at_prior,
    base_prior,
    calibrated_on,
    held_to,
)
from motorlens_physics.estimate.report import Findings, correlation, findings
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import CHANCE
from motorlens_physics.make import believed, led_away, of_recordings
from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_physics.recording import Recording
from motorlens_runtime.errors import DataError, ModelError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class UnmeasuredTorque:
    """A torque on the shaft that nobody measured: its standard deviation, and how long it lasts."""

    sd_Nm: float
    lasts_s: float


@dataclass(frozen=True)
class Calibration:
    """What a calibration found.

    Attributes:
        estimate: the fit of all that was free.
        findings: what it says of each parameter, a brief recording believed as far as the make says, see `make`.
        file: the motor file with values, deviations and sources of what the recordings tell written in.
    """

    estimate: Estimate
    findings: Findings
    file: MotorFile

    @property
    def keys(self) -> tuple[str, ...]:
        """The free parameters of the motor file."""
        return self.findings.keys

    @property
    def value(self) -> Mapping[str, float]:
        """By key, with what is not told at its prior."""
        return self.findings.value

    @property
    def sd(self) -> Mapping[str, float]:
        """Standard deviation by key."""
        return self.findings.sd

    @property
    def unidentified(self) -> Mapping[str, str]:
        """What the recordings do not tell, by key, in words."""
        return self.findings.untold

    @property
    def confounded(self) -> tuple[str, ...]:
        """What they tell only together, in words."""
        return self.findings.confounded

    @property
    def runs(self) -> tuple[Run, ...]:
        """The recordings as they were fitted."""
        return self.estimate.runs

    @property
    def converged(self) -> bool:
        """Whether what was left to go is small against the deviations."""
        return self.estimate.converged

    @property
    def outliers(self) -> int:
        """Samples that were left out."""
        return self.estimate.outliers

    @property
    def held(self) -> tuple[bool, ...]:
        """Whether the voltage of each recording held between samples."""
        return tuple(way[0] for way in self.estimate.fit.model.held)

    @property
    def not_told(self) -> tuple[str, ...]:
        """Of which recordings it is open how the inputs ran between samples, in words."""
        return tuple(
            f"{run.name}: that its inputs {'held' if held else 'ran linearly'} between samples is not told: with "
            f"probability {chance:.2g} they did not; the deviations allow for that"
            for run, held, chance in zip(self.runs, self.held, self.estimate.otherwise, strict=False)
            if chance > CHANCE
        )

    @property
    def own(self) -> tuple[Mapping[str, float], ...]:
        """Of each recording, its start and what else is its own, see `model.Model`."""
        return self.estimate.fit.model.own

    @cached_property
    def residuals(self) -> tuple[Mapping[str, Array], ...]:
        """Of each recording, channel to measured less predicted (rows,)."""
        parts = zip(self.runs, self.estimate.fit.residuals, strict=True)
        return tuple({c: e[:, k] for k, c in enumerate(run.channels)} for run, e in parts)

    @property
    def residual_rms(self) -> tuple[Mapping[str, float], ...]:
        """Of each recording, channel to the root mean square of its residuals."""
        return tuple({c: float(np.sqrt(np.mean(e**2))) for c, e in one.items()} for one in self.residuals)

    @property
    def noise_sd(self) -> tuple[Mapping[str, float], ...]:
        """Of each recording, channel to the standard deviation of its sensor's white noise."""
        return tuple(
            dict(zip(run.channels, np.sqrt(run.noise.of_sensors(run)).tolist(), strict=True))
            for run in self.runs
            if run.noise is not None
        )

    @property
    def unmeasured_torques(self) -> tuple[UnmeasuredTorque, ...]:
        """Of each recording, the torque that nobody measured, beside which the motor was fitted."""
        return tuple(
            UnmeasuredTorque(float(np.sqrt(run.noise.disturbances[TORQUE])), float(run.noise.lasts_s[TORQUE]))
            for run in self.runs
            if run.noise is not None
        )

    @property
    def delays(self) -> tuple[Delay, ...]:
        """Channels that come late, or early."""
        return delays_of(self.estimate.fit, self.runs)

    def as_json(self, recordings: Sequence[Recording]) -> dict[str, object]:
        """For the command's JSON."""
        said = self.findings
        loads = [own["load"] for own in self.own if "load" in own]
        return {
            "recordings": [recording.name for recording in recordings],
            "parameters": {
                key: {"value": self.value[key], "sd": self.sd[key], "unit": self.file.meaning(key).unit,
                      "identified": key not in said.untold}
                for key in self.keys
            },
            "correlation": {"keys": list(self.keys), "matrix": correlation(self.estimate.fit, self.keys).tolist()},
            "unidentified": list(said.untold.values()),
            "confounded": list(said.confounded),
            "at_bound": list(said.at_bound.values()),
            "far": list(said.far.values()),
            "residual_rms": [dict(one) for one in self.residual_rms],
            "noise_sd": [dict(one) for one in self.noise_sd],
            "unmeasured_torque": [asdict(one) for one in self.unmeasured_torques],
            "initial": [
                {name[8:]: value for name, value in own.items() if name.startswith("initial.")} for own in self.own
            ],
            "load_torque_Nm": loads,
            "between_rows": ["hold" if held else "linear" for held in self.held],
            "between_rows_otherwise": list(self.estimate.otherwise),
            "delays": [
                {"recording": d.recording, "channel": d.channel, "value_s": d.value_s, "sd_s": d.sd_s}
                for d in self.delays
            ],
            "outliers": self.outliers,
            "converged": self.converged,
        }  # fmt: skip


def calibrate(
    file: MotorFile,
    recordings: Sequence[Recording],
    keys: Sequence[str] | None = None,
    *,
    held: bool | None = None,
    fit_load: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> Calibration:
    """Fit parameters to recordings jointly.

    Args:
        file: the motor, with what is known of it; deviations stated there are priors.
        recordings: any subset of current, speed and temperature measured; rates may differ. Load torque absent is zero.
        keys: of parameters of motor, effects and sensors; None is all that are not known exactly.
        held: whether inputs hold between samples or run linearly; None takes what is likelier.
        fit_load: whether each recording has an unknown constant load torque besides what was recorded.
        progress: told what goes on.

    Raises:
        DataError: recordings that cannot be used, or that tell nothing.
        ModelError: unknown or fixed parameters, or a motor that cannot be simulated where it starts.
    """
    if not recordings:
        raise ModelError("calibration needs at least one recording")
    away = led_away(file, sum(float(recording.time_s[-1] - recording.time_s[0]) for recording in recordings))
    known_before, file = file, of_recordings(file, away)
    runs = prepare_to_fit(recordings, file)
    names = ", ".join(recording.name for recording in recordings)
    if not any(run.moves for run in runs):
        raise DataError(f"{names}: nothing can be told; no current, speed or temperature ever changes")
    prior = chosen(file, base_prior(file, runs), keys)
    begin = start_model(at_prior(file, prior), runs)
    if fit_load:
        for r in range(len(runs)):
            prior = prior.joined(around(f"load@{r}", 0.0, file.rated.torque_Nm))
            begin = begin.with_values({f"load@{r}": 0.0})
    found = estimate(file, runs, prior, held=held, begin=begin, progress=progress)
    said = findings(found.fit)
    if not said.told:
        raise DataError(f"{names}: nothing can be told; the recordings leave every parameter where it was")
    value, sd = believed(known_before, away, said.value, said.sd)
    said = replace(said, value=value, sd=sd)
    known = {key: _learnt(known_before, key, sd[key], recordings) for key in said.told}
    return Calibration(found, said, known_before.with_values({key: value[key] for key in said.told}, known))


def _learnt(file: MotorFile, key: str, sd: float, recordings: Sequence[Recording]) -> Knowledge:
    """What is known of a parameter of a motor file after it was calibrated, and was before any of the recordings."""
    known = held_to(file, key, frozenset(recording.name for recording in recordings))
    # What was learnt from other recordings is in it as well: all are named, and what was stated before all of them is kept.
    names = dict.fromkeys((*calibrated_on(known), *(recording.name for recording in recordings)))
    prior = file.knowledge[key].prior if calibrated_on(known) else known
    return Knowledge(sd, CALIBRATED + ", ".join(names), prior=prior)


def chosen(file: MotorFile, prior: Prior, keys: Sequence[str] | None) -> Prior:
    """The prior of some parameters of the motor file, and of all nuisances.

    Raises:
        ModelError: a parameter that is not there, or that is stated by choice or exactly.
    """
    if keys is None:
        return prior
    for key in keys:
        if key not in file.values():
            raise ModelError(f"cannot fit {key!r}: {file.name} has {', '.join(file.values())}")
        if file.meaning(key).fixed:
            raise ModelError(f"cannot fit {key!r}: it is stated by choice, not found from recordings")
        if key not in prior.keys:
            raise ModelError(f"cannot fit {key!r}: the motor file states it exactly (sd = 0)")
    return prior.only([key for key in prior.keys if "@" in key or key in keys])
