"""Refinement of tracks with known motion, so that all observations show the same point of the surface.

In a different light a detector finds a blob half a pixel away. With known motion, the landmark's patch of one
view is cut in every other view with the predicted geometry, and least squares align it to a tenth of a pixel
(multi-view refinement of key points: Dusmanu et al. 2020). The disparity is then measured at the new
position. Observations that do not look similar are removed from the track: they show another point, or the
light changed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from polhode.camera import RectifiedRig
from polhode.config.frontend import Frontend
from polhode.dataset import StereoSequence
from polhode.frontend.features.feature_noise import feature_sigma
from polhode.frontend.features.patches import PATCH_PX, Patches, axes_affines, cut_patches, root_image
from polhode.frontend.features.stereo import StereoFeatures, refine_disparity
from polhode.frontend.features.surface_features import patch_half_m
from polhode.frontend.rectification.rectify import Rectifier, rectified_pair
from polhode.frontend.tracks.patch_alignment import PatchAlignment, align_patches
from polhode.frontend.tracks.tracks import Association
from polhode.lie import Array, inverse_pose
from polhode.processes import in_order
from polhode.records import InitialMotion, Ints

PATCH_SCALE = 2.0 / 3.0
"""Side of the patches, over that of the descriptor's: small patches are flatter and mix fewer surfaces."""
MIN_CORRELATION = 0.85
"""Observations with a smaller correlation to their landmark's reference are removed."""
MAX_SHIFT_PX = 2.0
"""Largest accepted shift [px]."""
MAX_DISPARITY_CHANGE_PX = 1.0
"""Largest accepted change of the disparity [px]."""
MIN_SIGMA_PX = 0.2
"""Floor of an aligned position's sigma, for effects of light and relief [px]."""
SIGMA_FACTOR = 4.0
"""Scatter of aligned positions, over the sigma of the least squares."""

DECORRELATION_SIGMA_PX = 10.0
"""Increase of an aligned position's sigma per unit of decorrelation [px]."""


@dataclass(frozen=True)
class ReferenceObservations:
    """The observation that defines each landmark; -1 if no connected frame observes it."""

    frame: Ints
    """(L,)"""
    feature: Ints
    """(L,) in its frame"""


def choose_references(
    frames: Sequence[StereoFeatures], association: Association, motion: InitialMotion
) -> ReferenceObservations:
    """The observation of each landmark whose surface faces the camera most."""
    best = np.full(association.n_landmarks, -np.inf)
    frame = np.full(association.n_landmarks, -1, dtype=np.int64)
    feature = np.full(association.n_landmarks, -1, dtype=np.int64)
    for k, (found, label) in enumerate(zip(frames, association.landmark, strict=True)):
        if found.R_RS is None or not motion.connected[k]:
            continue
        shown = np.flatnonzero((label >= 0) & found.on_surface)
        p = found.p_R[shown]
        facing = -np.sum(found.R_RS[shown, :, 2] * p, axis=1) / np.linalg.norm(p, axis=1)
        better = facing > best[label[shown]]
        chosen, landmark = shown[better], label[shown[better]]
        best[landmark], frame[landmark], feature[landmark] = facing[better], k, chosen
    return ReferenceObservations(frame, feature)


def refine_tracks(
    sequence: StereoSequence,
    rectifier: Rectifier,
    frames: Sequence[StereoFeatures],
    association: Association,
    motion: InitialMotion,
    config: Frontend,
    workers: int,
) -> tuple[list[StereoFeatures], Association]:
    """Features with refined positions, disparities and sigmas, and the association without removed
    observations.

    Features without surface axes and unconnected frames are unchanged.
    """
    references = choose_references(frames, association, motion)
    if not (references.frame >= 0).any():
        return list(frames), association
    depth = np.median(np.concatenate([f.p_R[:, 2] for f in frames if len(f)]))
    half_m = PATCH_SCALE * (config.features.patch_half_m or patch_half_m(float(depth), rectifier.rig))
    templates = np.zeros((association.n_landmarks, 1, PATCH_PX, PATCH_PX), np.uint8)
    # The workers do not need the descriptors, which are gigabytes for a long sequence.
    bare = tuple(replace(found, descriptors=found.descriptors[:, :0]) for found in frames)
    cut = _TemplateJob(sequence, rectifier, bare, references, half_m)
    for k, patches in enumerate(in_order(cut, range(len(frames)), workers)):
        templates[references.frame == k] = np.round(patches)
    job = _AlignJob(cut, association, motion, templates, config)
    refined = list(in_order(job, range(len(frames)), workers))
    described = [
        replace(found, descriptors=known.descriptors)
        for (found, _), known in zip(refined, frames, strict=True)
    ]
    return described, Association(tuple(label for _, label in refined))


