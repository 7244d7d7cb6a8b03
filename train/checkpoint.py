"""Where a training stands, on disk: written whole or not at all; that of another training is refused."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from torch import nn

from polhode.atomic import replaced
from polhode.errors import InputError

CHECKPOINT = "checkpoint.pt"


@dataclass(frozen=True)
class Checkpoint:
    """State after ``step`` steps."""

    step: int
    model: dict[str, Any]
    optimizer: dict[str, Any]
    scaler: dict[str, Any]
    elapsed_s: float
    """Time of training so far, of all calls [s]"""
    setting: dict[str, Any]
    """What the weights depend on: dotted key -> value"""


def write_checkpoint(output: Path, checkpoint: Checkpoint) -> None:
    """Replace the folder's checkpoint."""
    with replaced(output / CHECKPOINT) as partial:
        torch.save(asdict(checkpoint), partial)


def read_checkpoint(output: Path, setting: Mapping[str, Any]) -> Checkpoint | None:
    """The folder's checkpoint, if there is one. Raises InputError: damaged, or of another setting."""
    path = output / CHECKPOINT
    if not path.is_file():
        return None
    try:
        checkpoint = Checkpoint(**torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:  # noqa: BLE001  torch.load raises whatever the damage leads to
        raise InputError(
            f"{path} cannot be read ({' '.join(str(error).split())[:80]}): remove it to begin anew"
        ) from None
    keys = [*setting, *(key for key in checkpoint.setting if key not in setting)]
    other = [key for key in keys if checkpoint.setting.get(key) != setting.get(key)]
    if other:
        raise InputError(
            f"{output} holds a training with another {', '.join(other[:3])}: choose another train.output, or "
            f"remove {CHECKPOINT} there"
        )
    return checkpoint


def write_weights(path: Path, network: nn.Module, about: Mapping[str, Any]) -> None:
    """The network's weights as safetensors, with ``about`` as JSON in the header, under ``training``.

    One key: safetensors writes several in no fixed order.
    """
    weights = {name: value.detach().cpu().contiguous() for name, value in network.state_dict().items()}
    with replaced(path) as partial:
        save_file(weights, partial, metadata={"training": json.dumps(about)})
