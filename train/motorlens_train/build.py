"""From duty cycles to a sensor: train, calibrate, fence in, measure."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from motorlens_train.calibration import noise_head
from motorlens_train.cascade import Architecture
from motorlens_train.data import Cycle, arrays, errors, scale_of
from motorlens_train.features import feature_rows
from motorlens_train.observer.frame import Frame
from motorlens_train.posterior import LastLayer
from motorlens_train.sensor import Learned, Sensor
from motorlens_train.specification import Array, Bank, Cloud, Envelope, Rate, Specification
from motorlens_train.state import Record
from motorlens_train.trainer import Settings, Trained, train

# Directions of the last-layer posterior that the exported sensor keeps: the least determined ones.
DIRECTIONS = 12
GOLDEN_ROWS = 24


@dataclass(frozen=True)
class Recipe:
    """What is to be built.

    Attributes:
        name: of the sensor.
        bank: its features.
        outputs: names of the promised quantities.
        hidden: width of each hidden layer.
        rate: sample rates it is for.
        warm_up_s: how long a fresh state is not to be trusted.
        seed: of everything random.
        settings: of the trainer.
        activation: of the hidden units.
        skips: cascade or plain feed-forward.
    """

    name: str
    bank: Bank
    outputs: tuple[str, ...]
    hidden: tuple[int, ...]
    rate: Rate
    warm_up_s: float
    seed: int
    settings: Settings = Settings()  # noqa: RUF009 -- frozen
    activation: str = "tanh"
    skips: bool = True

    @property
    def architecture(self) -> Architecture:
        """The network's structure."""
        return Architecture(
            len(self.bank.features), self.hidden, len(self.outputs), self.activation, self.skips
        )


@dataclass(frozen=True)
class Built:
    """A sensor, the training it came from, and its card."""

    sensor: Sensor
    trained: Trained
    card: dict[str, Any]


def build(
    recipe: Recipe,
    training: Sequence[Cycle],
    calibration: Sequence[Cycle],
    unseen: Sequence[Cycle],
    report: Callable[[Record], None] = lambda record: None,
    checkpoint: Path | None = None,
) -> Built:
    """Train and calibrate a sensor.

    Args:
        recipe: what to build.
        training: cycles that the network learns from.
        calibration: other cycles, for the published standard deviation; empty means that errors on one part of the training
            cycles are taken from a network trained on the others.
        unseen: other cycles again, on which the card's errors are measured; may be empty.
        report: called after every iteration.
        checkpoint: see `motorlens_train.trainer.train`.
    """
    frame = Frame.of(recipe.bank, recipe.outputs) if recipe.bank.observer else None
    fitted = [frame.relative(c) if frame else c for c in training]
    found = train(
        arrays(fitted),
        recipe.architecture,
        recipe.seed,
        recipe.settings,
        report=report,
        checkpoint=checkpoint,
    )
    # The file holds float32 numbers; the sensor is what the file holds.
    network = replace(
        found.network, hidden=_single(found.network.hidden), output=_single(found.network.output)
    )
    trained = replace(found, network=network)
    exact = LastLayer.of(trained, DIRECTIONS)
    posterior = LastLayer(_single(exact.basis), _single(exact.variances))
    specification = Specification(
        scale_of(training, recipe.outputs), recipe.bank, recipe.rate, recipe.warm_up_s, envelope(training)
    )
    width = len(recipe.architecture.output_reads)
    silent = Learned(
        trained.network, trained.inputs, trained.targets, posterior,
        torch.zeros(len(recipe.outputs), width, dtype=torch.float64),
    )  # fmt: skip
    if calibration:
        calibration = [frame.relative(c) if frame else c for c in calibration]
        if frame:
            share = _share([c.y for c in calibration], [silent.evaluate(c.x)[0] for c in calibration])
            silent = _worth(silent, share, share)
        read = [silent.read(c.x) for c in calibration]
        off = [(silent.evaluate(c.x)[0] - c.y) / trained.targets.deviation.numpy() for c in calibration]
        if frame:
            head = _scaled(np.concatenate(off) * trained.targets.deviation.numpy(), width)
            head[:, 0] -= 2 * np.log(trained.targets.deviation.numpy())
        else:
            head = noise_head([z.numpy() for z in read], off, [posterior.variance(z).numpy() for z in read])
            silent, head = _by_drive(silent, head, read, off)
    else:
        y, guess, constant = _crossed(recipe, fitted)
        if frame:
            # A constant error, as of a drop that the observer does not know, is borne out by fewer cycles than a shape is.
            steady = _steady_share(np.concatenate(y), np.concatenate(constant))
            rest = [a - steady * c for a, c in zip(y, constant, strict=True)]
            shape = [g - c for g, c in zip(guess, constant, strict=True)]
            share = _share(rest, shape)
            silent = _worth(silent, share, steady)
            head = _scaled(share * np.concatenate(shape) - np.concatenate(rest), width)
        else:
            head = np.zeros((len(recipe.outputs), width))
            off_targets = np.concatenate(guess) - np.concatenate(y)
            head[:, 0] = np.log((off_targets**2).mean(0) + 1e-10 * trained.targets.deviation.numpy() ** 2)
        head[:, 0] -= 2 * np.log(trained.targets.deviation.numpy())
    learned = replace(silent, noise=_single(torch.from_numpy(head)))
    sensor = Sensor(recipe.name, specification, learned, frame)
    return Built(sensor, trained, _card(recipe, sensor, trained, training, unseen))


