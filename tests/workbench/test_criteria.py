"""The numbers that decide a diagnosis, each from both sides: by what others draw, by chance, or by what is meant by it."""

import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.hidden.effects import CATALOGUE
from helpers.hidden.motors import MOTORS
from helpers.ledgers import ROWS, book_of

from motorlens_physics.motor_file import read_motor_file
from motorlens_workbench.contest.bayes_factor import simplest
from motorlens_workbench.contest.rivals import Rivals, rivals_of
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.fitted import Accepted
from motorlens_workbench.hypotheses.effects import catalogue, of_effect
from motorlens_workbench.hypotheses.hypothesis import Hypothesis


def sized(coefficient: float, *, information: float = 1e6, gain: float = 100.0) -> Score:
    """A single column of an effect that may have either sign and any size."""
    one = np.array([[1.0]])
    anything = SimpleNamespace(limits=lambda: (-np.inf, np.inf))
    entry = SimpleNamespace(shape=anything, hypothesis=Hypothesis("one", "effect", "mechanical", ()))
    return Score(
        entry, np.array([coefficient]), one / information, one * information, gain, 1.0, 20.0, 1, np.zeros((4, 1)), one,
    )  # type: ignore[arg-type]  # fmt: skip


@pytest.mark.parametrize("motor", MOTORS.values(), ids=lambda motor: motor.name)
def test_an_effect_may_be_as_large_as_another_generator_makes_it_and_not_all_that_drives_the_motor(motor):
    with tempfile.TemporaryDirectory() as folder:
        file = read_motor_file(motor.write_datasheet(Path(folder) / "motor.toml"))
    driven = {"voltage": file.rated.voltage_V, "torque": file.rated.torque_Nm}
    for name, drawn in CATALOGUE.items():
        typical = of_effect(catalogue()[name], file).typical
        assert sized(drawn.largest * drawn.unit(motor) / typical).possible, name
        (quantity, power), *more = drawn.of.items() or [("", 0)]
        if quantity in driven and power == 1 and not more:
            assert not sized(driven[quantity] / typical).possible, name


def test_a_group_holds_the_truth_in_19_of_20_and_would_not_without_its_last():
    rng = np.random.default_rng(0)
    for _ in range(200):
        names = [f"n{k}" for k in range(int(rng.integers(1, 8)))]
        probability = dict(zip(names, rng.dirichlet(np.full(len(names), 0.3)).tolist(), strict=True))
        likeliest = max(names, key=lambda name: probability[name])
        group = Rivals(likeliest, probability, {}).group
        held = sum(probability[name] for name in group)
        assert held >= 0.95
        assert held - probability[group[-1]] < 0.95


def test_a_bump_is_told_rather_than_a_curve_that_leaves_little_less():
    """What eighteen columns win more than one by is what eighteen win by chance, or what the linearised problem errs by."""

    def challenger(width: int, won: float) -> SimpleNamespace:
        return SimpleNamespace(score=SimpleNamespace(width=width), won=won)

    curve = challenger(18, 300.0)
    for won, told in ((300.0 - 18.0, 1), (300.0 - 100.0, 18)):
        assert simplest([curve, challenger(1, won)]).score.width == told  # type: ignore[list-item]


def test_the_doubt_of_a_correction_is_what_a_hundred_samples_leave_in_the_variance_behind_it():
    """Noise of an input makes a column and the error alike by its variance, which is taken out as it was estimated."""
    rng = np.random.default_rng(1)
    noise, signal, error = (
        3.0 * rng.standard_normal(ROWS),
        rng.standard_normal(ROWS),
        rng.standard_normal(ROWS),
    )
    other = rng.standard_normal((ROWS, 1))

    def size(left: float) -> float:
        """By least squares, if this share of the noise's variance is left in a column and, turned round, in the error."""
        column, seen = signal + np.sqrt(left) * noise, error + 0.2 * signal - 0.1 * np.sqrt(left) * noise
        return float(np.linalg.lstsq(np.column_stack([column, other]), seen)[0][0])

    estimates = np.mean(rng.standard_normal((400, 100)) ** 2, axis=1)
    scatter = np.mean([(size(abs(1 - estimate)) - size(0.0)) ** 2 for estimate in estimates]) * np.sum(
        signal**2
    )
    corrected, measured = (
        book_of(other, [(signal + left * noise)[:, None]], error + 0.2 * signal - 0.1 * left * noise)
        for left in (0.0, 1.0)
    )
    (score,), (entry,), (noisy,) = corrected.scores(), corrected.entries, measured.entries
    again = corrected.noisier(measured).beside().score(entry.towards(noisy, CRITERIA.doubt))
    assert 1.0 <= score.doubt_of(again) / scatter <= 4.0
    # What would not be told at all may be nothing.
    assert score.doubt_of(None) == pytest.approx(score.gain, rel=1e-6)


@pytest.mark.parametrize(
    ("size", "less", "stands"),
    [(100.0, 0.002, True), (100.0, 0.03, False), (0.7, 0.03, True), (0.7, 0.3, False)],
)
def test_a_rival_stands_beside_a_name_where_it_explains_a_few_thousandths_less(size, less, stands):
    """No friction is a tanh: what is right in kind is a twentieth off in shape, a few thousandths of what it explains.

    A name explains the square of its size, a rival as much but for what the angle between both takes away. Where that is no
    more than chance explains, what explains nearly as much stands beside it, and what cannot be seen does not.
    """
    rng = np.random.default_rng(2)
    name, other = np.linalg.qr(rng.standard_normal((ROWS, 2)))[0].T
    rival = np.sqrt(1 - less) * name + np.sqrt(less) * other
    error = size / 100 * rng.standard_normal(ROWS)
    book = book_of(name[:, None], [100 * rival[:, None]], error)
    (entry,) = book.entries
    hypothesis = Hypothesis("rival", "effect", "mechanical", (entry.shape,), "rival.size", 1.0)
    entry = type(entry)(hypothesis, entry.shape, entry.cross, entry.inner)
    book = type(book)(
        **{**vars(book), "keys": ("name.size",), "unit": {"name.size": 1.0}, "entries": (entry,)}
    )
    # An effect that is in no motor has no twin.
    motor = SimpleNamespace(effect=lambda name: None)
    file = SimpleNamespace(meaning=lambda key: SimpleNamespace(null=0.0), motor=motor)
    model = SimpleNamespace(file=file, values=lambda: {"name.size": size})
    here = SimpleNamespace(
        fitted=SimpleNamespace(model=model, prior=SimpleNamespace(sd={"name.size": 1.0})), book=book
    )
    itself = Hypothesis("name", "effect", "mechanical", (entry.shape,), "name.size", 100.0)
    group = rivals_of(here, Accepted(itself, 1e4, 1.0, 100.0)).group  # type: ignore[arg-type]
    assert group == (("name", "rival") if stands else ("name",))
