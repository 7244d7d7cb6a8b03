"""The interface of feature methods, and the registry of their names.

``frontend.features.method`` names the method that detects and describes features in a stereo pair. A method
is instantiated once in each process, from the configuration; networks are loaded then, and a missing file
raises InputError. Its module is imported only when the method is used, so that libraries of other methods are
not loaded.
"""

from collections.abc import Mapping
from functools import lru_cache
from importlib import import_module
from typing import Any, Protocol

from polhode.config.frontend_settings import Frontend
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.rectification import RectifiedPair
from polhode.geometry.camera import RectifiedRig


class FeatureMethod(Protocol):
    """Images to stereo features: each method detects, describes and measures disparity in its own way."""

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Features of the left image whose disparity is known; none when the target is out of view."""
        ...


FEATURE_METHODS: Mapping[str, str] = {
    "rootsift": "polhode.frontend.features.stereo:RootSift",
    "polhode": "polhode.frontend.features.surface_features:SurfaceFeatureMethod",
}
"""Name in ``frontend.features.method`` -> module:class, called with the configuration."""


@lru_cache(maxsize=4)
def feature_method(config: Frontend) -> FeatureMethod:
    """The configured method. Raises InputError: its weights are missing."""
    method: FeatureMethod = make_method(FEATURE_METHODS[config.features.method], config)
    return method


def make_method(registered: str, config: Frontend) -> Any:
    """An instance of the class ``module:class``."""
    module, name = registered.split(":")
    return getattr(import_module(module), name)(config)
