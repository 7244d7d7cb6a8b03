"""Refinement of tracks with known motion, so that all observations show the same point of the surface.

In a different light a detector finds a blob half a pixel away. With known motion, the landmark's patch of one
view is cut in every other view with the predicted geometry, and least squares align it to a tenth of a pixel
(multi-view refinement of key points: Dusmanu et al. 2020). The disparity is then measured at the new
position. Observations that do not look similar are removed from the track: they show another point, or the
light changed.

Patches are aligned by least squares on grey values (Lucas and Kanade 1981) in the tangent plane; the shift is
estimated in patch coordinates together with gain and offset. Changes of illumination alter a patch more than
its shift does, so the sigma of the fit is a lower bound.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from polhode.config.frontend_settings import Frontend
from polhode.frontend.disparity.measured import disparity_at
from polhode.frontend.features import stereo
from polhode.frontend.features.patches import (
    PATCH_PX,
    Patches,
    axes_affines,
    cut_patch,
    cut_patches,
    root_image,
    smoothed_levels,
)
from polhode.frontend.features.stereo import StereoFeatures, refine_disparity
from polhode.frontend.features.surface_features import feature_sigma, patch_half_m
from polhode.frontend.rectification import Image, Rectifier, rectified_pair
from polhode.frontend.tracks.tracks import Association
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints, inverse_pose
from polhode.records.dataset import StereoSequence
from polhode.records.estimate import InitialMotion
from polhode.runtime.compiled import compiled_reordered
from polhode.runtime.processes import in_order

Floats = NDArray[np.float32]
ROUNDS = 6
MIN_GAIN, MAX_GAIN = 0.2, 5.0
"""Range of the ratio of contrasts between a landmark's reference and another view."""
_MAX_STEP = 0.1
"""In patch coordinates, where half a side is 1."""
PATCH_SCALE = 2.0 / 3.0
"""Side of the patches, over that of the descriptor's: small patches are flatter and mix fewer surfaces."""
MIN_SIGMA_PX = 0.2
"""Floor of an aligned position's sigma, for effects of light and relief [px]."""


@dataclass(frozen=True)
class PatchAlignment:
    """Positions of n patches."""

    uv_px: Array
    """(n, 2)"""
    correlation: Array
    """(n,) of the weighted grey values"""
    sigma_px: Array
    """(n,) standard deviation of the position, from the residuals"""


def align_patches(template: Patches, image: Image, uv_px: Array, affine_px: Array) -> PatchAlignment:
    """Find templates (n, 1, s, s) near positions (n, 2) of an image, cut by maps (n, 2, 2) [px]."""
    n, size = len(template), template.shape[-1]
    side = (2.0 * np.arange(size) + 1.0) / size - 1.0
    # standard deviation of the weight around the centre, over half a side
    weight = np.exp(-(side[:, None] ** 2 + side[None, :] ** 2) / (2.0 * 0.5**2))
    weight /= weight.sum()
    shift, normal = np.zeros((n, 2)), np.zeros((n, 2, 2))
    variance, correlation = np.zeros(n), np.zeros(n)
    found = shift, normal, variance, correlation
    target = template[:, 0].astype(np.float64)
    target -= np.einsum("nij,ij->n", target, weight)[:, None, None]
    for smooth, chosen in smoothed_levels(image, affine_px, size):
        _align_each(target, smooth, uv_px, affine_px, chosen, weight, found)
    # Effective number of samples of the weight.
    samples = 1.0 / float(np.sum(weight**2))
    covariance = affine_px @ np.linalg.inv(normal) @ np.swapaxes(affine_px, 1, 2)
    spread = 0.5 * np.trace(covariance, axis1=1, axis2=2) * variance / samples
    return PatchAlignment(uv_px + np.einsum("nab,nb->na", affine_px, shift), correlation, np.sqrt(spread))


