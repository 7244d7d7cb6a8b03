"""Weights of the networks: shipped beside the front end, or at a path that the user gives; no download."""

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
    """Fill the network with the weights of a file, and set it to evaluation.

    Raises InputError: the file is missing, is no safetensors file, or belongs to another network.
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
            f"{path}: no safetensors file ({reason}); give one that polhode train wrote"
        ) from None
    there, wanted = weights.keys(), network.state_dict()
    wrong = [name for name in wanted if name not in there or weights[name].shape != wanted[name].shape]
    wrong += [name for name in there if name not in wanted]
    if wrong:
        raise InputError(
            f"{path}: weights of another network ({len(wrong)} tensors differ, first {wrong[0]}); give those "
            "that this version of polhode train wrote"
        )
    network.load_state_dict(weights)
    network.eval()
