"""The sums of the ledger against plain least squares on the stacked columns, and the null against its nominal rate."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.ledgers import BLOCKS, ROWS, book_of
from scipy.stats import chi2, expon, gumbel_r

from motorlens_workbench.evidence.ledger import Ledger
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.evidence.null import FLIPS, Null, null_of
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.hypotheses.hypothesis import Hypothesis


def score_of(book: Ledger, j: int = 0) -> Score:
    score = book.beside().score(book.entries[j])
    assert score is not None
    return score


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((ROWS, 6))
    columns[:, 3] += 2 * columns[:, 0]
    columns[:, 4] = 0.7 * columns[:, 3] + 0.1 * columns[:, 4]
    error = 0.3 * columns[:, 0] + 0.2 * columns[:, 3] + rng.standard_normal(ROWS)
    return columns, error


def test_a_score_is_what_regression_beside_the_priors_says(problem):
    """A prior is a pseudo-measurement: least squares with one more row a parameter, by numpy."""
    columns, error = problem
    score = score_of(book_of(columns[:, :2], [columns[:, 2:5]], error, pull=0.5))
    design = np.vstack([columns[:, :5], np.eye(2, 5)])
    target = np.append(error, [0.5, 0.5])
    full, rest, *_ = np.linalg.lstsq(design, target, rcond=None)
    without = np.linalg.lstsq(design[:, :2], target, rcond=None)[1]
    assert score.coefficient == pytest.approx(full[2:], rel=1e-8)
    assert score.gain == pytest.approx(without[0] - rest[0], rel=1e-8)
    assert score.covariance / score.scatter == pytest.approx(
        np.linalg.inv(design.T @ design)[2:, 2:], rel=1e-6
    )


def test_a_free_term_is_no_larger_than_what_drives_the_motor(problem):
    """Its typical size is the width of a prior: one more row of the regression for each of its columns."""
    columns, error = problem
    book = book_of(columns[:, :2], [columns[:, 2:4]], error)
    (entry,) = book.entries
    score = book.beside().score(replace(entry, hypothesis=replace(entry.hypothesis, typical=0.01)))
    assert score is not None
    design = np.vstack([columns[:, :4], np.diag([1.0, 1.0, 100.0, 100.0])])
    full = np.linalg.lstsq(design, np.append(error, np.zeros(4)), rcond=None)[0]
    assert score.coefficient == pytest.approx(full[2:], rel=1e-6)
    # Without it the second of the columns is at 0.2.
    assert abs(score.coefficient[1]) < 0.15 < abs(score_of(book).coefficient[1])


def test_moves_beside_a_shape_are_those_of_the_regression(problem):
    columns, error = problem
    book = book_of(columns[:, :2], [columns[:, 2:3]], error)
    score = score_of(book)
    design = np.vstack([columns[:, :3], np.eye(2, 3)])
    full = np.linalg.lstsq(design, np.append(error, [0.0, 0.0]), rcond=None)[0]
    moves = book.beside().moves_with(book.entries[0], score.coefficient)
    assert moves == pytest.approx(full[:2], rel=1e-8)


def test_what_was_accepted_counts_as_missing_where_it_is_the_target(problem):
    """Without p1 among the given, and with it twice in the errors: the regression of such errors on the others."""
    columns, error = problem
    book = book_of(columns[:, :2], [columns[:, 2:3]], error)
    score = book.beside(["p0"], {"p1": 2.0}).score(book.entries[0])
    assert score is not None
    design = np.vstack([columns[:, [0, 2]], np.eye(1, 2)])
    full = np.linalg.lstsq(design, np.append(error + 2 * columns[:, 1], 0.0), rcond=None)[0]
    assert score.coefficient == pytest.approx(full[1:], rel=1e-8)


def test_a_copy_of_fitted_columns_says_nothing(problem):
    columns, error = problem
    # The prior of a column as informative as this is nothing beside the data.
    base = 1e6 * columns[:, :2]
    copy = 2 * base[:, :1] - base[:, 1:2]
    book = book_of(base, [copy], error)
    assert book.beside().score(book.entries[0]) is None


def test_what_a_free_term_does_within_one_block_of_time_is_not_tested(problem):
    """It has no other block to agree with; what has a name may stand on one, and what shows in two is tested."""
    columns, error = problem
    once, twice, rows = np.zeros((ROWS, 1)), np.zeros((ROWS, 1)), ROWS // BLOCKS
    once[3 * rows : 4 * rows] = 1.0
    twice[3 * rows : 5 * rows] = 1.0
    book = book_of(columns[:, :2], [once, twice, np.hstack([once, columns[:, 2:4]])], error)
    alone, two, both = (book.beside().score(entry) for entry in book.entries)
    assert alone is None
    assert two is not None and two.width == 1
    assert both is not None and both.width == 2 and both.coefficient[0] == 0.0
    rest = score_of(book_of(columns[:, :2], [columns[:, 2:4]], error))
    assert both.gain == pytest.approx(rest.gain)
    entry = book.entries[0]
    # As it is weighed where it is looked for, and where it stands in the model.
    for kind, typical in (("effect", 1.0), ("unnamed", np.inf)):
        named = replace(entry.hypothesis, kind=kind, key="effect.size", typical=typical)
        assert book.beside().score(replace(entry, hypothesis=named)) is not None


@pytest.mark.parametrize(("kind", "chosen"), [("effect", "scatters"), ("unnamed", "agrees")])
def test_of_a_name_the_shape_that_explains_most_is_taken_and_of_a_free_term_that_which_agrees(
    problem, kind, chosen
):
    """With names by weight, a real drive (EMPS) was answered with an armature reaction instead of its friction."""
    columns, error = problem
    shape = dict(zip(("scatters", "agrees"), columns[:, 2:4].T, strict=True))
    # Of either sign in every fourth block, and on the whole the larger; and the same in all of them.
    sign = np.repeat(np.where(np.arange(BLOCKS) % 4 == 0, -1.0, 1.0), ROWS // BLOCKS)
    error = error + 1.2 * sign * shape["scatters"] + 0.3 * shape["agrees"]
    book = book_of(columns[:, :2], [column[:, None] for column in shape.values()], error)
    hypothesis = Hypothesis(
        "h", kind, "electrical", tuple(entry.shape for entry in book.entries), typical=1.0
    )
    scores = [book.beside().score(replace(entry, hypothesis=hypothesis)) for entry in book.entries]
    told = dict(zip(shape, scores, strict=True))
    assert told["scatters"].gain > told["agrees"].gain
    assert told["scatters"].weight < told["agrees"].weight
    assert best_of(scores)["h"] is told[chosen]


def test_shapes_of_any_width_are_tested_together_and_stay_in_their_order():
    """Each as by regression on its own; copies of the fitted columns, among them, say nothing."""
    rng = np.random.default_rng(7)
    base, error = 1e4 * rng.standard_normal((ROWS, 2)), rng.standard_normal(ROWS)
    widths = [1, 2, 1, 4] * 40
    shapes = [rng.standard_normal((ROWS, width)) for width in widths]
    shapes[2] = base[:, :1] - base[:, 1:]
    scores = book_of(base, shapes, error).scores()
    assert [score.name for score in scores] == [f"h{j}" for j in range(len(widths)) if j != 2]
    for score in scores[:: len(scores) - 1]:
        columns = shapes[int(score.name[1:])]
        full = np.linalg.lstsq(np.hstack([base, columns]), error, rcond=None)[0]
        assert score.coefficient == pytest.approx(full[2:], rel=1e-5)
    by_hand = [np.linalg.lstsq(np.hstack([base, columns]), error, rcond=None)[1] for columns in shapes]
    alone = np.linalg.lstsq(base, error, rcond=None)[1]
    gains = [float((alone - rest)[0]) for j, rest in enumerate(by_hand) if j != 2]
    assert [score.gain for score in scores] == pytest.approx(gains, rel=1e-5)


def test_slow_noise_makes_scatter_and_not_weight():
    """A random walk of blocks in the errors makes nominal gains huge; the statistic stays a chi-squared."""
    rng = np.random.default_rng(2)
    column = np.sin(np.arange(ROWS) / 900)[:, None]
    statistics, gains = [], []
    for _ in range(100):
        slow = np.repeat(rng.standard_normal(BLOCKS), ROWS // BLOCKS)
        score = score_of(book_of(np.zeros((ROWS, 0)), [column], slow + rng.standard_normal(ROWS)))
        statistics.append(score.gain / score.scatter)
        gains.append(score.gain)
    assert np.mean(gains) > 20
    assert 0.4 < np.mean(statistics) < 1.4


def many(rng: np.random.Generator, size: float = 0.0) -> list[Score]:
    """Eight shapes of one to six columns on white noise, and the first at a size."""
    base = rng.standard_normal((640, 2))
    shapes = [rng.standard_normal((640, width)) for width in (1, 1, 3, 6) * 2]
    error = rng.standard_normal(640) + size * shapes[0][:, 0]
    return book_of(base, shapes, error).scores()


@pytest.mark.fit
def test_the_largest_of_all_shapes_is_beyond_its_null_as_often_as_is_stated():
    """Pure noise, a thousand worlds through the whole search: at the 5 % point of Gumbel's distribution some 5 %."""
    rng = np.random.default_rng(4)
    at_five, beyond = -np.log(-np.log(0.95)), 0
    for _ in range(1000):
        scores = many(rng)
        null = null_of(scores, rng)
        assert null is not None
        beyond += null.excess(max(score.weight for score in scores)) > at_five
    assert 0.02 < beyond / 1000 < 0.08


