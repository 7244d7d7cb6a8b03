"""Surface features, from the left image and dense disparity: the method ``polhode``.

Candidates are detected in the left image alone. Dense disparity gives the distance and the normal of the
surface at each, and least squares refine the distance. No feature needs to be detected in both images, so
there are about twice as many as from left-to-right matching. Each is described by a patch in its tangent
plane, so the axes of the surface at the feature are known; matching uses them.

The normal comes from a plane through the disparity around the feature: a plane in space is a plane in
disparity, so a weighted least-squares fit over a window is exact on facets. Pixels beyond a jump of depth
belong to another surface and are left out.

With range images the distance of a feature is that of a plane through the ranges around it.

Patches have one size in metres for the whole sequence. If the size followed each frame's median distance,
solar panels that swing to and fro would change it by a fifth, and a spacecraft with panels would lose half
its matches; patches tolerate a tenth.

Noise. A feature's position scatters between views more than its disparity, because the detector also responds
to the light. Both variances follow from the sharpness of the texture, as the least squares of the disparity
measure it: variance = floor^2 + gain * sigma_ls. (With the square of sigma_ls, as least squares suggest,
sigmas of sharp textures are too small on new bodies.) The confidence of a match adds information. The numbers
are those that

    python -m lab.frontend.feature_noise configs/train/features.yaml [--surface-descriptor surface]

prints: maximum likelihood over the true residuals of matches that pass the geometric check, on the training
bodies, with equal weight for each scene. The form of the model was chosen among four by their results on
bodies, textures and light of other scenes, so a check on these is not entirely independent.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from polhode.config.frontend_settings import Depth, Features, Frontend
from polhode.frontend.disparity.depth import find_disparity_range
from polhode.frontend.disparity.measured import disparity_at
from polhode.frontend.disparity.sgbm import Floats, cut_crop, match_checked
from polhode.frontend.features.keypoints import FeatureCandidates, find_candidates
from polhode.frontend.features.local_planes import local_planes
from polhode.frontend.features.patch_descriptors import PatchDescriptions, describe, descriptor_network
from polhode.frontend.features.patches import (
    cut_patches,
    rotate_affines,
    surface_frames,
    surface_normals,
    tangent_affines,
)
from polhode.frontend.features.stereo import (
    MIN_CORRELATION,
    StereoFeatures,
    refine_disparity,
    texture_sigma,
)
from polhode.frontend.features.surface_network import SurfaceLook, surface_network
from polhode.frontend.networks.descriptor import DescriptorNet
from polhode.frontend.rectification import Image, RectifiedPair, Rectifier, rectified_pair
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints
from polhode.records.dataset import StereoSequence

UV_FLOOR_PX, UV_GAIN_PX = 0.293, 3.287
"""In the image [px]."""
DISPARITY_FLOOR_PX, DISPARITY_GAIN_PX = 0.0, 0.189
"""Of the disparity [px]."""
PLACE_FLOOR_PX, PLACE_GAIN = 0.295, 1.249
"""In the image, of landmarks [px], and factor on the variance that the network gives."""
UV_CONFIDENCE = (-0.165, -0.126)
DISPARITY_CONFIDENCE = (-0.051, -0.049)
"""Log of a match's variance over the sum of its features': first + second * logit(confidence)."""
PLACE_CONFIDENCE = (-0.098, -0.091)
"""The same of u and v, of landmarks."""
_MIN_SIGMA_LS_PX = 0.01
_MIN_CONFIDENCE, _MAX_CONFIDENCE = 1e-4, 1.0 - 1e-4
_REFINEMENTS = 4


def feature_sigma(sigma_ls_px: Array) -> Array:
    """Standard deviations (n, 3) [px] of u, v and disparity between views, of single features.

    sigma_ls_px (n,): standard deviation of the disparity according to its least squares.
    """
    sigma_ls = np.maximum(sigma_ls_px, _MIN_SIGMA_LS_PX)
    uv = np.sqrt(UV_FLOOR_PX**2 + UV_GAIN_PX * sigma_ls)
    return np.column_stack([uv, uv, np.sqrt(DISPARITY_FLOOR_PX**2 + DISPARITY_GAIN_PX * sigma_ls)])


def landmark_sigma(place_sigma_px: Array) -> Array:
    """Standard deviations (n,) [px] of u and v between views, of landmarks.

    place_sigma_px (n,): the same according to the surface network.
    """
    return np.asarray(np.sqrt(PLACE_FLOOR_PX**2 + PLACE_GAIN * place_sigma_px**2))


def match_sigma(a: StereoFeatures, b: StereoFeatures, pairs: Ints, confidence: Array) -> Array:
    """Standard deviations (m, 3) [px] of u, v and disparity between matched features, pairs (m, 2).

    They are those of a's measurement minus the projection of b's point, transformed to frame a.
    """
    variance = a.sigma_px[pairs[:, 0]] ** 2 + b.sigma_px[pairs[:, 1]] ** 2
    logit = confidence_logit(confidence)
    in_image = UV_CONFIDENCE if a.place_sigma_px is None else PLACE_CONFIDENCE
    change = [first + slope * logit for first, slope in (in_image, in_image, DISPARITY_CONFIDENCE)]
    return np.asarray(np.sqrt(variance * np.exp(np.stack(change, axis=1))))


def confidence_logit(confidence: Array) -> Array:
    """Log odds (m,) of confidences, finite for 0 and 1."""
    p = np.clip(confidence, _MIN_CONFIDENCE, _MAX_CONFIDENCE)
    return np.asarray(np.log(p / (1.0 - p)))


class PatchLook:
    """One image: blobs are its points, described by their patches. ``SurfaceLook`` may take its place."""

    def __init__(self, network: DescriptorNet, config: Features, image: Image, mask: Bools) -> None:
        self._network, self._config, self._image, self._mask = network, config, image, mask

    def candidates(self, count: int) -> tuple[FeatureCandidates, Array | None]:
        """The ``count`` best points, and the standard deviations (n,) of their places, each axis [px], where
        they are known."""
        features = self._config.model_copy(update={"max_features": count})
        return find_candidates(self._image, self._mask, features), None

    def describe(self, uv_px: Array, affine_px: Array) -> PatchDescriptions:
        """The surface around points (n, 2), by maps (n, 2, 2) of their upright patches."""
        return describe(self._network, cut_patches(self._image, uv_px, affine_px))


def make_look(config: Frontend) -> Callable[[Image, Bools], PatchLook | SurfaceLook]:
    """How an image and its mask are looked at. Raises InputError: weights are missing."""
    of_surface = config.features.surface_descriptor == "surface"
    given = config.weights.surface if of_surface else config.weights.descriptor
    path = None if given is None else Path(given)
    if of_surface:
        return partial(SurfaceLook, surface_network(path))
    return partial(PatchLook, descriptor_network(path), config.features)


class SurfaceFeatureMethod:
    """``FeatureMethod``: one stereo measurement for each candidate with a known surface."""

    def __init__(self, config: Frontend) -> None:
        self._config = config
        self._look = make_look(config)

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Features of the left image; none when the target is out of view."""
        config = self._config
        look = self._look(pair.left, pair.mask_left)
        candidates, sigma_px = look.candidates(config.features.max_features)
        disparity = matched_disparity(pair, rig, config.depth)
        measured, planes = _measure(pair, candidates, sigma_px, disparity, rig, config)
        if len(measured) == 0:
            return measured
        half_m = config.features.patch_half_m
        if half_m is None:
            half_m = patch_half_m(float(np.median(measured.p_R[:, 2])), rig)
        uv = measured.uvd_px[:, :2]
        normals = surface_normals(uv, planes, rig)
        affine = tangent_affines(measured.p_R, normals, rig, np.full(len(measured), half_m))
        described = look.describe(uv, affine)
        frames = surface_frames(measured.p_R, normals, rotate_affines(affine, described.angle_rad), rig)
        return replace(
            measured,
            descriptors=described.descriptors,
            R_RS=frames,
            metres_per_px=rig.metres_per_px(measured.p_R[:, 2]),
        )


