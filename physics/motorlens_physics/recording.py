"""Recordings: measured or simulated channels over time, in SI, with what was found wrong with them in words.

Files are read by `motorlens_physics.reading`; columns are recognised, computed and converted by
`motorlens_runtime.files.columns`. Time is required, and a voltage where it drives the terminals; every other channel is
optional, and what is absent limits what can be concluded.
"""

import shlex
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.conditions import Shaft, Terminal, code, codes
from motorlens_physics.reading import Table, read_table
from motorlens_physics.reading.clock import steady
from motorlens_physics.reading.suspicion import computed_from, gaps_and_channels, lost_samples, no_value
from motorlens_physics.simulation import Inputs
from motorlens_runtime.errors import DataError
from motorlens_runtime.files.columns import (
    Column,
    canonical_name,
    in_seconds,
    parse_mapping,
    require,
    speed_of,
    understand,
    units_offered,
)
from motorlens_runtime.files.formula import ROW
from motorlens_runtime.files.guesses import refuse_counts
from motorlens_runtime.files.headings import candidates
from motorlens_runtime.files.words import WORDS

Array = NDArray[np.float64]

# Up to this share of rows with a backward stamp or a missing input is repaired, in files long enough to spare them.
REPAIRABLE_SHARE = 0.005
# No voltage, current, speed, temperature or torque of a motor is larger, in SI; smaller numbers can be computed with.
BEYOND = 1e12
# How a note says that a channel is no measurement.
COMPUTED = "times the voltage in every sample"
# What imposes an output on the motor: the terminals or the shaft, tied to this.
IMPOSED_BY = {"current": ("terminal", Terminal.CURRENT), "speed": ("shaft", Shaft.TURNED)}
# What drives a motor must be known at every sample.
INPUTS = ("voltage", "load_torque", "ambient")


