"""Arguments that training commands share."""

from motorlens_runtime.errors import DataError


def hidden_layers(text: str) -> tuple[int, ...]:
    """`12-8` as (12, 8); `0` as no hidden layer.

    Raises:
        DataError: not such a list.
    """
    try:
        widths = tuple(int(width) for width in text.split("-"))
    except ValueError:
        raise DataError(f"--hidden {text}: write widths such as 12-8, or 0 for a linear model") from None
    if widths == (0,):
        return ()
    if min(widths) < 1 or sum(widths) > 500:
        raise DataError(f"--hidden {text}: each layer needs a unit, and 500 units in all are the limit")
    return widths