def measured(sensor: Sensor, cycles: Sequence[Cycle]) -> dict[str, dict[str, float]]:
    """Errors on cycles and how often the 95 % interval holds the truth, by output."""
    results = [sensor.evaluate(c.x) for c in cycles]
    found = errors(cycles, [estimate for estimate, _ in results])
    inside = np.concatenate(
        [np.abs(estimate - c.y) <= 1.96 * sigma for c, (estimate, sigma) in zip(cycles, results, strict=True)]
    ).mean(0)
    table = {**found, "coverage_95": inside}
    return {
        output.name: {key: _short(values[k]) for key, values in table.items()}
        for k, output in enumerate(sensor.specification.outputs)
    }


def envelope(cycles: Sequence[Cycle]) -> Envelope:
    """Ranges of the inputs, and the ellipsoid of the features that holds 99.9 % of the training rows, doubled."""
    x = np.concatenate([c.x for c in cycles])
    mean = x.mean(0)
    covariance = np.cov(x.T, bias=True).reshape(x.shape[1], x.shape[1])
    # A hundredth of each feature's variance is granted in every direction: filters of one signal are nearly collinear, and
    # the fence is to stop what is far away, not what is slightly skew.
    diagonal = np.where(np.diag(covariance) > 0, np.diag(covariance), 1.0)
    covariance = covariance + 0.01 * np.diag(diagonal)
    # The file holds float32 numbers.
    factor = np.linalg.cholesky(np.linalg.inv(covariance)).astype(np.float32).astype(np.float64)
    distance = (((x - mean) @ factor) ** 2).sum(1)
    return Envelope(
        (min(c.voltage_V[0] for c in cycles), max(c.voltage_V[1] for c in cycles)),
        (min(c.current_A[0] for c in cycles), max(c.current_A[1] for c in cycles)),
        Cloud(mean, factor, float(f"{4 * np.quantile(distance, 0.999):.4g}")),
    )


