"""Landmarks put to the same point of the surface in every view, once the motion is known.

A detector finds a blob half a pixel off in another light. With the motion known, the landmark's patch of one
view can be cut in every other view as that view must see it, and least squares find it to a tenth of a pixel
(multi-view refinement of key points: Dusmanu et al. 2020). The disparity is then measured at the new place.
What does not look alike there leaves the track: it is another point, or the light has changed it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from polhode.camera import RectifiedRig
from polhode.config.frontend import Frontend
from polhode.dataset import StereoSequence
from polhode.frontend.features.feature_noise import feature_sigma
from polhode.frontend.features.patches import PATCH_PX, Patches, axes_affines, cut_patches
from polhode.frontend.features.stereo import StereoFeatures, refine_disparity
from polhode.frontend.features.surface_features import patch_half_m
from polhode.frontend.rectification.rectified_pair import rectified_pair
from polhode.frontend.rectification.rectify import Rectifier
from polhode.frontend.tracks.alignment import Alignment, align_patches, root_image
from polhode.frontend.tracks.tracks import Association
from polhode.lie import Array, inverse_pose
from polhode.processes import in_order
from polhode.records import InitialMotion, Ints

SIZE = 2.0 / 3.0
"""Side of the patches, over that of the descriptor's: small ones bend and mix less."""
LEAST_CORRELATION = 0.85
"""Observations that look less like their landmark's reference leave the track."""
LARGEST_SHIFT_PX = 2.0
"""A place found further away is another one [px]."""
LARGEST_CHANGE_PX = 1.0
"""The same for the disparity [px]."""
LEAST_SIGMA_PX = 0.2
"""Floor of an aligned place: what light and relief do to a patch [px]."""
SIGMA_FACTOR = 4.0
"""Scatter of aligned places, over what the least squares say."""

UNLIKE_PX = 10.0
"""What is added to an aligned place's sigma, times the correlation that lacks [px]."""


@dataclass(frozen=True)
class References:
    """For each landmark, the observation that defines it; -1 for a landmark that no connected frame shows."""

    frame: Ints
    """(L,)"""
    feature: Ints
    """(L,) in its frame"""


def choose_references(
    frames: Sequence[StereoFeatures], association: Association, motion: InitialMotion
) -> References:
    """The observation of each landmark that faces the camera most."""
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
    return References(frame, feature)


def refine_tracks(
    sequence: StereoSequence,
    rectifier: Rectifier,
    frames: Sequence[StereoFeatures],
    association: Association,
    motion: InitialMotion,
    config: Frontend,
    workers: int,
) -> tuple[list[StereoFeatures], Association]:
    """Places, disparities and sigmas of the landmarks' observations refined; the association of those found.

    Features without surface axes and frames that are not connected stay as they are.
    """
    references = choose_references(frames, association, motion)
    if not (references.frame >= 0).any():
        return list(frames), association
    depth = np.median(np.concatenate([f.p_R[:, 2] for f in frames if len(f)]))
    half_m = SIZE * (config.features.patch_half_m or patch_half_m(float(depth), rectifier.rig))
    templates = np.zeros((association.n_landmarks, 1, PATCH_PX, PATCH_PX), np.uint8)
    # descriptors stay here: the workers need none, and of a long sequence they are gigabytes
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
    references: References
    half_m: float

    def __call__(self, k: int) -> Patches:
        """Patches of the landmarks that frame k defines."""
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
        """Features of frame k, refined, and the landmarks (n,) that they show."""
        found, references = self.cut.frames[k], self.cut.references
        label = self.association.landmark[k]
        if not self.motion.connected[k] or found.R_RS is None:
            return found, label
        feature = np.flatnonzero(label >= 0)
        feature = feature[references.frame[label[feature]] >= 0]
        moving = references.frame[label[feature]] != k
        uvd, sigma, kept = found.uvd_px.copy(), found.sigma_px.copy(), label.copy()
        sigma[feature[~moving], :2] = LEAST_SIGMA_PX
        if moving.any():
            self._align(k, found, feature[moving], (uvd, sigma, kept))
        p_R = self.cut.rectifier.rig.triangulate(uvd)
        return replace(found, uvd_px=uvd, sigma_px=sigma, p_R=p_R), kept

    def _align(self, k: int, found: StereoFeatures, feature: Ints, result: tuple[Array, Array, Ints]) -> None:
        """Write what is found for the features (m,) into uvd (n, 3), sigma (n, 3) and landmarks (n,)."""
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
            (aligned.correlation > LEAST_CORRELATION)
            & (np.linalg.norm(shift, axis=1) < LARGEST_SHIFT_PX)
            & (correlation > stereo.min_correlation)
            & (np.abs(refined - start) < LARGEST_CHANGE_PX)
            & (refined - rig.disparity_offset_px > 0.5)
        )
        place = place_sigma(aligned)[good]
        uvd[feature[good]] = np.column_stack([aligned.uv_px, refined])[good]
        sigma[feature[good]] = np.column_stack([place, place, feature_sigma(sigma_ls[good])[:, 2]])
        kept[feature[~good]] = -1

    def _axes(self, k: int, landmark: Ints) -> Array:
        """Surface axes (m, 3, 3) of the landmarks' references, turned into frame k."""
        references = self.cut.references
        turned = np.zeros((len(landmark), 3, 3))
        for r in np.unique(references.frame[landmark]):
            mine = references.frame[landmark] == r
            R_RS = self.cut.frames[r].R_RS
            assert R_RS is not None  # chosen for it
            X = self.motion.X_RG[k] @ inverse_pose(self.motion.X_RG[r])
            turned[mine] = X[:3, :3] @ R_RS[references.feature[landmark[mine]]]
        return turned


def place_sigma(aligned: Alignment) -> Array:
    """Of aligned places (n,) [px]: light that has changed a patch has also moved what was found."""
    unlike = np.maximum(1.0 - aligned.correlation, 0.0)
    return np.asarray(np.hypot(LEAST_SIGMA_PX, SIGMA_FACTOR * aligned.sigma_px) + UNLIKE_PX * unlike)


def disparity_slopes(p_R: Array, normal_R: Array, rig: RectifiedRig) -> Array:
    """Slopes (n, 2) of the disparity along u and v on planes through p_R (n, 3) with normals (n, 3)."""
    through = np.sum(normal_R * p_R, axis=1)
    aslant = np.minimum(through, -0.2 * np.linalg.norm(p_R, axis=1))
    return np.asarray(rig.baseline_m * normal_R[:, :2] / aslant[:, None])
