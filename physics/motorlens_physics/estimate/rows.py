"""Rows of small matrices, each dealt with at once: what a processor's vector instructions are for.

Loops over the few columns of a small matrix are unrolled by the compiler and then run number by number. Here code is written
for whole rows. They are a multiple of `LANES` long, which the compiler knows from the length of a tuple, `every`; matrices
have such rows, one after another, float64. As in all machine code, nothing is checked: a row that is not there is read.
"""

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

# Numbers that are dealt with at once, at least: of 256 bits.
LANES = 4
# What is infinite stays so; products and sums may be fused.
FUSED = ("contract", "reassoc", "nsz")
NUMBER, LANE, ADDRESS = ir.DoubleType(), ir.IntType(32), ir.IntType(64)
BYTES = 8


def lanes(numbers: int) -> tuple[float, ...]:
    """Zeros, as many as a row has that holds at least so many numbers.

    >>> len(lanes(3)), len(lanes(4)), len(lanes(7))
    (4, 4, 8)
    """
    return (0.0,) * (LANES * -(-numbers // LANES))


@intrinsic  # type: ignore[untyped-decorator]
def add_to_row(typing: Any, every: Any, to: Any, r: Any, factor: Any, of: Any, q: Any) -> Any:
    """Let to[r] += factor * of[q]."""
    return _compiled(
        (every, to, types.intp, types.float64, of, types.intp),
        lambda row, to, r, factor, of, q: row.write(
            to, r, row.combined([(factor, row.read(of, q))], row.read(to, r))
        ),
    )


@intrinsic  # type: ignore[untyped-decorator]
def set_row(typing: Any, every: Any, some: Any, to: Any, r: Any, factors: Any, q: Any, of: Any) -> Any:
    """Let to[r] = factors[q, :k] @ of[:k], k the length of `some`."""
    return _product(every, some, to, factors, of, lambda q, m: (q, m))


@intrinsic  # type: ignore[untyped-decorator]
def set_row_by_column(
    typing: Any, every: Any, some: Any, to: Any, r: Any, factors: Any, c: Any, of: Any
) -> Any:
    """Let to[r] = factors[:k, c] @ of[:k], k the length of `some`."""
    return _product(every, some, to, factors, of, lambda c, m: (m, c))


def _product(
    every: Any, some: Any, to: Any, factors: Any, of: Any, place: Callable[[Any, Any], tuple[Any, Any]]
) -> Any:
    """Of factors that stand at a `place`, given the number of the row or the column and that of the factor."""

    def write(row: "_Rows", _: Any, to: Any, r: Any, factors: Any, at: Any, of: Any) -> None:
        numbers = map(ADDRESS, range(some.count))
        row.write(to, r, row.combined([(row.one(factors, *place(at, m)), row.read(of, m)) for m in numbers]))

    return _compiled((every, some, to, types.intp, factors, types.intp, of), write)


class _Rows:
    """Writes code for rows of a length. Matrices come with their types."""

    def __init__(self, context: Any, builder: Any, length: int) -> None:
        self.context, self.builder, self.length = context, builder, length
        self.vector = ir.VectorType(NUMBER, length)

    def read(self, matrix: tuple[Any, Any], row: Any) -> Any:
        return self.builder.load(self._place(matrix, row, ADDRESS(0), self.vector), align=BYTES)

    def one(self, matrix: tuple[Any, Any], row: Any, column: Any) -> Any:
        return self.builder.load(self._place(matrix, row, column, NUMBER), align=BYTES)

    def write(self, matrix: tuple[Any, Any], row: Any, value: Any) -> None:
        self.builder.store(value, self._place(matrix, row, ADDRESS(0), self.vector), align=BYTES)

    def combined(self, pairs: Sequence[tuple[Any, Any]], total: Any = None) -> Any:
        """The sum of rows, each times a number, and of another."""
        nothing, firsts = (
            ir.Constant(self.vector, ir.Undefined),
            ir.Constant(ir.VectorType(LANE, self.length), None),
        )
        for factor, row in pairs:
            first = self.builder.insert_element(nothing, factor, LANE(0))
            product = self.builder.fmul(self.builder.shuffle_vector(first, nothing, firsts), row, flags=FUSED)
            total = product if total is None else self.builder.fadd(total, product, flags=FUSED)
        return total

    def _place(self, matrix: tuple[Any, Any], row: Any, column: Any, kind: Any) -> Any:
        begin = self.context.make_array(matrix[0])(self.context, self.builder, matrix[1]).data
        offset = self.builder.add(self.builder.mul(row, ADDRESS(self.length)), column)
        return self.builder.bitcast(self.builder.gep(begin, [offset]), kind.as_pointer())


def _compiled(arguments: tuple[Any, ...], write: Callable[..., None]) -> Any:
    """Signature and code, as `intrinsic` wants them."""

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        given = [
            (kind, value) if isinstance(kind, types.Array) else value
            for kind, value in zip(signature.args, values, strict=True)
        ]
        write(_Rows(context, builder, arguments[0].count), *given[1:])
        return context.get_dummy_value()

    return types.void(*arguments), code
