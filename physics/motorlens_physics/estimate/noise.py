"""The noise of a recording, as it is in the recording: of its sensors, of its measured inputs, and a slow torque.

What a sensor shows too much may be another error at every sample, and coloured besides: a filtered speed, a transducer that
wanders. Coloured noise is a first-order autoregression, a state of its own in the filter that makes errors white. How large
the errors are may differ with how hard the motor is driven: the ripple that a converter leaves on a current is largest in
the middle of its range.

Nothing of it is assumed. The errors of a simulation are whatever the sensors' noise, the inputs' noise and an unmeasured
torque leave in all channels through the motor (`innovations`); the variances under which those errors are most likely are
their maximum-likelihood estimates. Noise that was truly applied to the motor, such as a dither, leaves no error, and so
counts as none.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.innovations import StateSpace, share_that_remains
from motorlens_physics.estimate.mean_speed import MEAN, with_mean
from motorlens_physics.estimate.run import STATE_OF, Run
from motorlens_physics.estimate.signals import (
    NOTHING_LASTS,
    Lasting,
    coloured_sd,
    decaying,
    most_noise_sd,
    noise_sd,
)
from motorlens_physics.sensitivity import Linearisation

Array = NDArray[np.float64]

# The disturbances: voltage and load as measured, and a torque that nobody measured; the balance that each enters.
BALANCES = np.array([0, 1, 1])
VOLTAGE, LOAD, TORQUE = range(3)
# Those of coloured noise, if there are any; and what may pass for physics that is missing, or the other way round.
COLOURED, UNEXPLAINED = slice(3, None), slice(2, None)
# The measured inputs, by their positions; a channel of a run comes after them.
INPUTS = ("voltage", "load_torque")
# How long the unmeasured torque may last, in samples; it begins with the second.
LASTS = (30.0, 300.0, 3000.0)
# The unmeasured torque begins as this share of the rated one.
SMALL_TORQUE = 0.01
# Disturbances are followed down to this share of their largest.
SMALLEST = 1e-8
# Variances are believed down to this many tolerances of the simulation, as shares of the channel's mean square. Its own
# errors are less than a twentieth of such a deviation (`test_estimate_innovations.py`); smooth friction is off by more
# where a rotor stops. With the square of the tolerance, to the same at its finest, a coarse simulation would drown the
# step of an encoder (`test_estimate_prior.py`). In a channel that shows nothing, down to a millionth of an ampere, rad/s
# or kelvin, squared.
LEAST, TINY = 1e-4, 1e-12
# The levels of a converter are no more even than this share of a step: its differential nonlinearity.
UNEVEN_LEVELS = 0.1
# Coloured noise has no more than this many times the variance that shows.
MOST_OF_LOOKS = 1.5
# A command that may have changed at any moment of a sample was, on the average over those moments, wrong by so much of its
# change, squared.
AT_ANY_MOMENT = 1 / 3
# Groups of samples, by equal parts of the largest size of the voltage, in which sensors may be more noisy or less; and how
# many samples of a group tell a variance, within a fifth of it. In a tenth of the range the ripple still falls by too much:
# with ten groups `test_estimate_uneven_noise.py` fails.
GROUPS, TELL = 20, 50
# An innovation beyond this many standard deviations is no noise: one in two million would be.
OUTLIER = 5.0


@dataclass(frozen=True)
class Noise:
    """The noise of one recording.

    Attributes:
        sensors: (C, K) variance of each sensor's white noise, in its unit squared, before its converter, in each of K groups
            of samples by the size of the voltage.
        disturbances: (3,) variance of the voltage's (V^2) and the load's white noise and of the slow torque ((N m)^2); or
            (5 + C,), followed by those of the coloured noise, of the voltage, the load and each channel.
        most: the largest that each can be: a measured input is no noisier than it looks.
        lasts_s: how long each lasts; 0 is white.
        floor: (C,) smallest variance that is believed: what a converter's levels are uneven by, or the integration's error.
        least: the smallest that each disturbance can be: an input is as noisy as the errors that follow its roughness say.
        between: whether the voltage and the load may have changed at any moment between two samples, not at one of them.
        edges_V: (K - 1,) sizes of the voltage that part the groups.
    """

    sensors: Array
    disturbances: Array
    most: Array
    lasts_s: Array
    floor: Array
    least: Array
    between: tuple[bool, bool] = (False, False)
    edges_V: Array = field(default_factory=lambda: np.zeros(0))

    def group(self, run: Run) -> NDArray[np.int64]:
        """(N,) which group each sample of a run is of."""
        return np.searchsorted(self.edges_V, np.abs(run.inputs.voltage_V), side="right")

    def of_samples(self, run: Run) -> Array:
        """(N, C) variance of the sensors' white noise."""
        return np.asarray(self.sensors.T[self.group(run)])

    def of_sensors(self, run: Run) -> Array:
        """(C,) mean variance of the sensors' white noise."""
        return np.asarray(self.of_samples(run).mean(axis=0))

    def uneven(self, run: Run) -> "Noise":
        """With variances of their own in the groups of samples that a run has, see `GROUPS` and `TELL`."""
        sizes = np.sort(np.abs(run.inputs.voltage_V))
        edges_V: list[float] = []
        for edge_V in (sizes[-1] * np.arange(1, GROUPS) / GROUPS).tolist():
            below, above = (np.searchsorted(sizes, size_V) for size_V in ([0.0, *edges_V][-1], edge_V))
            if min(above - below, len(sizes) - above) >= TELL:
                edges_V.append(edge_V)
        made = replace(self, edges_V=np.array(edges_V))
        groups, known = made.group(run), self.of_samples(run)
        sensors = np.array([known[groups == group].mean(axis=0) for group in range(len(edges_V) + 1)]).T
        return replace(made, sensors=sensors)

    def within(self, sensors: Array, disturbances: Array) -> "Noise":
        """With other variances (C, K) and (3,), as far as they are believed."""
        least = np.minimum(np.maximum(SMALLEST * self.most, self.least), self.most)
        return replace(
            self,
            sensors=np.maximum(sensors, self.floor[:, None]),
            disturbances=np.clip(disturbances, least, self.most),
        )

    def followed(self, variances: Array) -> "Noise":
        """With inputs that are as noisy as these variances (2,) at least, V^2 and (N m)^2."""
        least = np.zeros_like(self.least)
        least[:TORQUE] = variances
        return replace(self, least=least).within(self.sensors, self.disturbances)

    def like(self, other: "Noise", run: Run) -> "Noise":
        """As another found it in a piece of the same recording; where it is uneven, in the groups that all of it has."""
        alike = replace(
            self,
            disturbances=np.append(self.disturbances, other.disturbances[COLOURED]),
            most=np.append(self.most, other.most[COLOURED]),
            lasts_s=other.lasts_s,
            least=other.least,
            between=other.between,
            edges_V=other.edges_V,
        )
        alike = alike.within(other.sensors, other.disturbances)
        return alike.uneven(run) if other.edges_V.size else alike

    def lasting(self, lasts_s: float) -> "Noise":
        """With an unmeasured torque that lasts so long."""
        durations = self.lasts_s.copy()
        durations[TORQUE] = lasts_s
        return replace(self, lasts_s=durations)

    def with_small_torque(self, run: Run, samples: float) -> "Noise":
        """With an unmeasured torque as small as `first_noise` begins with, that lasts so many samples."""
        variance = self.disturbances.copy()
        variance[TORQUE] = SMALL_TORQUE**2 * self.most[TORQUE]
        return replace(self, disturbances=variance).lasting(samples * run.period_s)

    def correlated(self, lasts_s: float) -> "Noise":
        """With coloured noise that lasts so long."""
        durations = self.lasts_s.copy()
        durations[COLOURED] = lasts_s
        return replace(self, lasts_s=durations)

    def coloured(self, run: Run, error: Array, samples: float) -> "Noise":
        """With coloured noise besides, as much as an input looks, and the error (N, C) of a channel."""
        shown = (run.inputs.voltage_V, run.inputs.load_torque_Nm)
        steps = (*run.input_step, *run.steps)
        looks = [
            coloured_sd(y, samples, step) ** 2 for y, step in zip((*shown, *error.T), steps, strict=True)
        ]
        return replace(
            self,
            disturbances=np.append(self.disturbances, looks),
            most=np.append(self.most, MOST_OF_LOOKS * np.array(looks)),
            lasts_s=np.append(self.lasts_s, np.full(len(looks), samples * run.period_s)),
            least=np.append(self.least, np.zeros(len(looks))),
        )

    @property
    def without_colour(self) -> "Noise":
        """With white noise alone."""
        kept = len(BALANCES)
        return replace(
            self,
            disturbances=self.disturbances[:kept],
            most=self.most[:kept],
            lasts_s=self.lasts_s[:kept],
            least=self.least[:kept],
        )

    def of_input(self, run: Run, seen: Array, which: int) -> Array:
        """(N,) noise of a measured input, white and coloured and its converter's, of what was seen (N, T) of `space`."""
        own, converters = np.split(seen, [len(self.disturbances)], axis=1)
        every = [own[:, which], *own[:, COLOURED].T[which : which + 1]]
        every += [
            y for y, sensor in zip(converters.T, run.converter_errors, strict=True) if sensor == INPUTS[which]
        ]
        return np.asarray(sum(every))

    @property
    def of_measured_inputs(self) -> list[int]:
        """Positions of the noise of the measured inputs, white and coloured, where they look noisy at all."""
        first = len(BALANCES)
        every = (VOLTAGE, LOAD, *range(first, len(self.disturbances))[: len(INPUTS)])
        return [which for which in every if self.disturbances[which] > 0]

    def of_inputs(self, channels: int) -> "Noise":
        """With the measured inputs' noise alone, of a run with so many channels."""
        white, coloured = self.disturbances[:TORQUE], self.disturbances[COLOURED][: len(INPUTS)]
        silent = np.zeros(channels if coloured.size else 0)
        variance = np.concatenate([white, [0.0], coloured, silent])
        lasts = np.concatenate([self.lasts_s[: len(BALANCES) + len(coloured)], silent])
        none = np.zeros((channels, self.sensors.shape[1]))
        return replace(self, sensors=none, disturbances=variance, lasts_s=lasts)

    def drawn(self, run: Run, rng: np.random.Generator) -> Array:
        """(N, 2) noise of the measured inputs as it may be, evenly sampled: all that `of_input` says."""
        white = rng.standard_normal((len(run.measured), len(self.all_of(run)))) * np.sqrt(self.all_of(run))
        keeps = np.median(self._keeps(run), axis=0)
        every = [decaying(np.sqrt(1 - keep**2) * one, keep) for keep, one in zip(keeps, white.T, strict=True)]
        return np.column_stack([self.of_input(run, np.array(every).T, which) for which in (VOLTAGE, LOAD)])

    def _keeps(self, run: Run) -> Array:
        """(N - 1, T) share of each disturbance of `space` that remains at the next sample."""
        return np.column_stack(
            [
                share_that_remains(run.inputs.time_s, self.lasts_s),
                *(error.keeps() for error in run.converter_errors.values()),
            ]
        )

    def lasting_of_channels(self, run: Run) -> Array:
        """(C,) variance of what lasts of the sensors' own errors: coloured noise."""
        coloured = self.disturbances[COLOURED][len(INPUTS) :]
        return coloured if coloured.size else np.zeros(len(run.channels))

    def lasting_of_inputs(self, run: Run) -> tuple[Lasting, ...]:
        """Coloured noise of each measured input."""
        coloured = self.disturbances[COLOURED][: len(INPUTS)]
        if not coloured.size:
            return (NOTHING_LASTS,) * len(INPUTS)
        remains = np.exp(-run.period_s / self.lasts_s[COLOURED][: len(INPUTS)])
        return tuple(Lasting(*one) for one in np.column_stack([np.sqrt(coloured), remains]).tolist())

    def all_of(self, run: Run) -> Array:
        """(T,) variance of all disturbances of `space`: those found, and what lasts of the errors of inputs' converters."""
        return np.append(self.disturbances, [lasts.variance for lasts in run.converter_errors.values()])

    def space(self, run: Run, linear: Linearisation, used: NDArray[np.bool_]) -> StateSpace:
        """The state-space model of a run's errors; samples (N, C) not `used` are passed over."""
        sensors = (*INPUTS, *run.channels)
        coloured_too = sensors if len(self.disturbances) > len(BALANCES) else ()
        lasting = (*coloured_too, *run.converter_errors)
        first = len(BALANCES) + len(INPUTS)
        drifts = np.full((len(run.channels), 1), -1)
        if coloured_too:
            drifts[:, 0] = first + np.arange(len(run.channels))
        of_input = [INPUTS.index(name) if name in INPUTS else -1 for name in lasting]
        hold, jumps = run.inputs.hold, self._jumps(run)
        shows = dict(STATE_OF)
        if run.mean_speed:
            linear, shows["speed"] = with_mean(linear), MEAN
        if run.mean_speed and jumps.any():
            # When in a sample the speed began to change decides its mean, which the motor's states at the end do not tell.
            used = used.copy()
            used[1:, run.channels.index("speed")] &= ~jumps.any(axis=1)
        # A torque that nobody measured has no reason to hold: it runs from one sample to the next.
        return StateSpace(
            linear.matrices,
            np.array([linear.states.index(shows[channel]) for channel in run.channels]),
            np.concatenate([BALANCES, np.array(of_input, dtype=np.int64)]),
            drifts,
            # The difference of two counts says of no interval that the truth is in it: its error is noise.
            np.where(
                np.array([run.from_angle and channel == "speed" for channel in run.channels]), 0.0, run.steps
            ),
            np.array([hold[0], hold[1], False, *(which < 0 or hold[which] for which in of_input)]),
            self._keeps(run),
            self.all_of(run),
            np.ascontiguousarray(np.where(used, self.of_samples(run) + run.steps**2 / 12, np.inf)),
            np.zeros(len(linear.states)),
            jumps,
        )

    def at_any_moment(self, which: int) -> "Noise":
        """With an input that may have changed at any moment between two samples."""
        return replace(self, between=(which == VOLTAGE or self.between[0], which == LOAD or self.between[1]))

    def _jumps(self, run: Run) -> Array:
        """(N - 1, 2) standard deviation of the inputs' error in each sample in which they changed; empty if none did."""
        if not any(self.between):
            return np.zeros((0, 0))
        jumps = np.zeros((len(run.measured) - 1, len(INPUTS)))
        seen = self.all_of(run)[None]
        for which, shown in enumerate((run.inputs.voltage_V, run.inputs.load_torque_Nm)):
            if self.between[which]:
                changes = np.abs(np.diff(shown))
                noise_sd = np.sqrt(2 * float(self.of_input(run, seen, which)[0]))
                jumps[:, which] = np.sqrt(AT_ANY_MOMENT) * np.where(
                    changes > OUTLIER * noise_sd, changes, 0.0
                )
        return jumps


