"""A recurrent network as a peer: gated recurrent units over voltage and current, averaged over blocks of samples."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_train.baselines.method import Array, Estimate, inputs, truth

BLOCK_S, UNITS, STEPS = 0.05, 24, 300


@dataclass(frozen=True)
class Recurrent:
    """GRU (Cho et al. 2014, doi:10.3115/v1/D14-1179) with a linear output; state carried over the whole recording.

    Trained by Adam with backpropagation cut to `STEPS` blocks, the state handed from piece to piece.
    """

    network: torch.nn.GRU
    output: torch.nn.Linear
    size: Array
    scale: Array
    sd: Array

    @staticmethod
    def trained(recordings: Sequence[Recording], file: MotorFile, passes: int) -> "Recurrent":
        """Trained on recordings with their true channels, so many times."""
        torch.manual_seed(0)
        network, output = torch.nn.GRU(2, UNITS, batch_first=True), torch.nn.Linear(UNITS, 3)
        optimiser = torch.optim.Adam([*network.parameters(), *output.parameters()], lr=5e-3)
        rated = file.rated
        scale = np.array([rated.speed_rad_s, rated.rise_K, file.motor.R_a0 * file.motor.alpha * rated.rise_K])
        size = np.array([rated.voltage_V, rated.current_A])
        data = [_blocks(r, file, size, scale) for r in recordings]
        longest = max(len(x) for x, _ in data)
        x, y = (np.zeros((len(data), longest, width), dtype=np.float32) for width in (2, 3))
        weight = np.zeros((len(data), longest, 1), dtype=np.float32)
        for k, (inputs_k, targets_k) in enumerate(data):
            x[k, : len(inputs_k)], y[k, : len(inputs_k)], weight[k, : len(inputs_k)] = inputs_k, targets_k, 1
        rate = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, passes)
        for _ in range(passes):
            state = None
            for first in range(0, longest, STEPS):
                rows = slice(first, first + STEPS)
                hidden, state = network(torch.from_numpy(x[:, rows]), state)
                state = state.detach()
                mask = torch.from_numpy(weight[:, rows])
                error = (output(hidden) - torch.from_numpy(y[:, rows])).square() * mask
                loss = error.sum() / mask.sum().clamp_min(1.0)
                optimiser.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
                optimiser.step()
            rate.step()
        made = Recurrent(network, output, size, scale, np.ones(3))
        off = np.concatenate([made.estimate(r).values - truth(r, file) for r in recordings[::4]])
        return Recurrent(network, output, size, scale, np.sqrt(np.nanmean(off**2, 0)))

    def fit(self, recordings: Sequence[Recording], motor_file: MotorFile) -> "Recurrent":
        """It is trained."""
        return self

    def estimate(self, recording: Recording) -> Estimate:
        """The value of the block before, as a running sensor would give it."""
        x, ends = _averaged(recording, self.size)
        with torch.no_grad():
            hidden, _ = self.network(torch.from_numpy(x[None]))
            found = self.output(hidden)[0].numpy() * self.scale
        at = np.searchsorted(ends, np.arange(len(recording)), side="right") - 1
        values = found[np.maximum(at, 0)]
        return Estimate.of(values, np.broadcast_to(self.sd, values.shape))


def _averaged(recording: Recording, size: Array) -> tuple[np.ndarray, np.ndarray]:
    _, v, i = inputs(recording)
    each = max(1, round(BLOCK_S / recording.period_s))
    count = len(v) // each
    means = np.stack([u[: count * each].reshape(count, each).mean(1) for u in (v, i)], axis=1)
    return (means / size).astype(np.float32), np.arange(1, count + 1) * each - 1


def _blocks(
    recording: Recording, file: MotorFile, size: Array, scale: Array
) -> tuple[np.ndarray, np.ndarray]:
    x, ends = _averaged(recording, size)
    return x, (truth(recording, file)[ends] / scale).astype(np.float32)