@dataclass(frozen=True)
class Recording:
    """One run of one motor.

    Attributes:
        name: the file's name, or that of the scenario.
        time_s: (N,) strictly increasing.
        channels: quantity ("voltage", "current", "speed", "temperature", "load_torque", "ambient", "angle"; "terminal" and
            "shaft" as numbers of `conditions`) to (N,) in the units of `motorlens_runtime.files.columns`; temperatures in
            degC. A missing sample of a measured output is NaN; voltage, load torque and ambient have none.
        notes: what was found and handled while reading, in words.
        computed: likewise, quantity to what was computed from the voltage: no measurement, but an input where it is imposed.
        speed_from_angle: whether the speed was computed from the angle: then it is the mean since the sample before.
    """

    name: str
    time_s: Array
    channels: Mapping[str, Array]
    notes: tuple[str, ...] = field(default=())
    computed: Mapping[str, Array] = field(default_factory=dict)
    speed_from_angle: bool = False

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def period_s(self) -> float:
        """The median sampling period."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def duration_s(self) -> float:
        """From the first to the last sample."""
        return float(self.time_s[-1] - self.time_s[0])

    def has(self, quantity: str) -> bool:
        """Whether the channel was recorded."""
        return quantity in self.channels

    def part(self, rows: slice) -> "Recording":
        """Some consecutive rows, as a recording."""
        channels, computed = (
            {q: y[rows] for q, y in some.items()} for some in (self.channels, self.computed)
        )
        return replace(self, time_s=self.time_s[rows], channels=channels, computed=computed)


def said_once(notes: Iterable[tuple[str, str]]) -> list[str]:
    """Notes on recordings, each by its name; what holds for several is said of the first and how many more.

    >>> said_once([("one.csv", "short"), ("two.csv", "short"), ("two.csv", "noisy")])
    ['one.csv and 1 more: short', 'two.csv: noisy']
    """
    names: dict[str, list[str]] = {}
    for name, note in notes:
        names.setdefault(note, []).append(name)
    return [
        f"{first}{f' and {len(more)} more' if more else ''}: {note}" for note, (first, *more) in names.items()
    ]


def read_recording(
    path: Path | str,
    mapping: Mapping[str, str] | Sequence[str] = (),
    no_values: Iterable[float] | None = None,
    terminal: str | None = None,
) -> Recording:
    """Read a recording: CSV and its relatives (also zipped), Parquet, MAT, MDF.

    Args:
        path: the file; `NAME.columns.toml` beside it may hold a `[columns]` table with the mapping.
        mapping: quantity to heading or formula, or the arguments of `--column`; see `files.columns.understand`.
        no_values: numbers that stand for a missing value; None looks for them.
        terminal: what the terminals are tied to throughout, whatever its columns say; a voltage is needed only where one
            drives them.

    Raises:
        DataError: empty, a required column missing, an unknown or a wrong unit, text in a number, a clock that runs back;
            the message names file, row and column, and what to do.
        OSError: the file cannot be read.
    """
    path = Path(path)
    chosen = dict(mapping) if isinstance(mapping, Mapping) else parse_mapping(mapping)
    beside = path.with_name(path.name + ".columns.toml")
    if beside.exists():
        chosen = tomllib.loads(beside.read_text(encoding="utf-8")).get("columns", {}) | chosen
    table = read_table(path)
    columns = understand(table.headings, chosen, str(path))
    how = None if terminal is None else code(Terminal, terminal, "--terminal")
    tied = "terminal" in columns if how is None else how != Terminal.DRIVEN
    needed = ("time",) if tied else ("time", "voltage")
    require(columns, needed, table.headings, str(path), lambda: _rising(table))
    used = sorted({index for column in columns.values() for index in column.uses} - {ROW})
    numbers = dict(table.numbers(used))
    numbers[ROW] = np.arange(max(map(len, numbers.values()), default=0), dtype=np.float64)
    if columns["time"].index in table.dated and not columns["time"].formula:
        columns["time"] = in_seconds(columns["time"])
    channels = {quantity: column.values(numbers.__getitem__) for quantity, column in columns.items()}
    if len(channels["time"]) < 2:
        raise DataError(f"{path}: {len(channels['time'])} rows of data; a recording needs at least two")
    refuse_counts(columns, channels.__getitem__, str(path))
    notes = [*table.notes, *_about_columns(table.headings, columns)]
    found = _Reader(path, columns, table.first_row, notes).recording(channels, no_values)
    return found if terminal is None else under(found, terminal)


def write_recording(recording: Recording, path: Path | str) -> None:
    """Write a recording as CSV with canonical headings; numbers read back to nine digits."""
    quantities = [q for q in recording.channels]
    headings = [canonical_name(q) for q in ("time", *quantities)]
    table = np.column_stack([recording.time_s, *(recording.channels[q] for q in quantities)])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(headings), comments="")


def under(recording: Recording, terminal: str | None = None, shaft: str | None = None) -> Recording:
    """The recording with its terminals or its shaft tied throughout to what a word says, whatever its columns say.

    Raises:
        DataError: an unknown word.
    """
    tied = {
        quantity: np.full(len(recording), float(code(kind, word, f"--{quantity}")))
        for quantity, kind, word in (("terminal", Terminal, terminal), ("shaft", Shaft, shaft))
        if word is not None
    }
    channels = {**recording.channels, **tied}
    before, after = (gaps_and_channels(recording.time_s, shown) for shown in (recording.channels, channels))
    # A suspicion that the words answer is one no more.
    notes = tuple(note for note in recording.notes if note in after or note not in before)
    return _with_imposed(replace(recording, channels=channels, notes=notes))


def _with_imposed(recording: Recording) -> Recording:
    """With what its terminals or its shaft impose also where that was computed from the voltage: a drive was told it."""
    imposed = {
        quantity: y
        for quantity, y in recording.computed.items()
        if np.any(_imposed(recording.channels, quantity))
    }
    told = tuple(
        note for note in recording.notes if not (COMPUTED in note and note.startswith(tuple(imposed)))
    )
    return replace(recording, channels={**recording.channels, **imposed}, notes=told)


def _imposed(channels: Mapping[str, Array], quantity: str) -> NDArray[np.bool_]:
    """(N,) where something imposes a quantity on the motor; (0,) if its channels say nothing of it."""
    end, to = IMPOSED_BY[quantity]
    return np.asarray(channels.get(end, np.zeros(0)) == to)


def inputs_of(
    recording: Recording, ambient_C: float, *, held: bool | tuple[bool, bool, bool] = False
) -> Inputs:
    """What acted on the motor of a recording: its voltage, its load and ambient, and what imposed its current or speed.

    Args:
        recording: what was measured.
        ambient_C: where the ambient was not.
        held: see `Inputs`.

    Raises:
        DataError: a current or a speed that something imposes was not recorded, or is missing somewhere.
    """
    channels, nothing = recording.channels, np.zeros(len(recording))
    terminal, shaft = channels.get("terminal"), channels.get("shaft")
    imposed = {}
    for quantity, (_, by) in IMPOSED_BY.items():
        where = _imposed(channels, quantity)
        if not where.any():
            continue
        if quantity not in channels:
            raise DataError(
                f"{recording.name}: {quantity} is imposed ({by.name.lower()}), but was not recorded"
            )
        shown = channels[quantity]
        if quantity == "speed" and recording.speed_from_angle:
            # What turns a motor acts at the samples: the speed there, and not the mean until then.
            shown = np.gradient(channels["angle"], recording.time_s)
        imposed[canonical_name(quantity)] = np.where(where, shown, 0.0)
    return Inputs(
        recording.time_s,
        channels["voltage"],
        channels.get("load_torque", nothing),
        channels.get("ambient", nothing + ambient_C),
        held,
        None if terminal is None else codes(Terminal, terminal, f"{recording.name}: terminal"),
        None if shaft is None else codes(Shaft, shaft, f"{recording.name}: shaft"),
        **imposed,
    )


def _other_unit(quantity: str, heading: str) -> str:
    """The unit that is taken, and how to say another."""
    taken, another = units_offered(quantity)[:2]
    return f"{taken}; were it {another}: --column {shlex.quote(f'{quantity}_{another}={heading}')}"


def _rising(table: Table) -> list[str]:
    """Headings of the columns that rise from row to row, as a time does."""
    found = []
    for index, heading in enumerate(table.headings):
        try:
            values = table.numbers([index])[index]
        except DataError:
            continue
        if len(values) > 1 and np.all(np.diff(values) > 0):
            found.append(heading)
    return found


def _about_columns(headings: Sequence[str], columns: Mapping[str, Column]) -> list[str]:
    """Which columns were not used, what they may be, and what was taken for granted of those that were."""
    notes = [
        f"{quantity}: no unit is given in {column.heading!r}; taken as {_other_unit(quantity, column.heading)}"
        for quantity, column in columns.items()
        if column.assumed
    ]
    for quantity, column in columns.items():
        if column.formula:
            notes += [f"{quantity} = {column.formula.text}"] + [
                f"{quantity}: {note}" for note in column.formula.notes
            ]
    used = {index for column in columns.values() for index in column.uses}
    spare = [heading for index, heading in enumerate(headings) if index not in used and heading.strip()]
    if spare:
        notes.append(f"not used: {', '.join(spare)}")
    for quantity in ("current", "speed", "temperature", "angle"):
        like = candidates(quantity, spare)
        if like and quantity not in columns:
            choice = shlex.quote(f"{quantity}={like[0]}")
            notes.append(f"no {quantity}; it may be {' or '.join(like)}: --column {choice}")
    if not {"speed", "angle"} & set(columns) and (formulas := speed_of(spare)):
        notes.append(
            f"no speed; it may be computed, with the constant of your machine: --column {shlex.quote(formulas[0])}"
        )
    return notes


@dataclass(frozen=True)
class _Reader:
    """One file on its way to a recording; `notes` grows as things are found."""

    path: Path
    columns: Mapping[str, Column]
    first_row: int
    notes: list[str]

    def recording(self, table: dict[str, Array], no_values: Iterable[float] | None) -> Recording:
        """The checked recording."""
        table = self._where_driven(self._without_words(self._in_reach(table), no_values))
        rows = len(table["time"])
        table = self._in_time(table)
        if len(table["time"]) == rows:  # those that were dropped have been told
            self.notes.extend(lost_samples(table["time"]))
        table = self._complete(table)
        from_angle = "speed" not in table and "angle" in table
        if from_angle:
            table |= self._speed_of_angle(table["time"], table["angle"])
        table, computed = self._measured(table)
        time = table.pop("time")
        for quantity, kind in (("terminal", Terminal), ("shaft", Shaft)):
            if quantity in table:
                table[quantity] = codes(kind, table[quantity], f"{self.path}: column {quantity!r}").astype(
                    np.float64
                )
        notes = (*self.notes, *gaps_and_channels(time, table))
        return _with_imposed(Recording(self.path.name, time, table, notes, computed, from_angle))

    def _row(self, index: int) -> int:
        return index + self.first_row

    def _in_reach(self, table: dict[str, Array]) -> dict[str, Array]:
        """Numbers beyond all that is measured at a motor become NaN: they could not even be squared."""
        checked = dict(table)
        for quantity, y in table.items():
            beyond = np.abs(y) > BEYOND
            if quantity != "time" and beyond.any():
                checked[quantity] = np.where(beyond, np.nan, y)
                finite = beyond & np.isfinite(y)
                if finite.any():
                    self.notes.append(
                        f"{int(finite.sum())} values of {quantity} are beyond all that is measured (first: row "
                        f"{self._row(int(np.argmax(finite)))}, {y[finite][0]:g}); left out"
                    )
        return checked

    def _without_words(self, table: dict[str, Array], no_values: Iterable[float] | None) -> dict[str, Array]:
        """Numbers that mean "no value" become NaN."""
        if no_values is not None:
            words = list(no_values)
            raw = {
                q: (y - self.columns[q].offset) / self.columns[q].factor
                for q, y in table.items()
                if q != "time"
            }
            hidden = {q: np.isclose(y[:, None], words, rtol=1e-9).any(axis=1) for q, y in raw.items()}
            return table | {q: np.where(hidden[q], np.nan, table[q]) for q in hidden}
        cleaned = dict(table)
        for quantity in sorted(table, key=lambda q: q not in INPUTS):
            if quantity == "time" or quantity in WORDS:
                continue
            column, y = self.columns[quantity], table[quantity]
            voltage = None if quantity in INPUTS else cleaned.get("voltage")
            if voltage is not None:
                finite = np.isfinite(voltage)
                voltage = (
                    np.where(finite, voltage, np.mean(voltage[finite])) if finite.any() else np.zeros(len(y))
                )
            word = no_value((y - column.offset) / column.factor, voltage)
            if word is not None:
                cleaned[quantity] = np.where(np.isclose(y, word * column.factor + column.offset), np.nan, y)
                self.notes.append(
                    f"{quantity} is exactly {word:g} in {int(np.isnan(cleaned[quantity]).sum() - np.isnan(y).sum())} "
                    'samples that stand out: taken for "no value" (if it was measured: --no-value none)'
                )
        return cleaned

    def _where_driven(self, table: dict[str, Array]) -> dict[str, Array]:
        """With a voltage where none drives the terminals: it need not be measured there, and counts for nothing."""
        if "terminal" not in table:
            return {"voltage": np.zeros(len(table["time"])), **table}
        driven = table["terminal"] == Terminal.DRIVEN
        if "voltage" not in table and driven.any():
            row = self._row(int(np.argmax(driven)))
            raise DataError(f"{self.path}: no voltage column, and from row {row} on the terminals are driven")
        voltage = table.get("voltage", np.full(len(driven), np.nan))
        return table | {"voltage": np.where(driven | np.isfinite(voltage), voltage, 0.0)}

    def _in_time(self, table: dict[str, Array]) -> dict[str, Array]:
        """Rows in the order of time: by the steady clock behind poor stamps, or without the few that run back."""
        time, heading = table["time"], self.columns["time"].heading
        missing = ~np.isfinite(time)
        if missing.any():
            row = self._row(int(np.argmax(missing)))
            _repairable(int(missing.sum()), len(time),
                        f"{self.path}: row {row}, column {heading!r}: time is missing; remove the row")  # fmt: skip
            self.notes.append(f"{int(missing.sum())} rows without a time dropped (first: row {row})")
            table = {q: y[~missing] for q, y in table.items()}
            time = table["time"]
        # A stamp not above all before it (a test stand's first row, a repeated frame) is dropped; many are a broken clock.
        forward = np.r_[True, time[1:] > np.maximum.accumulate(time)[:-1]]
        if time[0] > time[1]:
            forward = np.r_[False, True, time[2:] > np.maximum.accumulate(time[1:])[:-1]]
        dropped = int(np.sum(~forward))
        if not dropped:
            return table
        row = self._row(int(np.argmin(forward)))
        clock = steady(time) if dropped > REPAIRABLE_SHARE * len(time) else None
        if clock is not None:
            self.notes.append(
                f"time stamps repeat or run back, but follow a steady clock of {clock[0][1] - clock[0][0]:.6g} s within "
                f"{clock[1]:.2g} s, which was taken instead"
            )
            return table | {"time": clock[0]}
        _repairable(
            dropped,
            len(time),
            f"{self.path}: row {row}: time does not increase ({time[~forward][0]:g} s), nor do the stamps follow a steady "
            "clock; sort the rows, or split the file where the recorder was started anew",
        )
        self.notes.append(
            f"{dropped} of {len(time)} rows dropped because their time does not increase (first: row {row})"
        )
        return {q: y[forward] for q, y in table.items()}

    def _complete(self, table: dict[str, Array]) -> dict[str, Array]:
        """Inputs without missing values: a few are interpolated, the rows of more are left out; outputs keep NaN."""
        time = table["time"]
        lacking = np.zeros(len(time), dtype=bool)
        for quantity, y in table.items():
            missing = ~np.isfinite(y)
            if not missing.any():
                continue
            heading, count = self.columns[quantity].heading, int(missing.sum())
            row = self._row(int(np.argmax(missing)))
            if missing.all():
                raise DataError(f"{self.path}: column {heading!r} holds no numbers")
            if quantity in WORDS:
                known = ", ".join(WORDS[quantity])
                raise DataError(
                    f"{self.path}: row {row}, column {heading!r}: empty; write one of {known} in each row"
                )
            lost = f"{count} missing value{'s' if count > 1 else ''}"
            if quantity not in INPUTS:
                table[quantity] = np.where(missing, np.nan, y)
                self.notes.append(f"{lost} of {quantity} left out (first: row {row})")
            elif count <= REPAIRABLE_SHARE * len(y):
                table[quantity] = np.interp(time, time[~missing], y[~missing])
                self.notes.append(f"{lost} of {quantity} interpolated (first: row {row})")
            else:
                lacking |= missing
                if count > len(y) / 2:
                    raise DataError(
                        f"{self.path}: row {row}, column {heading!r}: a missing value in an input, and {count} of "
                        f"{len(y)} are; fill the column, or leave it out"
                    )
                self.notes.append(f"{count} rows without a value of {quantity} left out (first: row {row})")
        return {q: y[~lacking] for q, y in table.items()} if lacking.any() else table

    def _measured(self, table: dict[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
        """Without a current or a speed that was computed from the voltage, which would tell of its formula; and these."""
        kept, computed = dict(table), {}
        for quantity in ("current", "speed"):
            times = computed_from(table[quantity], table["voltage"]) if quantity in table else None
            if times is not None:
                computed[quantity] = kept.pop(quantity)
                how = "--terminal current" if quantity == "current" else "--shaft turned"
                self.notes.append(
                    f"{quantity} is {times:g} {COMPUTED}: computed from it, or the same column in another unit, and no "
                    f"measurement; it was left out (if it is what drives the motor: {how})"
                )
        return kept, computed

    def _speed_of_angle(self, time: Array, angle: Array) -> dict[str, Array]:
        """The mean speed since the sample before, from a measured angle, which is continued over its wraps.

        It is exact however the steps of time vary, and nothing is known of it at the first sample. Central differences would
        be the mean over two steps, which no speed of the motor is: it passes for a lag.
        """
        turn = 2 * np.pi
        finite = np.isfinite(angle)
        whole = angle[finite]
        if len(whole) < 3:
            return {}
        if np.ptp(whole) <= turn * 1.001 and np.abs(np.diff(whole)).max() > np.pi:
            angle = angle.copy()
            angle[finite] = np.unwrap(whole)
        self.notes.append(
            "no speed was measured; it is taken from the angle, as the mean since the sample before"
        )
        return {"angle": angle, "speed": np.append(np.nan, np.diff(angle) / np.diff(time))}


def _repairable(count: int, rows: int, complaint: str) -> None:
    if count > REPAIRABLE_SHARE * rows:
        raise DataError(complaint)
