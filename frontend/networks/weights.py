"""Weights of the networks: the shipped ones, or a file that the user gives; nothing is downloaded.

The precision in which networks multiply on this processor.
"""

from functools import cache
from pathlib import Path

import torch
from torch import nn

from polhode.frontend.networks.tensor_file import TensorFileError, read_tensors
from polhode.runtime.errors import InputError

SHIPPED = Path(__file__).resolve().parents[1] / "weights"


def shipped_path(name: str) -> Path:
    """File of the shipped weights ``name``."""
    return SHIPPED / f"{name}.safetensors"


def load_weights(network: nn.Module, path: Path) -> None:
    """Load a file of weights into the network and switch it to evaluation mode.

    Raises InputError: the file is missing, is a folder, is not a safetensors file, belongs to another
    network, or has numbers that are not finite.
    """
    if path.is_dir():
        raise InputError(f"{path}: this is a folder; give a file of weights, NAME.safetensors")
    if not path.is_file():
        raise InputError(
            f"{path}: the weights are missing; train them with polhode train, or correct the path"
        )
    try:
        weights, _ = read_tensors(path, network.state_dict())
    except TensorFileError as error:
        raise InputError(f"{path}: {error}; give weights that this version of polhode train wrote") from None
    network.load_state_dict(weights)
    network.eval()


@cache
def multiplies_in_bfloat16() -> bool:
    """Whether the processor has matrix instructions for bfloat16, which take half the time."""
    # not public, and missing in older versions of torch, which then multiply in 32 bits
    supported = getattr(torch.cpu, "_is_amx_tile_supported", None)
    return bool(torch.backends.mkldnn.is_available() and supported is not None and supported())
