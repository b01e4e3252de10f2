"""Activation functions of hidden units, each with its derivatives written in terms of its own value.

Expressing the slope by the value (tanh' = 1 - tanh^2) means that a forward pass is all that the Jacobian
needs.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from motorlens_runtime.errors import ModelError


@dataclass(frozen=True)
class Activation:
    """A scalar function applied unit by unit.

    Attributes:
        name: how users call it.
        onnx: the ONNX operator that computes it.
        value: h = f(a); may overwrite a.
        slope: f'(a) as a function of h.
        curvature: f''(a) as a function of h.
    """

    name: str
    onnx: str
    value: Callable[[Tensor], Tensor]
    slope: Callable[[Tensor], Tensor]
    curvature: Callable[[Tensor], Tensor]


TANH = Activation("tanh", "Tanh", torch.tanh_, lambda h: 1 - h * h, lambda h: -2 * h * (1 - h * h))
LOGISTIC = Activation(
    "logistic", "Sigmoid", torch.sigmoid_, lambda h: h * (1 - h), lambda h: h * (1 - h) * (1 - 2 * h)
)
LINEAR = Activation("linear", "Identity", lambda a: a, torch.ones_like, torch.zeros_like)
RECTIFIER = Activation("rectifier", "Relu", torch.relu_, lambda h: (h > 0).to(h.dtype), torch.zeros_like)

ACTIVATIONS = {function.name: function for function in (TANH, LOGISTIC, LINEAR, RECTIFIER)}


def activation(name: str) -> Activation:
    """The activation called `name`.

    Raises:
        ModelError: no activation has this name.
    """
    if name not in ACTIVATIONS:
        raise ModelError(f"unknown activation {name!r}; known: {', '.join(ACTIVATIONS)}")
    return ACTIVATIONS[name]