@dataclass(frozen=True)
class _TemplateJob:
    sequence: StereoSequence
    rectifier: Rectifier
    frames: tuple[StereoFeatures, ...]
    references: ReferenceObservations
    half_m: float

    def __call__(self, k: int) -> Patches:
        """Patches of the landmarks whose reference is in frame k."""
        found, feature = self.frames[k], self.references.feature[self.references.frame == k]
        if len(feature) == 0 or found.R_RS is None:
            return np.zeros((0, 1, PATCH_PX, PATCH_PX), np.float32)
        image = root_image(rectified_pair(self.sequence, self.rectifier, k).left)
        affine = axes_affines(found.p_R[feature], found.R_RS[feature], self.rectifier.rig, self.half_m)
        return cut_patches(image, found.uvd_px[feature, :2], affine)


@dataclass(frozen=True)
class _AlignJob:
    cut: _TemplateJob
    association: Association
    motion: InitialMotion
    templates: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
    config: Frontend

    def __call__(self, k: int) -> tuple[StereoFeatures, Ints]:
        """Refined features of frame k, and the landmarks (n,) that they observe."""
        found, references = self.cut.frames[k], self.cut.references
        label = self.association.landmark[k]
        if not self.motion.connected[k] or found.R_RS is None:
            return found, label
        feature = np.flatnonzero(label >= 0)
        feature = feature[references.frame[label[feature]] >= 0]
        moving = references.frame[label[feature]] != k
        uvd, sigma, kept = found.uvd_px.copy(), found.sigma_px.copy(), label.copy()
        sigma[feature[~moving], :2] = MIN_SIGMA_PX
        if moving.any():
            self._align(k, found, feature[moving], (uvd, sigma, kept))
        p_R = self.cut.rectifier.rig.triangulate(uvd)
        return replace(found, uvd_px=uvd, sigma_px=sigma, p_R=p_R), kept

    def _align(self, k: int, found: StereoFeatures, feature: Ints, result: tuple[Array, Array, Ints]) -> None:
        """Write the result for the features (m,) into uvd (n, 3), sigma (n, 3) and landmarks (n,)."""
        cut, rig, stereo = self.cut, self.cut.rectifier.rig, self.config.stereo
        uvd, sigma, kept = result
        pair = rectified_pair(cut.sequence, cut.rectifier, k)
        landmark = kept[feature]
        axes = self._axes(k, landmark)
        affine = axes_affines(found.p_R[feature], axes, rig, cut.half_m)
        uv = found.uvd_px[feature, :2]
        template = self.templates[landmark].astype(np.float32)
        aligned = align_patches(template, root_image(pair.left), uv, affine)
        slope = disparity_slopes(found.p_R[feature], axes[:, :, 2], rig)
        shift = aligned.uv_px - uv
        start = found.uvd_px[feature, 2] + np.sum(slope * shift, axis=1)
        refined, sigma_ls, correlation = refine_disparity(
            pair.left, pair.right, aligned.uv_px, start, stereo.window_px, 4, slope
        )
        good = (
            (aligned.correlation > MIN_CORRELATION)
            & (np.linalg.norm(shift, axis=1) < MAX_SHIFT_PX)
            & (correlation > stereo.min_correlation)
            & (np.abs(refined - start) < MAX_DISPARITY_CHANGE_PX)
            & (refined - rig.disparity_offset_px > 0.5)
        )
        sigma_uv = position_sigma(aligned)[good]
        uvd[feature[good]] = np.column_stack([aligned.uv_px, refined])[good]
        sigma[feature[good]] = np.column_stack([sigma_uv, sigma_uv, feature_sigma(sigma_ls[good])[:, 2]])
        kept[feature[~good]] = -1

    def _axes(self, k: int, landmark: Ints) -> Array:
        """Surface axes (m, 3, 3) of the landmarks' references, in frame k."""
        references = self.cut.references
        axes = np.zeros((len(landmark), 3, 3))
        for r in np.unique(references.frame[landmark]):
            mine = references.frame[landmark] == r
            R_RS = self.cut.frames[r].R_RS
            assert R_RS is not None  # ReferenceObservations have surface axes.
            X = self.motion.X_RG[k] @ inverse_pose(self.motion.X_RG[r])
            axes[mine] = X[:3, :3] @ R_RS[references.feature[landmark[mine]]]
        return axes


def position_sigma(aligned: PatchAlignment) -> Array:
    """Sigma (n,) [px] of aligned positions: light that changes a patch also shifts it."""
    decorrelation = np.maximum(1.0 - aligned.correlation, 0.0)
    sigma = np.hypot(MIN_SIGMA_PX, SIGMA_FACTOR * aligned.sigma_px)
    return np.asarray(sigma + DECORRELATION_SIGMA_PX * decorrelation)


def disparity_slopes(p_R: Array, normal_R: Array, rig: RectifiedRig) -> Array:
    """Slopes (n, 2) of the disparity along u and v on planes through p_R (n, 3) with normals (n, 3)."""
    # The inclination is limited: the distance of the plane from the camera is at least a fifth of the range.
    distance = np.minimum(np.sum(normal_R * p_R, axis=1), -0.2 * np.linalg.norm(p_R, axis=1))
    return np.asarray(rig.baseline_m * normal_R[:, :2] / distance[:, None])
