"""What an answer is called, of errors and likelihoods as contests have left them."""

from types import SimpleNamespace

import pytest

from motorlens_workbench import verdict
from motorlens_workbench.verdict import _no_more_than_a_part


@pytest.mark.parametrize(
    ("before", "after", "colour", "part"),
    [(6.8, 6.0, 50.0, True), (8.4, 5.3, 50.0, False), (8.4, 5.3, 150.0, True), (6.0, 4.4, 50.0, False)],
    ids=["less than half of the errors", "more than half", "less than is correlated", "the rest is noise"],
)
def test_names_that_explain_less_than_what_remains_are_no_more_than_a_part(
    monkeypatch: pytest.MonkeyPatch, before: float, after: float, colour: float, part: bool
) -> None:
    """The lag of a current sensor stood for the backlash of a shaft alone: 6.8 times the noise off before it, 6.0 after."""
    ends = [
        SimpleNamespace(book=SimpleNamespace(colour=colour), lines=times, floor={}, times_noise=times)
        for times in (before, after)
    ]
    monkeypatch.setattr(verdict, "times_noise", lambda book, times, floor: times)
    found = SimpleNamespace(outcome=SimpleNamespace(first=ends[0], last=ends[1]))
    name = SimpleNamespace(gain=50.0, scatter=2.0)
    assert _no_more_than_a_part(found, [name]) is part  # type: ignore[arg-type,list-item]


@pytest.mark.parametrize(("colour", "kind"), [(13_380.0, "unknown"), (50.0, "not_testable")])
def test_what_was_explained_by_a_name_that_does_not_hold_is_missing(
    monkeypatch: pytest.MonkeyPatch, colour: float, kind: str
) -> None:
    """A ripple that left nothing correlated, but whose size was in doubt: the answer was that nothing is missing."""
    rest = SimpleNamespace(entry=SimpleNamespace(hypothesis=SimpleNamespace(equation="coupling")))
    first, last = (
        SimpleNamespace(book=SimpleNamespace(colour=left), times_noise=times, rest=rest, scores=())
        for left, times in ((colour, 1.8), (0.7, 1.1))
    )
    outcome = SimpleNamespace(first=first, last=last, accepted=(SimpleNamespace(),), unnamed=None)
    found = SimpleNamespace(outcome=outcome, dead=(), runs=[SimpleNamespace(moves=True)])
    assert verdict._kind(found, [], verdict._told(found, []))[0] == kind  # type: ignore[arg-type]
    # A name that holds because of the motor file alone has explained what it did; and where none has entered, it is a
    # likelier fit of the same model that is told.
    held = verdict._told(found, outcome.accepted)  # type: ignore[arg-type]
    outcome.accepted = ()
    for told in (held, verdict._told(found, [])):  # type: ignore[arg-type]
        assert verdict._kind(found, [], told)[0] == "not_testable"  # type: ignore[arg-type]