@compiled_reordered
def _align_each(
    target: Array,
    image: Floats,
    uv_px: Array,
    affine_px: Array,
    chosen: Ints,
    weight: Array,
    found: tuple[Array, Array, Array, Array],
) -> None:
    """Align the chosen ones of the targets (n, s, s), whose weighted means are zero.

    Written into ``found``: shifts (n, 2), normal matrices (n, 2, 2), residual variances and correlations.
    """
    shift, normal, variance, correlation = found
    size = target.shape[-1]
    slope = size / 4.0
    seen = np.empty((size, size), np.float32)
    for k in chosen:
        A, wanted = affine_px[k], target[k]
        for i in range(ROUNDS + 1):
            u = uv_px[k, 0] + A[0, 0] * shift[k, 0] + A[0, 1] * shift[k, 1]
            v = uv_px[k, 1] + A[1, 0] * shift[k, 0] + A[1, 1] * shift[k, 1]
            cut_patch(image, u, v, A, seen)
            mean, mean_x, mean_y = 0.0, 0.0, 0.0
            own, common, power = 0.0, 0.0, 0.0
            xx, xy, yy, x_seen, y_seen, x_wanted, y_wanted = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for r in range(size):
                inner = 1.0 if 0 < r < size - 1 else 0.0
                above, below = max(r - 1, 0), min(r + 1, size - 1)
                for c in range(size):
                    w, s, t = weight[r, c], float(seen[r, c]), wanted[r, c]
                    gx = 0.0
                    if 0 < c < size - 1:
                        gx = slope * (seen[r, c + 1] - seen[r, c - 1])
                    gy = inner * slope * (seen[below, c] - seen[above, c])
                    mean += w * s
                    mean_x += w * gx
                    mean_y += w * gy
                    own += w * s * s
                    common += w * s * t
                    power += w * t * t
                    xx += w * gx * gx
                    xy += w * gx * gy
                    yy += w * gy * gy
                    x_seen += w * gx * s
                    y_seen += w * gy * s
                    x_wanted += w * gx * t
                    y_wanted += w * gy * t
            own -= mean * mean
            gain = min(max(common / max(own, 1e-6), MIN_GAIN), MAX_GAIN)
            xx, xy, yy = xx - mean_x * mean_x, xy - mean_x * mean_y, yy - mean_y * mean_y
            x_seen, y_seen = x_seen - mean_x * mean, y_seen - mean_y * mean
            # The regularisation of one squared grey level keeps patches without texture in place.
            n00, n01, n11 = gain * gain * xx + 1.0, gain * gain * xy, gain * gain * yy + 1.0
            if i == ROUNDS:
                normal[k, 0, 0], normal[k, 0, 1], normal[k, 1, 0], normal[k, 1, 1] = n00, n01, n01, n11
                variance[k] = max(power - 2.0 * gain * common + gain * gain * own, 0.0)
                correlation[k] = common / np.sqrt(max(own * power, 1e-9))
                break
            b0, b1 = gain * (x_wanted - gain * x_seen), gain * (y_wanted - gain * y_seen)
            determinant = n00 * n11 - n01 * n01
            step_x, step_y = (n11 * b0 - n01 * b1) / determinant, (n00 * b1 - n01 * b0) / determinant
            shift[k, 0] += min(max(step_x, -_MAX_STEP), _MAX_STEP)
            shift[k, 1] += min(max(step_y, -_MAX_STEP), _MAX_STEP)


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
    views = _Views(sequence, rectifier, bare, references, half_m, association, motion, config)
    for k, patches in enumerate(in_order(views.templates, range(len(frames)), workers)):
        templates[references.frame == k] = np.round(patches)
    refined = list(in_order(partial(views.refined, templates), range(len(frames)), workers))
    described = [
        replace(found, descriptors=known.descriptors)
        for (found, _), known in zip(refined, frames, strict=True)
    ]
    return described, Association(tuple(label for _, label in refined))