def with_patch_size(config: Frontend, sequence: StereoSequence, rectifier: Rectifier) -> Frontend:
    """The configuration with ``features.patch_half_m`` set, if its method needs it and the user did not set
    it.

    The size follows from the median distance over pairs throughout the sequence. It remains unset when none
    of them shows the target.
    """
    if config.features.method != "polhode" or config.features.patch_half_m is not None:
        return config
    # pairs of the sequence from which the size of patches is computed
    frames = np.unique(np.round(np.linspace(0, len(sequence) - 1, 6)).astype(int))
    distances, rig = list[float](), rectifier.rig
    for k in frames.tolist():
        disparity = matched_disparity(rectified_pair(sequence, rectifier, k), rig, config.depth)
        offset = disparity - np.float32(rig.disparity_offset_px)
        known = offset[np.isfinite(offset) & (offset > 0.5)]
        if len(known):
            distances.append(rig.focal_px * rig.baseline_m / float(np.median(known)))
    if not distances:
        return config
    half_m = patch_half_m(float(np.median(distances)), rig)
    features = config.features.model_copy(update={"patch_half_m": half_m})
    return config.model_copy(update={"features": features})


def patch_half_m(distance_m: float, rig: RectifiedRig) -> float:
    """Half the side of a patch on the surface [m] for a target at a distance [m]."""
    # half side of a patch at the target's median distance, if its size in metres is not set [px]
    return 12.0 * distance_m / rig.focal_px


