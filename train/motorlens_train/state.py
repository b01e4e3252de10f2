"""The state of a training and its report; on disk written whole or not at all, read back bit for bit."""

import io
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import torch
from torch import Tensor

from motorlens_runtime.errors import DataError
from motorlens_train.evidence import Hyperparameters


@dataclass(frozen=True)
class Record:
    """One iteration of the training report; lists have one entry an output or a layer.

    Errors are root mean squares as a share of the targets' standard deviation.
    """

    iteration: int
    stage: int
    rows: int
    accepted: bool
    objective: float
    error: list[float]
    validation: list[float] | None
    gamma: float  # of the last evaluation of the evidence, at the point where a step began
    log_evidence: float | None
    alpha: list[float]
    beta: list[float]
    tau: list[float]
    damping: float


@dataclass(frozen=True)
class State:
    """Everything that training needs to go on; what a checkpoint holds."""

    hidden: Tensor
    hyper: Hyperparameters
    gamma: Tensor  # well-determined parameters of each layer when last evaluated
    damping: float
    stage: int
    iteration: int
    quiet: int  # consecutive iterations with little progress
    best: Tensor  # hidden weights with the lowest validation error
    best_hyper: Hyperparameters
    best_error: float
    since_best: int
    history: tuple[Record, ...]


def save_checkpoint(path: Path, state: State) -> None:
    """Write `state` to `path` through a temporary file, so that a kill leaves the old or the new one."""
    tensors = {
        "hidden": state.hidden, "gamma": state.gamma, "best": state.best,
        "alpha": state.hyper.alpha, "beta": state.hyper.beta, "tau": state.hyper.tau,
        "best_alpha": state.best_hyper.alpha, "best_beta": state.best_hyper.beta, "best_tau": state.best_hyper.tau,
    }  # fmt: skip
    arrays: dict[str, Any] = {name: tensor.numpy() for name, tensor in tensors.items()}
    numbers = {
        "damping": state.damping, "stage": state.stage, "iteration": state.iteration, "quiet": state.quiet,
        "best_error": state.best_error, "since_best": state.since_best,
        "history": [asdict(record) for record in state.history],
    }  # fmt: skip
    temporary = path.with_name(path.name + ".tmp")
    with temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, numbers=np.array(json.dumps(numbers)), **arrays)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def load_checkpoint(path: Path) -> State:
    """Read a state written by `save_checkpoint`.

    Raises:
        DataError: the file is not a checkpoint.
    """
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            tensors = {name: torch.from_numpy(file[name]) for name in file.files if name != "numbers"}
            numbers = json.loads(str(file["numbers"]))
        numbers["history"] = tuple(Record(**entry) for entry in numbers["history"])
        hyper = Hyperparameters(tensors["alpha"], tensors["beta"], tensors["tau"])
        best_hyper = Hyperparameters(tensors["best_alpha"], tensors["best_beta"], tensors["best_tau"])
        return State(
            tensors["hidden"], hyper, tensors["gamma"], best=tensors["best"], best_hyper=best_hyper, **numbers
        )
    except (ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        raise DataError(
            f"{path}: not a checkpoint of a training ({error}); remove it to start anew"
        ) from error
