"""Jobs over processes: results in order, whatever the number of workers; an error reaches the caller."""

from dataclasses import dataclass

import pytest

from polhode.frontend.parallel import in_order


@dataclass(frozen=True)
class Job:
    """Squares; fails at one number."""

    bad: int = -1

    def __call__(self, k: int) -> int:
        if k == self.bad:
            raise ValueError(f"frame {k}")
        return k * k


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_results_come_in_order(workers: int) -> None:
    assert list(in_order(Job(), 20, workers)) == [k * k for k in range(20)]
    assert list(in_order(Job(), 0, workers)) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_reaches_the_caller_after_the_results_before_it(workers: int) -> None:
    results = in_order(Job(bad=5), 9, workers)
    assert [next(results) for _ in range(5)] == [0, 1, 4, 9, 16]
    with pytest.raises(ValueError, match="frame 5"):
        next(results)
