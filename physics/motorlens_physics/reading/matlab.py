"""Recordings as MATLAB files up to version 7: every numeric vector, also within structures, is a column by its name."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from motorlens_physics.reading import Array, Table
from motorlens_runtime.errors import DataError

if TYPE_CHECKING:
    from scipy.io.matlab import MatlabOpaque

SUFFIXES = (".mat",)
EXTRA = "workbench"


def read(path: Path) -> Table:
    """Read a MAT file: the vectors of the most common length; `run.v` is called `v` where that is unique."""
    import scipy.io
    from scipy.io.matlab import MatlabOpaque

    try:
        with warnings.catch_warnings():
            # Objects have no name where scipy looks for one, and several of them the same.
            warnings.simplefilter("ignore", scipy.io.matlab.MatReadWarning)
            content = scipy.io.loadmat(str(path), squeeze_me=True, struct_as_record=False)
    except NotImplementedError:
        raise DataError(f"{path}: a MATLAB file of version 7.3; save it with save(..., '-v7')") from None
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or f'not a MATLAB file ({error})'}") from None
    except Exception as error:  # scipy raises what its parser meets
        raise DataError(f"{path}: not a MATLAB file ({error})") from None
    vectors = dict(
        _vectors({name: value for name, value in content.items() if not name.startswith("__")}, "")
    )
    objects = [_described(value) for value in content.values() if isinstance(value, MatlabOpaque)]
    if not vectors and objects:
        raise DataError(
            f"{path}: holds {' and '.join(objects)}, which only MATLAB reads; save its vectors there: "
            "save('run.mat', 'time_s', 'voltage_V', 'current_A', '-v7')"
        )
    if not vectors:
        raise DataError(f"{path}: holds no vector of numbers")
    lengths = [len(vector) for vector in vectors.values()]
    usual = max(set(lengths), key=lambda n: (lengths.count(n), n))
    other = [name for name, vector in vectors.items() if len(vector) != usual]
    columns = {name: vector for name, vector in vectors.items() if len(vector) == usual}
    short = [name.rpartition(".")[2] for name in columns]
    headings = tuple(
        last if short.count(last) == 1 else name for name, last in zip(columns, short, strict=True)
    )

    def numbers(used: Sequence[int]) -> Mapping[int, Array]:
        values = list(columns.values())
        return {k: values[k] for k in used}

    notes = [f"not used, of another length than {usual}: {', '.join(other)}"] if other else []
    notes += [f"not used, which only MATLAB reads: {', '.join(objects)}"] if objects else []
    return Table(headings, numbers, 1, notes)


def _described(thing: "MatlabOpaque") -> str:
    """An object of a class of MATLAB's own, such as a timetable: its class and its name."""
    name, _, kind, _ = thing.reshape(-1)[0]
    return f"the {kind.decode()} {name.decode()!r}"


def _vectors(content: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Array]]:
    for name, value in content.items():
        fields = getattr(value, "_fieldnames", None)
        if fields is not None:
            yield from _vectors({field: getattr(value, field) for field in fields}, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.ndim == 1:
            yield prefix + name, value.astype(np.float64)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.ndim == 2:
            # There are more samples than channels; Simulink's "To File" writes a row for each channel.
            for k, column in enumerate(value.T if value.shape[0] >= value.shape[1] else value):
                yield f"{prefix}{name}_{k + 1}", column.astype(np.float64)
