"""How well is it known, before and after matching, which candidates of an image another image finds again?

    python -m benchmarks.frontend.reliability [--short] [--surface-descriptor surface]

The scenes are those of ``benchmarks.frontend.matching``, 30 and 60 degrees of turn apart. Candidates of the
method ``polhode`` whose place the other frame shows in the light are compared: its most similar feature there
shows the same place, within 5 mm, or it does not. The table has the area under the ROC curve within an image,
the probability that a candidate which is found is valued more than one which is not: before matching by the
contrast of the blob (of the surface network: by the score of the landmark), the sharpness of the texture, the
reliability that the descriptor gives to its own patch, and the standard deviation that the surface network
gives to the place; after matching by the similarity, by its lead over the best feature elsewhere, and by the
probability of the dual softmax.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch

from benchmarks.command import Short, command
from benchmarks.frontend.matching import GAPS, SAME_POINT_M
from benchmarks.frontend.scenes import UnseenScene, open_scene, render, scene_names
from benchmarks.presentation import numbers, print_table
from polhode.config.frontend_settings import Features, Frontend
from polhode.frontend.features.patches import tangent_affines
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.features.surface_features import SurfaceFeatureMethod, make_look, with_patch_size
from polhode.frontend.matching.matchers import DUSTBIN, TEMPERATURE, DualSoftmax
from polhode.frontend.rectification import RectifiedPair
from polhode.lie import Array
from polhode.records import Bools, Ints
from polhode.train.descriptor.scores import area_under_curve

Descriptor = Literal["network", "surface"]
BEFORE = ("contrast", "sharpness", "patch")
PLACE = "place"
"""Known before matching by the surface network alone."""
AFTER = ("similarity", "lead", "probability")
SAME_MARK_PX = 4.0
"""Features this close to the most similar one show the same mark: the lead is over others [px]."""
MIN_OF_EACH = 5
"""Candidates that are found, and that are not, of which a pair of frames has at least so many."""


def main(short: Short = False, surface_descriptor: Descriptor = "network") -> None:
    """Print the table."""
    config = configured(surface_descriptor)
    columns = ["scene", *(f"{30 * gap} deg {name}" for gap in GAPS for name in value_names(config))]
    rows = []
    for name in scene_names(short):
        render(name)
        rows.append((name, scene_areas(open_scene(name), GAPS, config)))
    mean = np.nanmean([areas for _, areas in rows], axis=0)
    print_table(columns, ([name, *numbers(areas, ".2f")] for name, areas in [*rows, ("mean", mean)]))


def configured(surface_descriptor: Descriptor) -> Frontend:
    """The method ``polhode`` with blobs and their patches, or with the surface network."""
    return Frontend(features=Features(method="polhode", surface_descriptor=surface_descriptor))


def value_names(config: Frontend) -> tuple[str, ...]:
    """What is known of a candidate, in the order of the columns of the values."""
    place = (PLACE,) if config.features.surface_descriptor == "surface" else ()
    return (*BEFORE, *place, *AFTER)


def scene_areas(scene: UnseenScene, gaps: Sequence[int], config: Frontend) -> Array:
    """Areas of one scene: of each gap and each of ``value_names``, in this order; NaN without pairs."""
    config = with_patch_size(config, scene.sequence, scene.rectifier)
    method = SurfaceFeatureMethod(config)
    pairs = [scene.pair(k) for k in range(len(scene))]
    frames = [method(pair, scene.rig) for pair in pairs]
    points = [scene.body_points(k, frame.uvd_px)[0] for k, frame in enumerate(frames)]
    before = [values_before(pair, frame, scene, config) for pair, frame in zip(pairs, frames, strict=True)]
    areas = []
    for gap in gaps:
        found = []
        for i in range(len(scene) - gap):
            j = i + gap
            if min(len(frames[i]), len(frames[j])) == 0:
                continue
            shown = scene.shown_in_light(points[i], j)
            best, after = values_after(frames[i], frames[j])
            right = np.linalg.norm(points[i] - points[j][best], axis=1) < SAME_POINT_M
            found.append(areas_of_pair(np.column_stack([before[i], after]), shown, right))
        known = [areas for areas in found if np.isfinite(areas).all()]
        areas.append(np.mean(known, axis=0) if known else np.full(len(value_names(config)), np.nan))
    return np.concatenate(areas)


def values_before(pair: RectifiedPair, frame: StereoFeatures, scene: UnseenScene, config: Frontend) -> Array:
    """What is known of the n features of a frame by itself: (n, 3 or 4), larger is better."""
    count = len(value_names(config)) - len(AFTER)
    if len(frame) == 0:
        return np.zeros((0, count))
    assert frame.R_RS is not None
    assert frame.sigma_ls_px is not None
    assert config.features.patch_half_m is not None
    uv, normal = frame.uvd_px[:, :2], frame.R_RS[:, :, 2]
    affine = tangent_affines(frame.p_R, normal, scene.rig, np.full(len(frame), config.features.patch_half_m))
    patch = make_look(config)(pair.left, pair.mask_left).describe(uv, affine).reliability
    # features are in the order of their contrast, or of their score
    contrast = -np.arange(len(frame), dtype=np.float64)
    place = () if frame.place_sigma_px is None else (-frame.place_sigma_px,)
    return np.column_stack([contrast, -frame.sigma_ls_px, patch, *place])


def values_after(a: StereoFeatures, b: StereoFeatures) -> tuple[Ints, Array]:
    """The most similar feature (n,) in b of each in a, and what is known of that match: (n, 3)."""
    similarity = a.descriptors @ b.descriptors.T
    best, rows = similarity.argmax(axis=1), np.arange(len(a))
    highest = similarity[rows, best]
    uv = b.uvd_px[:, :2]
    apart = np.linalg.norm(uv[best][:, None] - uv[None], axis=2) > SAME_MARK_PX
    second = np.where(apart, similarity, -1.0).max(axis=1)
    descriptors = torch.from_numpy(a.descriptors), torch.from_numpy(b.descriptors)
    with torch.inference_mode():
        probability = DualSoftmax(TEMPERATURE, DUSTBIN)(*descriptors).exp().numpy()[rows, best]
    return best, np.column_stack([highest, highest - second, probability])


def areas_of_pair(values: Array, shown: Bools, right: Bools) -> list[float]:
    """Areas of each column of values (n, v), among the features that are shown; NaN: too few of a kind."""
    found = right[shown]
    if not MIN_OF_EACH <= found.sum() <= len(found) - MIN_OF_EACH:
        return [np.nan] * values.shape[1]
    return [area_under_curve(column[shown], found) for column in values.T]


if __name__ == "__main__":
    command(main)
