"""A training state on disk: written whole or not at all, read back bit for bit."""

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from motorlens_runtime.errors import DataError
from motorlens_train.evidence import Hyperparameters

if TYPE_CHECKING:
    from motorlens_train.trainer import Record, State


def save_checkpoint(path: Path, state: "State") -> None:
    """Write `state` to `path` through a temporary file, so that a kill leaves the old or the new one."""
    tensors = {
        "hidden": state.hidden, "best": state.best,
        "alpha": state.hyper.alpha, "beta": state.hyper.beta, "tau": state.hyper.tau,
    }  # fmt: skip
    arrays: dict[str, Any] = {name: tensor.numpy() for name, tensor in tensors.items()}
    numbers = {
        "damping": state.damping, "stage": state.stage, "iteration": state.iteration, "quiet": state.quiet,
        "best_error": state.best_error, "since_best": state.since_best,
        "history": [asdict(record) for record in state.history],
    }  # fmt: skip
    temporary = path.with_name(path.name + ".tmp")
    with temporary.open("wb") as file:
        np.savez(
            file, numbers=np.array(json.dumps(numbers)), **{name: a.numpy() for name, a in arrays.items()}
        )
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def load_checkpoint(path: Path, state: type["State"], record: type["Record"]) -> "State":
    """Read a state written by `save_checkpoint`.

    Raises:
        DataError: the file is not a checkpoint.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            tensors = {
                name: torch.from_numpy(file[name]) for name in ("hidden", "best", "alpha", "beta", "tau")
            }
            numbers = json.loads(str(file["numbers"]))
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise DataError(
            f"{path}: not a checkpoint of a training ({error}); remove it to start anew"
        ) from error
    numbers["history"] = tuple(record(**entry) for entry in numbers["history"])
    hyper = Hyperparameters(tensors["alpha"], tensors["beta"], tensors["tau"])
    return state(hidden=tensors["hidden"], best=tensors["best"], hyper=hyper, **numbers)
