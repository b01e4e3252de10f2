"""Block-wise reading and writing of numbers, against Python's own `float` and `%.9g`."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorlens_runtime.files.csv_stream import _by_core
from motorlens_runtime.files.decimal_text import nine_digits, read, seconds, seconds_text, table
from motorlens_runtime.sensor.core_library import core

ONE_ENGINE = "it sets the core beside Python"

needs_core = pytest.mark.skipif(core().library is None, reason=f"no C core: {core().reason}")


def text_of(row):
    return bytes(row[row != 0]).decode()


def read_cells(cells):
    raw = np.frombuffer("".join(cell + "," for cell in cells).encode(), dtype=np.uint8)
    return read(raw, np.flatnonzero(raw == ord(",")))


plain = st.builds(
    lambda sign, whole, part: sign + whole + part,
    st.sampled_from(["", "-"]), st.text("0123456789", min_size=1, max_size=8),
    st.one_of(st.just(""), st.just("."), st.text("0123456789", min_size=1, max_size=7).map(lambda t: "." + t)),
)  # fmt: skip


@pytest.mark.fit
@given(st.lists(plain, min_size=1, max_size=50))
def test_plain_numbers_are_read_as_float_reads_them(cells):
    expected = np.array([float(cell) for cell in cells])
    values = read_cells(cells)
    assert values is not None and values.tobytes() == expected.tobytes()


@needs_core
@given(
    st.lists(
        st.one_of(
            plain, st.floats(allow_nan=False, allow_infinity=False).map(repr), st.floats().map("{:.17e}".format),
            st.text("0123456789.-+e nan\"x", max_size=24),
        ), min_size=1, max_size=8,
    )
)  # fmt: skip
def test_the_core_hands_a_table_back_or_reads_it_as_float_does(cells):
    """Numbers of any length and size; the column beside them is not looked at."""
    text = "".join(f"{cell},?\n" for cell in cells).encode()
    table = _by_core(text, 2, {0: "x"}, b",")
    if table is not None:
        assert table[:, 0].tobytes() == np.array([float(cell) for cell in cells]).tobytes()
    plain_alone = [cell for cell in cells if cell.strip("-").replace(".", "", 1).isdigit()]
    if plain_alone:
        expected = np.array([float(cell) for cell in plain_alone])
        table = _by_core("".join(f"{cell}\n" for cell in plain_alone).encode(), 1, {0: "x"}, b",")
        assert table is not None and table[:, 0].tobytes() == expected.tobytes()


@needs_core
@pytest.mark.parametrize("text", ["1,2\n3\n", "1,2\n3,4,5\n", "1,\n", "nan,1\n", "1, 2\n", "1,2", "-,1\n", ".,1\n",
                                  "1e,2\n", '1,"2\n', "\n", "+1,2\n", "0x1,2\n"])  # fmt: skip
def test_what_is_no_plain_table_is_handed_back(text):
    assert _by_core(text.encode(), 2, {0: "x", 1: "y"}, b",") is None


@given(
    st.lists(
        st.one_of(plain, st.text("0123456789.-+e nan,", max_size=20).filter(lambda t: "," not in t)),
        min_size=1,
        max_size=8,
    )
)
def test_what_is_not_plain_is_handed_back_or_read_right(cells):
    values = read_cells(cells)
    if values is not None:
        assert values.tolist() == [float(cell) for cell in cells]


@pytest.mark.fit
@settings(max_examples=300)
@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=1, max_size=40))
def test_nine_digits_of_any_float(values):
    rows = nine_digits(np.array(values))
    assert [text_of(row) for row in rows] == ["%.9g" % value for value in values]  # noqa: UP031


@pytest.mark.fit
def test_nine_digits_of_very_many():
    rng = np.random.default_rng(0)
    sizes = 10.0 ** rng.uniform(-15, 11, 200_000) * rng.choice([-1, 1], 200_000)
    edges = np.array(
        [
            float(f"{m}e{e}")
            for m in (1, 5, 9.99999999, 9.999999995, 1.000000005, 123.456)
            for e in range(-15, 12)
        ]
    )
    ties = (rng.integers(10**8, 10**9, 2000) + 0.5) / 2.0 ** rng.integers(0, 20, 2000)
    for values in (
        sizes,
        sizes.astype(np.float32).astype(float),
        edges,
        ties,
        np.arange(3000.0),
        np.zeros(3),
    ):
        rows = nine_digits(values)
        expected = ["%.9g" % value for value in values.tolist()]  # noqa: UP031
        wrong = [(text_of(r), e) for r, e in zip(rows, expected, strict=True) if text_of(r) != e]
        assert not wrong, wrong[:3]


@given(
    st.lists(
        st.one_of(st.integers(0, 9 * 10**18), st.integers(0, 10**7).map(lambda ms: ms * 10**6)),
        min_size=1,
        max_size=30,
    )
)
def test_seconds(times):
    rows = seconds(np.array(times, dtype=np.int64))
    for row, time_ns in zip(rows, times, strict=True):
        assert text_of(row) == seconds_text(time_ns)
        # In whole numbers: the quotient of integers is rounded once.
        assert float(text_of(row)) == time_ns / 10**9


def test_a_table_is_lines_of_csv():
    values = np.array([[1.5, -2.25], [np.nan, 1e-9]])
    lines = table(np.array([0, 1_500_000_000]), values, np.array([0, 4095], dtype=np.uint32)).decode()
    assert lines == "0.0,1.5,-2.25,0\n1.5,nan,1e-09,4095\n"
