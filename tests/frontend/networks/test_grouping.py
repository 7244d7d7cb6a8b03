import torch

from polhode.frontend.networks.grouping import Grouping

GROUP = torch.tensor([2, 0, 2, 2, 0])


def test_rows_are_spread_in_their_order_and_come_back() -> None:
    rows = torch.arange(10.0).reshape(5, 2)
    groups = Grouping.of(GROUP, 4)
    spread = groups.spread(rows)
    assert spread.shape == (4, 3, 2)
    assert spread[2].tolist() == [[0, 1], [4, 5], [6, 7]]
    assert spread[0].tolist() == [[2, 3], [8, 9], [0, 0]]
    assert torch.equal(groups.gather(spread), rows)
    assert groups.known().tolist() == [[True, True, False], [False] * 3, [True] * 3, [False] * 3]


def test_sums_are_those_of_the_groups() -> None:
    assert Grouping.of(GROUP, 4).sums(torch.arange(1.0, 6.0)).tolist() == [7.0, 0.0, 8.0, 0.0]


def test_gradients_pass_both_ways() -> None:
    rows = torch.randn(5, 2, dtype=torch.double, requires_grad=True)

    def there_and_back(values: torch.Tensor) -> torch.Tensor:
        groups = Grouping.of(GROUP, 4)
        return groups.gather(groups.spread(values) ** 2)

    assert torch.autograd.gradcheck(there_and_back, (rows,))