def test_no_null_is_narrower_than_that_of_a_single_test():
    """Of one shape on noise of known scatter: minus the logarithm of a probability is exponential, of deviation one."""
    rng, scales = np.random.default_rng(12), []
    for _ in range(100):
        score = score_of(
            book_of(np.zeros((640, 0)), [rng.standard_normal((640, 1))], rng.standard_normal(640))
        )
        null = null_of([replace(score, scatter=1.0)], rng)
        assert null is not None
        scales.append(null.scale)
    alone = expon.std() / gumbel_r.std()
    assert np.mean(scales) == pytest.approx(alone, rel=0.1)
    narrow, wide = Null(3.0, 0.1), Null(3.0, 2.0)
    assert narrow.weight(10.0) == pytest.approx(3.0 + 10.0 * alone)
    assert wide.weight(10.0) == pytest.approx(23.0)


def test_the_null_is_the_largest_of_every_shape_under_every_flip():
    """Shape by shape and flip by flip, written out, the weight by scipy."""
    scores = many(np.random.default_rng(8))
    signs = np.random.default_rng(9).choice([-1.0, 1.0], (FLIPS, len(scores[0].rests)))
    largest = [
        max(
            -chi2.logsf(flipped @ score.inverse @ flipped / score.scatter, score.width)
            for score in scores
            for flipped in (sign @ score.rests,)
        )
        for sign in signs
    ]
    null = null_of(scores, np.random.default_rng(9))
    assert null is not None
    # Mean and standard deviation of Gumbel's distribution.
    assert null.mode + np.euler_gamma * null.scale == pytest.approx(np.mean(largest), rel=1e-9)
    assert np.pi / np.sqrt(6) * null.scale == pytest.approx(np.std(largest), rel=1e-9)


