"""Features of the surface, from the left image and dense disparity: the method ``polhode``.

Candidates are sought in the left image alone; the dense disparity tells each one's distance and how the
surface leans there, and least squares make the distance sharp. Nothing needs to be found twice, so there are
about twice the features of left-to-right matching. Each is described by a patch in its tangent plane, of one
size in metres for the whole sequence, so the surface's axes at the feature are known: matching uses them.
"""

from dataclasses import replace

import numpy as np

from polhode.camera import RectifiedRig
from polhode.config.depth import Depth
from polhode.config.frontend import Frontend
from polhode.frontend.disparity.crop import cut_crop
from polhode.frontend.disparity.depth import find_disparity_range
from polhode.frontend.disparity.sgbm import match_checked
from polhode.frontend.features.candidates import Candidates, find_candidates
from polhode.frontend.features.feature_noise import feature_sigma
from polhode.frontend.features.patches import surface_frames, surface_normals, tangent_affines, turned
from polhode.frontend.features.stereo import StereoFeatures, refine_disparity
from polhode.frontend.features.surface_descriptor import SurfaceDescriptor, make_descriptor
from polhode.frontend.features.surface_planes import Floats, local_planes
from polhode.frontend.rectification.rectified_pair import RectifiedPair
from polhode.lie import Array

PLANE_RADIUS_PX = 12
"""Half side of the windows whose disparities tell how the surface leans [px]."""
PATCH_HALF_PX = 12.0
"""Half side of a patch at the target's median distance, where its size in metres is not set [px]."""
_REFINEMENTS = 4
_LARGEST_CHANGE_PX = 1.5
"""Refinement that moves a disparity further has left the surface it began on [px]."""


class SurfaceFeatureMethod:
    """``FeatureMethod``: one stereo measurement for each candidate whose surface is known."""

    def __init__(self, config: Frontend) -> None:
        self._config = config
        self._describe: SurfaceDescriptor = make_descriptor(config)

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Features of the left image; none when the target is out of sight."""
        config = self._config
        candidates = find_candidates(pair.left, pair.mask_left, config.features)
        disparity = matched_disparity(pair, rig, config.depth)
        measured, plane = _measure(pair, candidates, disparity, rig, config)
        if len(measured) == 0:
            return measured
        half_m = config.features.patch_half_m
        if half_m is None:
            half_m = patch_half_m(float(np.median(measured.p_R[:, 2])), rig)
        uv = measured.uvd_px[:, :2]
        normals = surface_normals(uv, plane, rig)
        affine = tangent_affines(measured.p_R, normals, rig, np.full(len(measured), half_m))
        described = self._describe(pair.left, uv, affine)
        frames = surface_frames(measured.p_R, normals, turned(affine, described.angle_rad), rig)
        z = measured.p_R[:, 2]
        return replace(
            measured,
            descriptors=described.descriptors,
            reliability=described.reliability,
            R_RS=frames,
            metres_per_px=np.column_stack([z / rig.focal_px, z**2 / (rig.focal_px * rig.baseline_m)]),
        )


def patch_half_m(distance_m: float, rig: RectifiedRig) -> float:
    """Half a patch's side on the surface [m] for a target at a distance [m]."""
    return PATCH_HALF_PX * distance_m / rig.focal_px


def matched_disparity(pair: RectifiedPair, rig: RectifiedRig, config: Depth) -> Floats:
    """Disparity of the left image (H, W) [px] by semi-global matching, NaN where it is not known."""
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
    pair: RectifiedPair, candidates: Candidates, disparity: Floats, rig: RectifiedRig, config: Frontend
) -> tuple[StereoFeatures, Array]:
    """Candidates with a sharp disparity, not described yet, and the planes (n, 3) of their surfaces."""
    found = local_planes(disparity, candidates.uv_px, PLANE_RADIUS_PX)
    known = np.flatnonzero(np.isfinite(found.plane[:, 0]))
    uv, plane = candidates.uv_px[known], found.plane[known]
    refined, sigma_d, correlation = refine_disparity(
        pair.left, pair.right, uv, plane[:, 0], config.stereo.window_px, _REFINEMENTS, plane[:, 1:]
    )
    good = (
        (correlation > config.stereo.min_correlation)
        & (np.abs(refined - plane[:, 0]) < _LARGEST_CHANGE_PX)
        & (refined - rig.disparity_offset_px > 0.5)
    )
    uvd = np.column_stack([uv, refined])[good]
    scale = candidates.scale_px[known][good]
    plane[:, 0] = refined
    return (
        StereoFeatures(
            uvd,
            feature_sigma(sigma_d[good]),
            rig.triangulate(uvd),
            scale,
            np.zeros((len(uvd), 128), dtype=np.float32),
            sigma_ls_px=sigma_d[good],
        ),
        plane[good],
    )
