"""Activation functions of hidden units, each with its derivatives written in terms of its own value.

Expressing the slope by the value (tanh' = 1 - tanh^2) means that a forward pass is all that the Jacobian needs.
"""

from typing import Protocol

import torch
from torch import Tensor

from motorlens_runtime.errors import ModelError


class Activation(Protocol):
    """A scalar function applied unit by unit; tensors of any shape."""

    name: str
    onnx: str

    def value(self, a: Tensor) -> Tensor:
        """h = f(a); may overwrite `a`."""

    def slope(self, h: Tensor) -> Tensor:
        """f'(a) as a function of h = f(a)."""

    def curvature(self, h: Tensor) -> Tensor:
        """f''(a) as a function of h = f(a)."""


class Tanh:
    """Hyperbolic tangent, the paper's choice for hidden layers."""

    name, onnx = "tanh", "Tanh"

    def value(self, a: Tensor) -> Tensor:
        return a.tanh_()

    def slope(self, h: Tensor) -> Tensor:
        return 1 - h * h

    def curvature(self, h: Tensor) -> Tensor:
        return -2 * h * (1 - h * h)


class Logistic:
    """Logistic sigmoid 1 / (1 + exp(-a))."""

    name, onnx = "logistic", "Sigmoid"

    def value(self, a: Tensor) -> Tensor:
        return a.sigmoid_()

    def slope(self, h: Tensor) -> Tensor:
        return h * (1 - h)

    def curvature(self, h: Tensor) -> Tensor:
        return h * (1 - h) * (1 - 2 * h)


class Linear:
    """The identity; a network of it is linear in its inputs, which tests use."""

    name, onnx = "linear", "Identity"

    def value(self, a: Tensor) -> Tensor:
        return a

    def slope(self, h: Tensor) -> Tensor:
        return torch.ones_like(h)

    def curvature(self, h: Tensor) -> Tensor:
        return torch.zeros_like(h)


class Rectifier:
    """max(a, 0); the slope at 0 is taken as 0."""

    name, onnx = "rectifier", "Relu"

    def value(self, a: Tensor) -> Tensor:
        return a.relu_()

    def slope(self, h: Tensor) -> Tensor:
        return (h > 0).to(h.dtype)

    def curvature(self, h: Tensor) -> Tensor:
        return torch.zeros_like(h)


ACTIVATIONS: tuple[Activation, ...] = (Tanh(), Logistic(), Linear(), Rectifier())


def activation(name: str) -> Activation:
    """The activation called `name`.

    Raises:
        ModelError: no activation has this name.
    """
    for candidate in ACTIVATIONS:
        if candidate.name == name:
            return candidate
    raise ModelError(f"unknown activation {name!r}; known: {', '.join(a.name for a in ACTIVATIONS)}")
