"""Weights of the networks: the shipped ones, or a file that the user gives; nothing is downloaded."""

from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import nn

from polhode.errors import InputError

SHIPPED = Path(__file__).resolve().parents[1] / "weights"


def shipped_path(name: str) -> Path:
    """File of the shipped weights ``name``."""
    return SHIPPED / f"{name}.safetensors"


def load_weights(network: nn.Module, path: Path) -> None:
    """Load a file of weights into the network and switch it to evaluation mode.

    Raises InputError: the file is missing, is not a safetensors file, or belongs to another network.
    """
    if not path.is_file():
        raise InputError(
            f"{path}: the weights are missing; train them with polhode train, or correct the path"
        )
    try:
        weights = load_file(path)
    except (SafetensorError, OSError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{path}: not a safetensors file ({reason}); give one that polhode train wrote"
        ) from None
    expected = network.state_dict()
    wrong = [name for name in expected if name not in weights or weights[name].shape != expected[name].shape]
    wrong += [name for name in weights if name not in expected]
    if wrong:
        raise InputError(
            f"{path}: weights of another network ({len(wrong)} tensors differ, the first is {wrong[0]}); "
            "give weights that this version of polhode train wrote"
        )
    network.load_state_dict(weights)
    network.eval()