def test_power_rises_with_size():
    found = []
    for size in (0.0, 0.15, 0.3, 0.6):
        rng, excess = np.random.default_rng(5), []
        for _ in range(20):
            scores = many(rng, size)
            null = null_of(scores, rng)
            assert null is not None
            excess.append(null.excess(scores[0].weight))
        found.append(np.mean(excess))
    assert found[0] < 0 < found[2]
    assert np.all(np.diff(found) > 1.0)


def test_a_detectable_size_is_detected_as_often_as_it_says():
    rng = np.random.default_rng(6)
    column = rng.standard_normal((ROWS, 1))
    nothing = np.zeros((ROWS, 0))
    size = score_of(book_of(nothing, [column], rng.standard_normal(ROWS))).detectable(15.0)
    reached = [
        score_of(book_of(nothing, [column], size * column[:, 0] + rng.standard_normal(ROWS))).weight
        for _ in range(100)
    ]
    assert 0.8 < np.mean(reached) / 15.0 < 1.2


def test_what_the_recordings_do_not_show_is_detectable_at_no_size_that_it_may_have():
    """Of a column that the base parameters explain but for rounding the information says thousands of typical sizes."""
    rng = np.random.default_rng(8)
    base, seen, rounding = (rng.standard_normal((ROWS, 1)) for _ in range(3))
    unseen = 1e-3 * base + 1e-5 * rounding
    book = book_of(base, [unseen, seen], rng.standard_normal(ROWS))
    named = replace(score_of(book).entry.hypothesis, name="named", kind="effect")
    there, hidden = (
        replace(score, entry=replace(score.entry, hypothesis=named))
        for score in (score_of(book, 1), score_of(book))
    )
    assert 1e3 < score_of(book).detectable(15.0) < np.inf
    assert hidden.detectable(15.0) == np.inf
    assert there.detectable(15.0) == score_of(book, 1).detectable(15.0) < 1.0