def first_noise(run: Run, residual: Array, torque_Nm: float, tolerance: float) -> Noise:
    """Where the estimate begins: sensors as noisy as the residual (N, C), inputs as noisy as they look, a small torque.

    Args:
        run: the recording.
        residual: (N, C) measured less simulated.
        torque_Nm: rated.
        tolerance: relative error of the simulation.
    """
    size = np.array([np.mean(e[there] ** 2) if there.any() else 1.0 for e, there in _columns(residual, run)])
    scale = np.array(
        [np.mean(y[there] ** 2) if there.any() else 1.0 for y, there in _columns(run.measured, run)]
    )
    floor = np.maximum((UNEVEN_LEVELS * run.steps) ** 2, np.maximum(LEAST * tolerance * scale, TINY))
    shown = (run.inputs.voltage_V, run.inputs.load_torque_Nm)
    looks, most = (
        np.array([of(y, step) ** 2 + step**2 / 12 for y, step in zip(shown, run.input_step, strict=True)])
        for of in (noise_sd, most_noise_sd)
    )
    # A load that was not measured has no noise of its own, but the slow torque.
    for variances in (looks, most):
        variances[LOAD] *= "load_torque" in run.known
    torque = 0.0 if run.bare else torque_Nm**2
    return Noise(
        np.maximum(size - run.steps**2 / 12, floor)[:, None],
        np.array([*looks, SMALL_TORQUE**2 * torque]),
        np.append(most, torque),
        np.array([0.0, 0.0, LASTS[1] * run.period_s]),
        floor,
        np.zeros(len(BALANCES)),
    )


def _columns(y: Array, run: Run) -> list[tuple[Array, NDArray[np.bool_]]]:
    return [(y[:, c], run.there[:, c]) for c in range(y.shape[1])]
