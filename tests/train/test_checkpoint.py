"""A checkpoint gives back the training's state, executes nothing, and is one line when it is damaged."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from polhode.runtime.errors import InputError
from polhode.train.checkpoint import (
    CHECKPOINT,
    TrainingState,
    read_checkpoint,
    write_checkpoint,
)
from tests.trap import trap

SETTING = {"seed": 1, "size": (3, 4)}
STATE = TrainingState(step=3, elapsed_s=1.5, scaler={"scale": 2.0, "_growth_tracker": 7}, setting=SETTING)
Tensors = dict[str, Tensor]


def training(seed: int, steps: int = 3) -> tuple[nn.Module, torch.optim.AdamW]:
    """A model whose last parameter never gets a gradient."""
    torch.manual_seed(seed)
    model = nn.ModuleDict({"used": nn.Linear(4, 3), "unused": nn.Linear(2, 1, bias=False)})
    optimizer = torch.optim.AdamW(model.parameters(), lr=0.1)
    for _ in range(steps):
        optimizer.zero_grad()
        model["used"](torch.randn(5, 4)).square().mean().backward()
        optimizer.step()
    return model, optimizer


def read(folder: Path, model: nn.Module, optimizer: torch.optim.AdamW) -> TrainingState | None:
    return read_checkpoint(folder, SETTING, 10, model, optimizer)


def rewrite(file: Path, change: Callable[[Tensors, dict[str, Any]], Any]) -> None:
    with safe_open(file, "pt") as opened:
        header = json.loads(opened.metadata()["training"])
    tensors = load_file(file)
    change(tensors, header)
    save_file(tensors, file, metadata={"training": json.dumps(header)})


def test_the_state_is_read_as_it_was_written(tmp_path: Path) -> None:
    model, optimizer = training(0)
    write_checkpoint(tmp_path, STATE, model, optimizer)
    other, its_optimizer = training(1, steps=0)
    found = read(tmp_path, other, its_optimizer)
    assert found is not None
    assert (found.step, found.elapsed_s, found.scaler) == (3, 1.5, STATE.scaler)
    assert isinstance(found.scaler["_growth_tracker"], int)
    for mine, theirs in zip(other.parameters(), model.parameters(), strict=True):
        assert torch.equal(mine, theirs)
        for name, value in optimizer.state[theirs].items():
            assert torch.equal(its_optimizer.state[mine][name], value)
    again = tmp_path / "again"
    again.mkdir()
    write_checkpoint(again, found, other, its_optimizer)
    assert (again / CHECKPOINT).read_bytes() == (tmp_path / CHECKPOINT).read_bytes()


def test_without_a_checkpoint_there_is_no_state(tmp_path: Path) -> None:
    assert read(tmp_path, *training(0)) is None


def test_a_pickle_is_named_and_not_read(tmp_path: Path) -> None:
    sprung = tmp_path / "sprung"
    (tmp_path / CHECKPOINT).write_bytes(trap(sprung))
    with pytest.raises(InputError, match=rf"{CHECKPOINT}.*: remove it to start again"):
        read(tmp_path, *training(0))
    assert not sprung.exists()


WRONG: dict[str, tuple[Callable[[Tensors, dict[str, Any]], Any], str]] = {
    "a weight is missing": (
        lambda t, _: t.pop("model.used.bias"),
        "1 tensors differ, the first is model.used",
    ),
    "a tensor too many": (lambda t, _: t.update(more=torch.zeros(1)), "first is more: F32 1, expected none"),
    "another shape": (
        lambda t, _: t.update({"optimizer.0.exp_avg": torch.zeros(4, 3)}),
        "optimizer.0.exp_avg: F32 4 x 3, expected F32 3 x 4",
    ),
    "another kind of numbers": (
        lambda t, _: t.update({"model.used.bias": torch.zeros(3, dtype=torch.float64)}),
        "model.used.bias: F64 3, expected F32 3",
    ),
    "NaN": (lambda t, _: t["model.used.bias"].fill_(torch.nan), "model.used.bias holds NaN or infinity"),
    "infinity": (lambda t, _: t["optimizer.1.exp_avg_sq"].fill_(torch.inf), "holds NaN or infinity"),
    "a negative step": (lambda _, h: h.update(step=-1), "step: "),
    "a step past the end": (lambda _, h: h.update(step=11), "step 11 of 10"),
    "a step as text": (lambda _, h: h.update(step="soon"), "step: "),
    "time that is no number": (lambda _, h: h.update(elapsed_s=float("nan")), "elapsed_s: "),
    "no setting": (lambda _, h: h.pop("setting"), "setting: "),
    "a key too many": (lambda _, h: h.update(more=1), "more: "),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_damaged_is_one_line_and_sets_nothing(case: str, tmp_path: Path) -> None:
    change, expected = WRONG[case]
    write_checkpoint(tmp_path, STATE, *training(0))
    rewrite(tmp_path / CHECKPOINT, change)
    model, optimizer = training(1, steps=0)
    before = [parameter.detach().clone() for parameter in model.parameters()]
    with pytest.raises(InputError) as caught:
        read(tmp_path, model, optimizer)
    text = str(caught.value)
    assert expected in text and text.endswith("remove it to start again") and "\n" not in text
    assert all(torch.equal(a, b) for a, b in zip(before, model.parameters(), strict=True))


def test_a_file_that_was_cut_off_or_has_no_state_is_one_line(tmp_path: Path) -> None:
    write_checkpoint(tmp_path, STATE, *training(0))
    file = tmp_path / CHECKPOINT
    whole, tensors = file.read_bytes(), load_file(file)
    for share in (0.0, 0.01, 0.5, 0.99):
        file.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=r"not a safetensors file .*: remove it to start again"):
            read(tmp_path, *training(0))
    save_file(tensors, file)
    with pytest.raises(InputError, match=r"cannot be read \(training: .*remove it"):
        read(tmp_path, *training(0))
