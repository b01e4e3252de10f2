"""Errors and sensitivities of recordings at some parameters, weighed by the noise that was found in the recordings.

`Weighed` is the point at which `fit.minimise` stands; `points` makes them.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from motorlens_physics.conditions import Terminal
from motorlens_physics.estimate.innovations import Read, Sums, disturbances, read, sums
from motorlens_physics.estimate.input_noise import least_noise
from motorlens_physics.estimate.model import Model, as_shown, error_of
from motorlens_physics.estimate.noise import LOAD, OUTLIER, VOLTAGE, Noise
from motorlens_physics.estimate.noise_likelihood import changed_between, coloured, lasting, likelier, uneven
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.signals import smoothed
from motorlens_physics.sensitivity import Linearisation
from motorlens_physics.threads import on_all_cores

Array = NDArray[np.float64]

# Blocks of time between which the scatter of the scores is looked at, and how many each run has at least.
BLOCKS, LEAST_BLOCKS = 64, 8
# How often a parameter more may be taken for real where there is none.
CHANCE = 0.01


@dataclass(frozen=True)
class Frame:
    """A linearised motor through which the noise of the inputs is taken to reach the channels.

    Errors that are to be compared must hold the same noise. Were that of the inputs to go through each trial's own motor, a
    motor that responds less would have less of it, and be preferred.

    Attributes:
        model: the motor.
        run: with the corrected inputs, as they ran.
        r: its position.
        linear: the motor linearised along them.
    """

    model: Model
    run: Run
    r: int
    linear: Linearisation

    def error(self, difference: Array) -> Array:
        """(N, C) beside the inputs as recorded, from that beside the corrected ones."""
        return error_of(self.model, self.run, self.r, difference, self.linear)


@dataclass(frozen=True)
class Errors:
    """One run at some parameters.

    Attributes:
        run: with its corrected inputs.
        difference: (N, C) measured less shown along the corrected inputs.
        columns: (N, C, k) sensitivities along them, for the parameters that concern this run.
        mine: (k,) their positions.
        frame: the motor linearised along them.
        noise: of the run.
        used: (N, C) samples that count.
        error: (N, C) beside the inputs as recorded.
    """

    run: Run
    difference: Array
    columns: Array
    mine: tuple[int, ...]
    frame: Frame
    noise: Noise
    used: NDArray[np.bool_]
    error: Array

    @property
    def linear(self) -> Linearisation:
        """The linearised motor."""
        return self.frame.linear

    @cached_property
    def read(self) -> Read:
        """What its readings tell beside these errors."""
        return read(self.noise.space(self.frame.run, self.frame.linear, self.used), self.error)

    def sums(self, blocks: int) -> Sums:
        """Of white sensitivities and errors."""
        made = sums(self.read.space, self.read.filtered, self.columns, blocks)
        return replace(made, squares=self.squares())

    def squares(self) -> float:
        """Of white errors alone."""
        return float(np.sum(self.read.deviance))

    def with_rough_inputs(self, recorded: "Errors") -> "Errors":
        """With inputs as noisy at least as errors say that follow their roughness, seen along the inputs as `recorded`."""
        frame = recorded.frame
        least = least_noise(
            frame.model, recorded.run, frame.r, frame.linear, recorded.error, recorded.columns, self.used
        )
        return self if not least.any() else replace(self, noise=self.noise.followed(least))

    def with_duration(self) -> "Errors":
        """With an unmeasured torque that lasts as long as is likeliest."""
        response_s = self.frame.model.file.motor.response_s
        noise = lasting(self.noise, self.run, self.linear, self.error, self.used, response_s)
        return replace(self, noise=noise)

    def with_moments(self) -> "Errors":
        """With inputs that changed at any moment between samples, if that is likelier; itself if it is not."""
        noise = changed_between(self.noise, self.run, self.linear, self.error, self.used)
        return self if noise is self.noise else replace(self, noise=noise)

    def with_colour(self) -> "Errors":
        """With coloured noise, if that is likelier; itself if it is not."""
        response_s = self.frame.model.file.motor.response_s
        noise = coloured(self.noise, self.run, self.linear, self.error, self.used, response_s)
        # The torque lasted as long as the noise that it stood for.
        return self if noise is self.noise else replace(self, noise=noise).with_duration()

    def with_uneven_noise(self) -> "Errors":
        """With sensors as noisy as they are at each size of the voltage, if that is likelier; itself if it is not."""
        noise = uneven(self.noise, self.run, self.linear, self.error, self.used)
        return self if noise is self.noise else replace(self, noise=noise)

    def with_noise(self, updates: int, *, outliers: bool) -> "Errors":
        """With likelier noise, outliers left out if asked for, and the inputs' corrections expected under it."""
        noise, _ = likelier(self.noise, self.run, self.linear, self.error, self.used, updates)
        heard = read(noise.space(self.run, self.linear, self.run.there), self.error)
        used = self.run.there
        if outliers:
            used = used & (np.abs(heard.filtered.white[:, :, 0]) <= OUTLIER)
        seen, _, _ = disturbances(heard.space, heard.filtered)
        shown = _shown(self.run)
        # A load brakes: what the torque balance got too little, the load sensor showed too much.
        missed = as_shown(
            self.frame.model,
            self.run,
            noise.of_input(self.run, seen, VOLTAGE),
            -noise.of_input(self.run, seen, LOAD),
        )
        expected = shown + np.column_stack(missed)
        return replace(self, noise=noise, used=used, run=_corrected(self.run, noise, expected))


def _shown(run: Run) -> Array:
    """(N, 2) voltage and load torque as their sensors show them."""
    return np.column_stack([run.inputs.voltage_V, run.inputs.load_torque_Nm])


