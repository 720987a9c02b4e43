"""What README's test command leaves out is chosen test by test: each package keeps tests, and each kept case exists."""

from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace

import pytest

TESTS = Path(__file__).parent
WHOLLY_LONG = {"browser"}


def folder(item: pytest.Item) -> str | None:
    """Name of the package that a test is for; None for doctests and tests of the whole."""
    inside = item.path.parent.relative_to(TESTS).parts if item.path.is_relative_to(TESTS) else ()
    return inside[0] if inside else None


def test_cases_that_are_kept_exist(request):
    cases, kept = defaultdict(set), defaultdict(set)
    for item in request.session.items:
        function = item.nodeid.partition("[")[0]
        for mark in item.iter_markers("slow"):
            cases[function].add(item.callspec.id if hasattr(item, "callspec") else "")
            kept[function] |= set(mark.kwargs.get("keep", ()))
    assert {
        function: kept[function] - cases[function] for function in kept if kept[function] - cases[function]
    } == {}


def test_every_package_keeps_tests_of_its_own(request, is_long):
    items = [item for item in request.session.items if folder(item)]
    short = {folder(item) for item in items if not is_long(item)}
    assert {folder(item) for item in items} - short <= WHOLLY_LONG


class Marked:
    """As much of a test as the choice looks at."""

    def __init__(self, *marks: pytest.MarkDecorator, case: str | None = None) -> None:
        self.marks = [decorator.mark for decorator in marks]
        if case is not None:
            self.callspec = SimpleNamespace(id=case)

    def iter_markers(self, name: str) -> list[pytest.Mark]:
        return [mark for mark in self.marks if mark.name == name]


def test_slow_means_all_cases_but_those_that_are_kept(is_long):
    slow, keep = pytest.mark.slow, pytest.mark.slow(keep=["a"])
    assert is_long(Marked(slow))
    assert is_long(Marked(slow, case="a"))
    assert is_long(Marked(keep, case="b"))
    assert is_long(Marked(keep, slow, case="a"))
    assert not is_long(Marked(keep, case="a"))
    assert not is_long(Marked(pytest.mark.realdata))


def test_bounds_follow_the_number_of_trials(sample):
    assert 0 < sample.trials(10) <= 10
    assert sample.within(0.1) ** 2 * sample.trials(1000) == pytest.approx(0.01 * 1000)
