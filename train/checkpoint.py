"""The state of a training in one safetensors file: nothing is executed when it is read.

Weights and AdamW's moments are tensors; step, time, loss scale and settings are JSON in the header. All is
checked against the model before it is used.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from safetensors.torch import save
from torch import Tensor, nn

from polhode.files.atomic import write_bytes
from polhode.frontend.networks.tensor_file import TensorFileError, read_header, read_tensors
from polhode.runtime.errors import InputError

CHECKPOINT = "checkpoint.safetensors"
_HEADER = "training"
_MOMENTS = ("exp_avg", "exp_avg_sq")


class TrainingState(BaseModel):
    """What a checkpoint says besides its tensors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    step: int = Field(ge=0)
    """Steps done"""
    elapsed_s: float = Field(ge=0.0)
    """Training time of all calls so far [s]"""
    scaler: dict[str, int | float]
    """Of mixed precision in float16; empty otherwise"""
    setting: dict[str, Any]
    """Settings on which the weights depend: dotted key -> value"""


def write_checkpoint(
    output: Path, state: TrainingState, model: nn.Module, optimizer: torch.optim.AdamW
) -> None:
    """Replace the folder's checkpoint."""
    tensors = _tensors(model, optimizer)
    write_bytes(output / CHECKPOINT, save(tensors, metadata={_HEADER: state.model_dump_json()}))


def read_checkpoint(
    output: Path, setting: Mapping[str, Any], steps: int, model: nn.Module, optimizer: torch.optim.AdamW
) -> TrainingState | None:
    """Set model and optimizer to the folder's checkpoint; None, and nothing is set, if there is none.

    ``setting``: the settings that must be the same; ``steps``: of the whole training. Raises InputError: the
    checkpoint is damaged or has other settings.
    """
    path = output / CHECKPOINT
    if not path.is_file():
        return None
    try:
        tensors, header = read_tensors(path, _tensors(model, optimizer))
    except TensorFileError as error:
        raise _damaged(path, str(error)) from None
    state = _state(path, header)
    _require_same(output, state.setting, setting)
    if state.step > steps:
        raise _damaged(path, f"step {state.step} of {steps}")
    weights = model.state_dict()
    model.load_state_dict({name: tensors[f"model.{name}"] for name in weights})
    moments = {
        index: {name: tensors[f"optimizer.{index}.{name}"] for name in ("step", *_MOMENTS)}
        for index in range(sum(len(group["params"]) for group in optimizer.param_groups))
    }
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": moments, "param_groups": groups})
    return state


def require_same_training(output: Path, setting: Mapping[str, Any]) -> None:
    """Require that a checkpoint in the folder, if there is one, has the same settings.

    Only its header is read: this comes before the data are prepared, which takes long. Raises InputError as
    ``read_checkpoint``.
    """
    path = output / CHECKPOINT
    if not path.is_file():
        return
    try:
        header = read_header(path)
    except TensorFileError as error:
        raise _damaged(path, str(error)) from None
    _require_same(output, _state(path, header).setting, setting)


def _state(path: Path, header: Mapping[str, str]) -> TrainingState:
    try:
        return TrainingState.model_validate_json(header.get(_HEADER, ""))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or _HEADER
        raise _damaged(path, f"{where}: {first['msg']}") from None


def _tensors(model: nn.Module, optimizer: torch.optim.AdamW) -> dict[str, Tensor]:
    """Weights and moments by name, on the CPU; the moments of a parameter without a step are zero."""
    found = {f"model.{name}": value for name, value in model.state_dict().items()}
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    for index, parameter in enumerate(parameters):
        known = optimizer.state.get(parameter, {})
        found[f"optimizer.{index}.step"] = known.get("step", torch.tensor(0.0))
        for name in _MOMENTS:
            found[f"optimizer.{index}.{name}"] = known.get(name, torch.zeros_like(parameter))
    return {name: value.detach().cpu().contiguous() for name, value in found.items()}


def _require_same(output: Path, former: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    setting = json.loads(json.dumps(dict(wanted)))
    keys = [*setting, *(key for key in former if key not in setting)]
    other = [key for key in keys if former.get(key) != setting.get(key)]
    if other:
        raise InputError(
            f"{output} contains a training with another {', '.join(other[:3])}: choose another "
            f"train.output, or remove {CHECKPOINT} there"
        )


def _damaged(path: Path, what: str) -> InputError:
    return InputError(f"{path} cannot be read ({' '.join(what.split())[:160]}): remove it to start again")