@dataclass(frozen=True)
class _Views:
    """What the workers need."""

    sequence: StereoSequence
    rectifier: Rectifier
    frames: tuple[StereoFeatures, ...]
    references: ReferenceObservations
    half_m: float
    association: Association
    motion: InitialMotion
    config: Frontend

    def templates(self, k: int) -> Patches:
        """Patches of the landmarks whose reference is in frame k."""
        found, feature = self.frames[k], self.references.feature[self.references.frame == k]
        if len(feature) == 0 or found.R_RS is None:
            return np.zeros((0, 1, PATCH_PX, PATCH_PX), np.float32)
        image = root_image(rectified_pair(self.sequence, self.rectifier, k).left)
        affine = axes_affines(found.p_R[feature], found.R_RS[feature], self.rectifier.rig, self.half_m)
        return cut_patches(image, found.uvd_px[feature, :2], affine)

    def refined(self, templates: NDArray[np.uint8], k: int) -> tuple[StereoFeatures, Ints]:
        """Refined features of frame k, and the landmarks (n,) that they observe."""
        found, references = self.frames[k], self.references
        label = self.association.landmark[k]
        if not self.motion.connected[k] or found.R_RS is None:
            return found, label
        feature = np.flatnonzero(label >= 0)
        feature = feature[references.frame[label[feature]] >= 0]
        moving = references.frame[label[feature]] != k
        uvd, sigma, kept = found.uvd_px.copy(), found.sigma_px.copy(), label.copy()
        sigma[feature[~moving], :2] = MIN_SIGMA_PX
        if moving.any():
            self._align(k, templates, feature[moving], (uvd, sigma, kept))
        p_R = self.rectifier.rig.triangulate(uvd)
        return replace(found, uvd_px=uvd, sigma_px=sigma, p_R=p_R), kept

    def _align(
        self, k: int, templates: NDArray[np.uint8], feature: Ints, result: tuple[Array, Array, Ints]
    ) -> None:
        """Write the result for the features (m,) into uvd (n, 3), sigma (n, 3) and landmarks (n,)."""
        found, references, rig = self.frames[k], self.references, self.rectifier.rig
        uvd, sigma, kept = result
        pair = rectified_pair(self.sequence, self.rectifier, k)
        landmark = kept[feature]
        # surface axes of the landmarks' references, in frame k
        axes = np.zeros((len(landmark), 3, 3))
        for r in np.unique(references.frame[landmark]):
            mine = references.frame[landmark] == r
            R_RS = self.frames[r].R_RS
            assert R_RS is not None  # ReferenceObservations have surface axes.
            X = self.motion.X_RG[k] @ inverse_pose(self.motion.X_RG[r])
            axes[mine] = X[:3, :3] @ R_RS[references.feature[landmark[mine]]]
        affine = axes_affines(found.p_R[feature], axes, rig, self.half_m)
        uv = found.uvd_px[feature, :2]
        template = templates[landmark].astype(np.float32)
        aligned = align_patches(template, root_image(pair.left), uv, affine)
        slope = disparity_slopes(found.p_R[feature], axes[:, :, 2], rig)
        shift = aligned.uv_px - uv
        start = found.uvd_px[feature, 2] + np.sum(slope * shift, axis=1)
        if pair.measured is not None:
            refined, sigma_d = disparity_at(pair.measured, aligned.uv_px)
            is_seen = np.isfinite(refined)
        else:
            refined, sigma_ls, correlation, _ = refine_disparity(
                pair.left, pair.right, aligned.uv_px, start, 4, slope
            )
            sigma_d, is_seen = feature_sigma(sigma_ls)[:, 2], correlation > stereo.MIN_CORRELATION
        # observations with a smaller correlation to their landmark's reference are removed
        # largest accepted shift [px]
        # largest accepted change of the disparity [px]
        good = (
            (aligned.correlation > 0.85)
            & (np.linalg.norm(shift, axis=1) < 2.0)
            & is_seen
            & (np.abs(refined - start) < 1.0)
            & (refined - rig.disparity_offset_px > 0.5)
        )
        sigma_uv = position_sigma(aligned)[good]
        uvd[feature[good]] = np.column_stack([aligned.uv_px, refined])[good]
        sigma[feature[good]] = np.column_stack([sigma_uv, sigma_uv, sigma_d[good]])
        kept[feature[~good]] = -1


def position_sigma(aligned: PatchAlignment) -> Array:
    """Sigma (n,) [px] of aligned positions: light that changes a patch also shifts it."""
    decorrelation = np.maximum(1.0 - aligned.correlation, 0.0)
    # scatter of aligned positions, over the sigma of the least squares
    sigma = np.hypot(MIN_SIGMA_PX, 4.0 * aligned.sigma_px)
    # increase of an aligned position's sigma per unit of decorrelation [px]
    return np.asarray(sigma + 10.0 * decorrelation)


def disparity_slopes(p_R: Array, normal_R: Array, rig: RectifiedRig) -> Array:
    """Slopes (n, 2) of the disparity along u and v on planes through p_R (n, 3) with normals (n, 3)."""
    # The inclination is limited: the distance of the plane from the camera is at least a fifth of the range.
    distance = np.minimum(np.sum(normal_R * p_R, axis=1), -0.2 * np.linalg.norm(p_R, axis=1))
    return np.asarray(rig.baseline_m * normal_R[:, :2] / distance[:, None])