def without_noise(run: Run, noise: Noise) -> Run:
    """The run with its inputs corrected by what shows in them alone."""
    return _corrected(run, noise, _shown(run))


def noise_left(run: Run, noise: Noise, rng: np.random.Generator) -> Array:
    """(N, 2) what smoothing leaves of noise on the inputs of a run that have lost theirs, see `without_noise`."""
    quiet = _shown(run) + (0.0 if run.corrections is None else run.corrections)
    return _smoothed(run, noise, quiet + noise.drawn(run, rng)) - quiet


def _smoothed(run: Run, noise: Noise, inputs: Array) -> Array:
    """(N, 2) voltage and load torque of a run without the noise that shows in them."""
    white = noise.without_colour
    power = white.all_of(run)[None]
    return np.column_stack(
        [
            smoothed(u, sd=float(np.sqrt(white.of_input(run, power, which)[0])), lasting=lasting)
            for which, u, lasting in zip((VOLTAGE, LOAD), inputs.T, noise.lasting_of_inputs(run), strict=True)
        ]
    )


def _corrected(run: Run, noise: Noise, expected: Array) -> Run:
    """The run with its inputs corrected to what was expected (N, 2) of them, smoothed."""
    acted = _smoothed(run, noise, expected)
    corrections = acted - _shown(run)
    if run.inputs.terminal is not None:
        # Shorted terminals have no voltage to be measured wrongly.
        corrections[run.inputs.terminal != Terminal.DRIVEN, 0] = 0.0
    return run.corrected(corrections)


@dataclass(frozen=True)
class Weighed:
    """All runs at some parameters: a `Point`."""

    model: Model
    parts: tuple[Errors, ...]
    size: int
    inflation: float = 1.0

    @property
    def runs(self) -> tuple[Run, ...]:
        """With their corrected inputs."""
        return tuple(part.run for part in self.parts)

    @property
    def frames(self) -> list[Frame]:
        """In which other points are compared with this one: along its corrected inputs."""
        return [replace(part.frame, run=part.run) for part in self.parts]

    @cached_property
    def sums(self) -> list[Sums]:
        """Of each run, before the inflation."""
        samples = sum(len(part.error) for part in self.parts)

        def one(part: Errors) -> Sums:
            return part.sums(max(round(BLOCKS * len(part.error) / samples), LEAST_BLOCKS))

        return on_all_cores(one, self.parts)

    @cached_property
    def cost(self) -> float:
        """Whitened sum of squares, over the inflation."""
        squares = (
            (one.squares for one in self.sums)
            if "sums" in vars(self)
            else on_all_cores(Errors.squares, self.parts)
        )
        return sum(squares) / self.inflation

    def cost_in(self, other: "Weighed") -> float:
        """The whitened sum of squares of its errors, seen in the frames of another point."""
        return sum(on_all_cores(Errors.squares, self._in(other))) / self.inflation

    def products_in(self, other: "Weighed") -> tuple[Array, float]:
        """Its whitened errors times the sensitivities (k,) and times the errors of another point, seen in its frames."""

        def one(pair: tuple[Errors, Errors]) -> Array:
            part, there = pair
            columns = np.concatenate([there.columns, there.error[:, :, None]], axis=2)
            return np.asarray(sums(part.read.space, part.read.filtered, columns, 1).scores[0])

        products = np.zeros(self.size + 1)
        for part, scores in zip(
            other.parts, on_all_cores(one, zip(self._in(other), other.parts, strict=True)), strict=True
        ):
            products[[*part.mine, self.size]] += scores / self.inflation
        return products[:-1], float(products[-1])

    def _in(self, other: "Weighed") -> list[Errors]:
        """Its errors seen in the frames of another point."""
        return [
            replace(part, frame=frame, error=frame.error(part.difference))
            for part, frame in zip(self.parts, other.frames, strict=True)
        ]

    def tempered(self) -> "Weighed":
        """With an inflation by which blocks of time scatter more than their noise says, at least 1.

        What no noise explains has the same sign for long. Its samples are worth less than as many of noise, beside what is
        known of the parameters beforehand (Bissiri, Holmes and Walker 2016, doi:10.1111/rssb.12158).
        """
        return replace(self, inflation=max(self._scatter, 1.0))

    @property
    def scatters(self) -> bool:
        """Whether blocks of time scatter beyond chance."""
        spare = len(self.scores()) - 1
        return self._scatter > float(chdtri(spare, CHANCE)) / spare

    @property
    def _scatter(self) -> float:
        """How much more the scores of blocks of time scatter than their noise says, as the median parameter has it."""
        gram, scores = self.normal()[0] * self.inflation, self.scores()
        told = np.diagonal(gram) > 0
        scatter = np.sum((scores - scores.mean(axis=0)) ** 2, axis=0)[told] / np.diagonal(gram)[told]
        return float(np.median(scatter))

    def normal(self) -> tuple[Array, Array]:
        """J^T J and J^T e, over the inflation."""
        gram = np.zeros((self.size, self.size))
        for part, one in zip(self.parts, self.sums, strict=True):
            gram[np.ix_(part.mine, part.mine)] += one.gram
        return gram / self.inflation, self.scores().sum(axis=0) / self.inflation

    def scores(self) -> Array:
        """(B, k) sums of J^T e over blocks of time, before the inflation."""
        wide = []
        for part, one in zip(self.parts, self.sums, strict=True):
            wide.append(np.zeros((len(one.scores), self.size)))
            wide[-1][:, part.mine] = one.scores
        return np.concatenate(wide)
