"""The methods of the front end behind two interfaces, and the one place that knows their names.

A method is made once in each process, from the configuration: a network is loaded then, and a file that is
missing is an InputError. ``frontend.features.method`` names what finds and describes features in a stereo
pair, ``frontend.pairs.method`` what matches the features of two frames. A method's module is imported when
the method is asked for: nobody waits for the libraries of methods that are not used.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import import_module
from typing import Any, Protocol

from polhode.camera import RectifiedRig
from polhode.config.frontend import Frontend
from polhode.frontend.features.stereo import Picture, StereoFeatures
from polhode.frontend.rectification.rectified_pair import RectifiedPair
from polhode.frontend.rectification.target import target_crop
from polhode.lie import Array
from polhode.records import Ints


@dataclass(frozen=True)
class Matches:
    """Features of two frames that look alike, before any geometry; each feature at most once."""

    features: Ints
    """(m, 2) indices into the features of a and of b"""
    confidence: Array
    """(m,) from 0 to 1, on the method's own scale: larger is surer"""


class FeatureMethod(Protocol):
    """Images to stereo features: detection, description and disparity are the method's own affair."""

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Features of the left image whose disparity is known; none when the target is out of sight."""
        ...


class MatchMethod(Protocol):
    """Features of two frames to matches, blind: nothing is known of the motion between them."""

    def __call__(self, a: StereoFeatures, b: StereoFeatures) -> Matches:
        """Matches between the features of frames a and b, of which either may have none."""
        ...


FEATURE_METHODS: Mapping[str, str] = {
    "rootsift": "polhode.frontend.features.rootsift:RootSift",
    "polhode": "polhode.frontend.features.surface_features:SurfaceFeatureMethod",
    "disk": "polhode.frontend.peers.disk:DiskFeatures",
    "aliked": "polhode.frontend.peers.aliked:AlikedFeatures",
    "xfeat": "polhode.frontend.peers.xfeat:XFeatFeatures",
}
"""Name in ``frontend.features.method`` -> module:class, called with the configuration."""

MATCH_METHODS: Mapping[str, str] = {
    "nearest": "polhode.frontend.matching.nearest:MutualNearest",
    "polhode": "polhode.frontend.matching.softmax_matcher:SoftmaxMatcher",
    "lightglue": "polhode.frontend.peers.lightglue:LightGlueMatcher",
    "loftr": "polhode.frontend.peers.loftr:LoftrMatcher",
}
"""Name in ``frontend.pairs.method`` -> module:class, called with the configuration."""

READS_IMAGES = frozenset({"loftr"})
"""Those of ``MATCH_METHODS`` that need the features' ``picture``."""


@lru_cache(maxsize=4)
def feature_method(config: Frontend) -> FeatureMethod:
    """The method that the configuration names. Raises InputError: its weights are missing."""
    method: FeatureMethod = _made(FEATURE_METHODS[config.features.method], config)
    return method


@lru_cache(maxsize=4)
def match_method(config: Frontend) -> MatchMethod:
    """The method that the configuration names. Raises InputError: its weights are missing, or do not fit."""
    method: MatchMethod = _made(MATCH_METHODS[config.matcher], config)
    return method


def extract_pair(pair: RectifiedPair, rig: RectifiedRig, config: Frontend) -> StereoFeatures:
    """Features of one pair, with the left image around the target where the matcher reads images."""
    found, crop = feature_method(config)(pair, rig), target_crop(pair.mask_left)
    if crop is None or config.matcher not in READS_IMAGES:
        return found
    part = pair.left[crop.v0 : crop.v1, crop.u0 : crop.u1].copy()
    return replace(found, picture=Picture(part, (crop.u0, crop.v0)))


def _made(place: str, config: Frontend) -> Any:
    module, name = place.split(":")
    return getattr(import_module(module), name)(config)