def matched_disparity(pair: RectifiedPair, rig: RectifiedRig, config: Depth) -> Floats:
    """Disparity of the target (H, W) [px], measured or by semi-global matching; NaN where it is unknown."""
    if pair.measured is not None:
        return np.where(pair.mask_left, pair.measured.disparity_px, np.float32(np.nan))
    disparity = np.full(pair.left.shape, np.nan, dtype=np.float32)
    if not pair.mask_left.any():
        return disparity
    span = find_disparity_range(pair.left, pair.right, pair.mask_left, config, rig.disparity_offset_px)
    if span is None:
        return disparity
    crop = cut_crop(pair.left, pair.right, pair.mask_left, span, config)
    disparity[crop.inner] = match_checked(crop, config) + np.float32(crop.shift_px)
    return disparity


def _measure(
    pair: RectifiedPair,
    candidates: FeatureCandidates,
    place_sigma_px: Array | None,
    disparity: Floats,
    rig: RectifiedRig,
    config: Frontend,
) -> tuple[StereoFeatures, Array]:
    """Candidates with a refined disparity, without descriptors, and the planes (n, 3) of their surfaces."""
    planes = local_planes(disparity, candidates.uv_px)
    known = np.flatnonzero(np.isfinite(planes[:, 0]))
    uv, plane = candidates.uv_px[known], planes[known]
    if pair.measured is not None:
        refined, sigma_d = disparity_at(pair.measured, uv)
        sigma_ls, is_seen = texture_sigma(pair.left, uv), np.isfinite(refined)
        sigma = np.column_stack([feature_sigma(sigma_ls)[:, :2], sigma_d])
    else:
        refined, sigma_ls, correlation, _ = refine_disparity(
            pair.left, pair.right, uv, plane[:, 0], _REFINEMENTS, plane[:, 1:]
        )
        sigma, is_seen = feature_sigma(sigma_ls), correlation > MIN_CORRELATION
    if place_sigma_px is not None:
        place_sigma_px = place_sigma_px[known]
        sigma[:, :2] = landmark_sigma(place_sigma_px)[:, None]
    # A refined disparity that differs by more belongs to another surface [px]
    good = is_seen & (np.abs(refined - plane[:, 0]) < 1.5) & (refined - rig.disparity_offset_px > 0.5)
    uvd = np.column_stack([uv, refined])[good]
    scale = candidates.scale_px[known][good]
    plane[:, 0] = refined
    return (
        StereoFeatures(
            uvd,
            sigma[good],
            rig.triangulate(uvd),
            scale,
            np.zeros((len(uvd), 128), dtype=np.float32),
            sigma_ls_px=sigma_ls[good],
            place_sigma_px=None if place_sigma_px is None else place_sigma_px[good],
        ),
        plane[good],
    )