def golden(sensor: Sensor) -> dict[str, Any]:
    """A short sequence from a fresh state, and what must come out of it; steps of one to a thousand periods."""
    fence, period = sensor.specification.envelope, 1 / sensor.specification.rate.nominal
    n = np.arange(GOLDEN_ROWS)
    # Whole nanoseconds: what the runtime's clock can represent.
    time = np.cumsum(np.round(period * np.where(n % 8 == 7, 1000.0, 1.0 + n // 8) * 1e9)) * 1e-9
    share = 0.5 + 0.4 * np.sin(0.9 * n)
    voltage = np.round(fence.voltage_V[0] + (fence.voltage_V[1] - fence.voltage_V[0]) * share, 3)
    current = np.round(fence.current_A[0] + (fence.current_A[1] - fence.current_A[0]) * (1 - share) * 0.6, 3)
    if sensor.bank.observer:
        # An observer of something no motor does would amplify the last bit of every number: this motor is locked.
        voltage, current = _locked(sensor, time, np.round(0.1 * fence.voltage_V[1] * share, 3))
    ambient = np.full(len(n), 20.0) if sensor.bank.ambient else None
    x = feature_rows(sensor.bank, time, voltage, current, ambient_C=ambient, first_dt_s=period)
    estimate, sigma = sensor.evaluate(x)
    return {
        "time_s": [round(float(t), 9) for t in time],
        "voltage_V": voltage.tolist(),
        "current_A": current.tolist(),
        **({"ambient_C": ambient.tolist()} if ambient is not None else {}),
        "estimate": [[_short(v, 8) for v in row] for row in estimate],
        "sigma": [[_short(v, 8) for v in row] for row in sigma],
        "tolerance": 1e-4,
    }


def _locked(sensor: Sensor, time: Array, voltage: Array) -> tuple[Array, Array]:
    """Voltage and current of a locked rotor: L di/dt = v - R i, the voltage linear between samples."""
    R, L = sensor.bank.resistance_ohm, sensor.bank.inductance_H
    current = voltage / R
    for k in range(1, len(time)):
        dt = time[k] - time[k - 1]
        lag = L / R * (voltage[k] - voltage[k - 1]) / R / dt
        settled = voltage[k] / R - lag
        current[k] = (
            settled + (current[k - 1] - voltage[k - 1] / R + lag) * np.exp(-R * dt / L) if L > 0 else settled
        )
    return voltage, np.round(current, 4)


def _scaled(errors: Array, width: int) -> Array:
    """Noise head `[K, Z]` beside an observer, from errors `[N, K]` in its deviations on cycles not trained on.

    The observer's deviation already follows the situation; it is scaled until the interval holds nineteen of twenty
    errors, and never narrowed: cycles that it follows with ease say little about a real motor.
    """
    head = np.zeros((errors.shape[1], width))
    head[:, 0] = 2 * np.log(np.maximum(np.quantile(np.abs(errors), 0.95, axis=0) / 1.96, 1.0))
    return head


def _by_drive(
    learned: Learned, head: Array, read: Sequence[torch.Tensor], off: Sequence[Array]
) -> tuple[Learned, Array]:
    """Network and noise head `[K, Z]` with deviations so wide that they hold in nine drives of ten, not in nine rows of ten.

    Whoever has a drive has that one: errors that last through a cycle count as one, however many its rows (conformal
    prediction over groups; Dunn, Wasserman and Ramdas 2023, doi:10.1080/01621459.2022.2060112). Never narrowed.

    Args:
        learned: the network.
        head: of the noise, fitted to all rows.
        read: `[N, Z]` of each cycle not trained on: what the output layer reads.
        off: `[N, K]` of each: errors in the targets' deviations.
    """
    stated = [
        np.sqrt(learned.posterior.variance(z).numpy() + np.exp(np.clip(z.numpy() @ head.T, -25.0, 10.0)))
        for z in read
    ]
    needed = [np.quantile(np.abs(e) / s, 0.95, axis=0) / 1.96 for e, s in zip(off, stated, strict=True)]
    wider = np.maximum(np.quantile(needed, 0.9, axis=0), 1.0)
    variances = _single(learned.posterior.variances * torch.from_numpy(wider**2)[:, None])
    head = head.copy()
    head[:, 0] += 2 * np.log(wider)
    return replace(learned, posterior=replace(learned.posterior, variances=variances)), head


def _worth(learned: Learned, share: Array, steady: Array) -> Learned:
    """The network with its correction of an observer reduced to what is borne out on cycles not trained on.

    Where the observer is as good as can be, or the cycles are few, a network finds nothing but their accidents.

    Args:
        learned: corrects an observer.
        share: `[K]` what is kept of each output's correction.
        steady: `[K]` what is kept of its constant part.
    """
    network = replace(
        learned.network, output=_single(learned.network.output * torch.from_numpy(share)[:, None])
    )
    targets = replace(learned.targets, mean=learned.targets.mean * torch.from_numpy(steady))
    # As the correction shrinks, so does what is not known of it.
    kept = torch.from_numpy(share**2)[:, None] if learned.posterior.variances.ndim == 2 else 1.0
    posterior = replace(learned.posterior, variances=_single(learned.posterior.variances * kept))
    return replace(learned, network=network, targets=targets, posterior=posterior)


def _share(y: Sequence[Array], guess: Sequence[Array]) -> Array:
    """`[K]` share of a guess that is borne out, between 0 and 1: that of least squares, a, shrunk to a (1 - (sd / a)^2).

    An error of many deviations counts as one. The standard error sd is the jackknife's over cycles: a start shows the
    temperature well or badly, and what follows it in its cycle is wrong alike. Stacked regression: Wolpert (1992),
    doi:10.1016/S0893-6080(05)80023-1; shrinkage: James and Stein (1961).

    Args:
        y: `[N, K]` of each cycle: what the observer gets wrong, in its deviations, on cycles not trained on.
        guess: `[N, K]` of each: what the network says of it.
    """
    weights = [1 / (1 + a**2) for a in y]
    products = np.stack([(w * a * g).sum(0) for w, a, g in zip(weights, y, guess, strict=True)])
    squares = np.stack([(w * g**2).sum(0) for w, g in zip(weights, guess, strict=True)])
    share = products.sum(0) / (squares.sum(0) + 1e-12)
    if len(y) > 1:
        without = (products.sum(0) - products) / (squares.sum(0) - squares + 1e-12)
        share = share - (len(y) - 1) * without.var(0) / np.maximum(share, 1e-12)
    return np.asarray(np.clip(share, 0.0, 1.0))


def _steady_share(y: Array, constant: Array) -> Array:
    """`[K]` share of a constant, 0 to 1, that leaves least of y; an error of many deviations counts by its logarithm."""
    shares = np.linspace(0.0, 1.0, 21)
    left = np.stack([np.log1p((y - share * constant) ** 2).mean(0) for share in shares])
    return np.asarray(shares[left.argmin(0)])


def _crossed(recipe: Recipe, training: Sequence[Cycle]) -> tuple[list[Array], list[Array], list[Array]]:
    """Of each cycle (or half of the only one): targets, estimates by a network trained on the others, their constant part.

    `[N, K]` each.
    """
    folds = list(training)
    if len(folds) == 1:
        only, half = folds[0], len(folds[0].x) // 2
        folds = [_rows(only, slice(None, half)), _rows(only, slice(half, None))]
    targets, estimates, constants = [], [], []
    for left_out in range(min(len(folds), 4)):
        others = [c for j, c in enumerate(folds) if j != left_out]
        trained = train(arrays(others), recipe.architecture, recipe.seed, recipe.settings)
        targets.append(folds[left_out].y)
        estimates.append(trained.predict(torch.from_numpy(folds[left_out].x)).numpy())
        constants.append(np.broadcast_to(trained.targets.mean.numpy(), estimates[-1].shape))
    return targets, estimates, constants


def _rows(cycle: Cycle, which: slice) -> Cycle:
    return Cycle(
        cycle.name,
        cycle.time_s[which],
        cycle.x[which],
        cycle.y[which],
        cycle.voltage_V,
        cycle.current_A,
        cycle.rows,
    )


def _card(
    recipe: Recipe, sensor: Sensor, trained: Trained, training: Sequence[Cycle], unseen: Sequence[Cycle]
) -> dict[str, Any]:
    digest = hashlib.sha256()
    for c in training:
        digest.update(np.ascontiguousarray(c.x).tobytes() + np.ascontiguousarray(c.y).tobytes())
    return {
        "training_data_sha256": digest.hexdigest(),
        "training_cycles": len(training),
        "training_rows": sum(len(c.x) for c in training),
        "samples_seen": sum(c.rows for c in training),
        "seed": recipe.seed,
        "network": str(recipe.architecture),
        "parameters": recipe.architecture.parameters,
        "effective_parameters": _short(float(trained.evidence.gamma.sum())),
        "log_evidence": _short(trained.evidence.log_evidence, 6),
        "iterations": len(trained.history),
        "stopped": trained.stopped,
        "unseen_cycles": len(unseen),
        "unseen": measured(sensor, unseen) if unseen else {},
        "training": measured(sensor, training),
    }


def _single(values: torch.Tensor) -> torch.Tensor:
    return values.float().double()


def _short(value: float, digits: int = 4) -> float:
    return float(f"{value:.{digits}g}")
