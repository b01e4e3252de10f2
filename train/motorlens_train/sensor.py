"""A virtual sensor in training form: feature bank, network and uncertainty, before it is written to a file."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motorlens_train.cascade import Network, dense, forward
from motorlens_train.observer.frame import Frame
from motorlens_train.posterior import LastLayer
from motorlens_train.scaling import Scaling, Whitening
from motorlens_train.specification import Array, Bank, Envelope, Specification


@dataclass(frozen=True)
class Learned:
    """A network and what is not known of it.

    Attributes:
        network: on scaled features and outputs.
        inputs: whitening of the features.
        targets: scaling of the outputs.
        posterior: last-layer posterior of the function.
        noise: weights `[K, Z]` of the logarithm of each output's remaining variance (scaled), on what the output
            layer reads.
    """

    network: Network
    inputs: Whitening
    targets: Scaling
    posterior: LastLayer
    noise: Tensor

    def evaluate(self, features: Array) -> tuple[Array, Array]:
        """Mean and sigma `[N, K]` for features `[N, F]`, in float64."""
        read = self.read(features)
        mean = self.targets.restore(read @ self.network.output.T)
        variance = self.posterior.variance(read) + (read @ self.noise.T).clamp(-25.0, 10.0).exp()
        return mean.numpy(), (variance.sqrt() * self.targets.deviation).numpy()

    def read(self, features: Array) -> Tensor:
        """What the output layer reads, `[N, Z]`, its first column the constant."""
        architecture = self.network.architecture
        scaled = self.inputs.scale(torch.from_numpy(np.ascontiguousarray(features, dtype=np.float64)))
        z = forward(architecture, dense(architecture, self.network.hidden), scaled.T)
        return architecture.read_by_output(z).T


@dataclass(frozen=True)
class Sensor:
    """Everything the exported graphs hold: a network, an observer that a network mends, or an observer alone.

    Attributes:
        name: of the sensor.
        specification: signals, features, outputs, envelope.
        learned: the network; None where the observer stands alone.
        frame: what the outputs are relative to, where the bank has an observer.
    """

    name: str
    specification: Specification
    learned: Learned | None
    frame: Frame | None = None

    @property
    def bank(self) -> Bank:
        """Signals, filters and features."""
        return self.specification.bank

    @property
    def promised(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(output.name for output in self.specification.outputs)

    @property
    def envelope(self) -> Envelope:
        """Ranges of the inputs, and the cloud of the features."""
        return self.specification.envelope

    def evaluate(self, features: Array) -> tuple[Array, Array]:
        """Estimate and sigma `[N, K]` for features `[N, F]`, in float64."""
        if self.frame is None:
            assert self.learned is not None
            return self.learned.evaluate(features)
        estimate, deviation = self.frame.start(features)
        if self.learned is None:
            return estimate, deviation
        mean, sigma = self.learned.evaluate(features)
        # A network mends where it was trained; away from there its part fades, and the observer stands alone.
        cloud = self.envelope.cloud
        share = np.ones((len(features), 1)) if cloud is None else cloud.near(features)[:, None]
        return estimate + deviation * share * mean, deviation * (1 + share * (sigma - 1))