def test_errors_of_a_fifth_of_all_folds_are_those_of_parameters_fitted_to_the_others(problem):
    """Held out by hand: the regression on the other blocks, of which the prediction of a fold is made."""
    from types import SimpleNamespace

    from motorlens_workbench.evidence.held_out import FOLDS, held_out_errors

    columns, error = problem
    base = columns[:, :2]
    book = book_of(base, [], error)
    line = SimpleNamespace(error=error[:, None], own=base[:, None, :], keys=book.keys, r=0)
    (found,) = held_out_errors(book, [line])  # type: ignore[list-item]
    fold = np.repeat(np.arange(BLOCKS) % FOLDS, ROWS // BLOCKS)
    for k in range(FOLDS):
        kept = fold != k
        design = np.vstack([base[kept], np.eye(2)])
        fitted = np.linalg.lstsq(design, np.append(error[kept], [0.0, 0.0]), rcond=None)[0]
        assert found[~kept, 0] == pytest.approx((error - base @ fitted)[~kept], abs=1e-9)


def test_what_one_block_nearly_alone_tells_stays_where_that_is_held_out(problem):
    """An inertia, by the only start from rest: as the others tell it, the start would be far off."""
    from types import SimpleNamespace

    from motorlens_workbench.evidence.held_out import FOLDS, held_out_errors

    columns, error = problem
    fold = np.repeat(np.arange(BLOCKS) % FOLDS, ROWS // BLOCKS)
    base, first = columns[:, :2].copy(), np.arange(ROWS) < ROWS // BLOCKS
    base[:, 1] *= 0.03
    base[first, 1] = 3.0
    error = error + np.where(first, 0.0, base[:, 1])
    book = book_of(base, [], error)
    line = SimpleNamespace(error=error[:, None], own=base[:, None, :], keys=book.keys, r=0)
    (found,) = held_out_errors(book, [line])  # type: ignore[list-item]
    alone = np.linalg.lstsq(base[fold > 0], error[fold > 0], rcond=None)[0]
    left, otherwise = error[first] - found[first, 0], (base @ alone)[first]
    # With it where it is, the rest is the regression on the other column.
    only = base[fold > 0, 0] @ error[fold > 0] / np.sum(base[fold > 0, 0] ** 2)
    assert np.sqrt(np.mean((left - only * base[first, 0]) ** 2)) < 0.1 < 1.0 < np.sqrt(np.mean(otherwise**2))


def test_what_is_left_is_shared_out_to_recordings_in_units_of_their_noise():
    """Of two runs one is twice as far off in a channel of half the noise: 16 of 17 parts of the squares."""
    from types import SimpleNamespace

    from motorlens_workbench.evidence.held_out import by_run

    book, there = book_of(np.zeros((ROWS, 0)), [], np.zeros(ROWS)), np.ones((ROWS, 1), dtype=bool)
    lines = [
        SimpleNamespace(
            error=np.full((ROWS, 1), error), own=np.zeros((ROWS, 1, 0)), keys=(), r=r,
            run=SimpleNamespace(channels=(channel,), there=there, noise=None),
        )
        for r, (channel, error) in enumerate((("current", 1.0), ("speed", 2.0)))
    ]  # fmt: skip
    blocks = tuple((r, rows) for r in range(2) for _, rows in book.blocks)
    book = replace(book, blocks=blocks, base=np.concatenate([book.base, book.base]))
    found = by_run(book, lines, {"current": 1.0, "speed": 0.5})
    np.testing.assert_allclose(found, [1 / 17, 16 / 17])


def test_a_named_size_beyond_physics_is_not_possible():
    rng = np.random.default_rng(7)
    column = 1e-3 * rng.standard_normal((ROWS, 1))
    book = book_of(np.zeros((ROWS, 0)), [column], 1e3 * column[:, 0] + rng.standard_normal(ROWS))
    entry = book.entries[0]
    named = replace(entry, hypothesis=replace(entry.hypothesis, kind="effect"))
    free, bound = book.beside().score(entry), book.beside().score(named)
    assert free is not None and free.possible
    assert bound is not None and not bound.possible
