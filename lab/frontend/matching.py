"""Features and matches of every method on scenes that no method was made with, beside their time.

    python -m lab.frontend.matching [--methods METHOD ...] [--short] [--record DIR]

A method is written features-zoom+matcher: ``rootsift-2x+polhode`` is RootSIFT on the crop enlarged twice,
with our matcher; without a matcher, mutual nearest neighbours; ``polhode`` alone has its own matcher, and so
has ``surface``, the same with the surface network instead of blobs and their patches.

Scenes: configs/frontend_test/, with bodies, a texture generator and Sun directions that training never sees
and frames 30 degrees of turn apart; they are rendered to data/frontend_test/. Wrong stereo: the disparity
is off by more than 1 px from every surface within a pixel. Correct: the two features show the same place of
the body within 5 mm. Correct at equal precision: matches in order of confidence, over all pairs, as many as
keep the precision that RootSIFT has at its own threshold. Rotation error: median of those found, by the
same RANSAC for all (frontend/matching/ransac.py). Lit pairs: at least 3,000 px of the body are seen and lit
in both frames, whatever the method finds; a pair without motion counts as wrong. Times are of one core.
"""

import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
from tyro.conf import arg

from lab.command import ROOT, Record, Short, command, simulated
from lab.frontend.scenes import UnseenScene, open_scene
from lab.presentation import print_table
from lab.record import Case, complete
from polhode.config.frontend_settings import Frontend
from polhode.frontend.extract import extract_pair
from polhode.frontend.features.methods import feature_method
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.features.surface_features import with_patch_size
from polhode.frontend.matching.methods import match_method
from polhode.frontend.matching.pairs import MIN_INLIERS
from polhode.frontend.matching.ransac import ransac_rigid
from polhode.geometry.lie import Array, Ints, log_so3
from polhode.runtime.errors import InputError

REFERENCE = "rootsift-2x"
METHODS = (REFERENCE, "rootsift-2x+polhode", "polhode", "surface")
GAPS = (1, 2)
"""Frames between the two of a pair: 30 degrees each."""
MIN_LIT_PX = 3000
"""So much of the body must be lit and seen in both frames [px]: with less, motions are luck."""
MAX_STEREO_ERROR_PX = 1.0
SAME_POINT_M = 5e-3
RIGHT_DEG = 2.0
COLUMNS = (
    "method | stereo features | wrong stereo [%] | matches | correct | precision | correct at equal "
    "precision | rotation error [deg] | lit pairs within 2 deg [%] | ms / stereo pair | ms / match"
)
SHORT_METHODS, SHORT_FRAMES = (REFERENCE, "polhode"), 3


def main(
    methods: Annotated[tuple[str, ...], arg(help="Methods to compare.")] = METHODS,
    short: Short = False,
    record: Record = ROOT / "runs/records/frontend",
) -> None:
    """Measure what the record lacks, print the tables."""
    compared = usable(SHORT_METHODS if short else (REFERENCE, *methods))
    names = sorted(path.stem for path in (ROOT / "configs/frontend_test").glob("*.yaml"))
    scenes = ["sample"] if short else names
    for name in scenes:
        folder_of(name)
    cases: list[Case] = [{"method": method, "scene": scene} for method in compared for scene in scenes]
    lines = complete(record, cases, measure, 1)
    for gap in GAPS:
        pairs = {
            method: [
                pair
                for line in lines
                if line["case"]["method"] == method
                for pair in line["pairs"]
                if pair["gap"] == gap
            ]
            for method in compared
        }
        target = precision_of(pairs[REFERENCE])
        lit = sum(pair["lit"] for pair in pairs[REFERENCE])
        print(
            f"\n{30 * gap} degrees between frames: {len(pairs[REFERENCE])} pairs, {lit} of them lit; "
            f"equal precision: {target:.3f}\n"
        )
        print_table(COLUMNS, (row(method, lines, found, target) for method, found in pairs.items()))


def usable(methods: Sequence[str]) -> list[str]:
    """Those of the methods whose weights are there; the others are named with what they lack."""
    found = []
    for method in dict.fromkeys(methods):
        config = settings(method)
        try:
            feature_method(config), match_method(config)
        except InputError as error:
            print(f"{method} is left out: {error}")
        else:
            found.append(method)
    return found


def settings(method: str) -> Frontend:
    """Configuration of a method by its name here."""
    parts = re.fullmatch(r"(?P<features>[a-z]+)(-(?P<zoom>[\d.]+)x)?(\+(?P<matcher>[a-z]+))?", method)
    if parts is None:
        raise SystemExit(f"{method}: write features, or features-2x+matcher")
    features = {"method": parts["features"]} | ({"upsample": parts["zoom"]} if parts["zoom"] else {})
    if parts["features"] == "surface":
        features |= {"method": "polhode", "surface_descriptor": "surface"}
    return Frontend.model_validate({"features": features, "pairs": {"method": parts["matcher"]}})


def folder_of(scene: str) -> tuple[Path, Path]:
    """Configuration and folder of a scene, rendered if it is missing."""
    if scene == "sample":
        return ROOT / "configs/sample.yaml", ROOT / "examples" / "sample"
    config = ROOT / "configs/frontend_test" / f"{scene}.yaml"
    return config, simulated(config, ROOT / "data/frontend_test" / scene)


def measure(case: Case) -> Case:
    """All frames and pairs of one scene by one method; of the sample the first few."""
    scene = _scene(case["scene"])
    config = with_patch_size(settings(case["method"]), scene.sequence, scene.rectifier)
    count = SHORT_FRAMES if case["scene"] == "sample" else len(scene.sequence)
    extract_pair(scene.pair(0), scene.rectifier.rig, config)  # the first call of a network takes longer
    frames: list[StereoFeatures] = []
    features_s = []
    for k in range(count):
        pair = scene.pair(k)
        begin = process_time()
        frames.append(extract_pair(pair, scene.rectifier.rig, config))
        features_s.append(process_time() - begin)
    shown = [scene.body_points(k, frame.uvd_px) for k, frame in enumerate(frames)]
    return {
        "features": [len(frame) for frame in frames],
        "features_s": features_s,
        "wrong_stereo": [int(np.sum(error > MAX_STEREO_ERROR_PX)) for _, error in shown],
        "pairs": list(_pairs(case["scene"], scene, config, frames, [p_G for p_G, _ in shown])),
    }


def _pairs(
    name: str, scene: UnseenScene, config: Frontend, frames: list[StereoFeatures], p_G: list[Array]
) -> Iterator[Case]:
    """Each pair of frames: all matches by confidence; those at the method's threshold, and their motion."""
    loose = config.pairs.model_copy(update={"ratio": 1.0, "min_confidence": 0.0})
    matcher = match_method(config.model_copy(update={"pairs": loose}))
    for i, j in ((i, i + gap) for gap in GAPS for i in range(len(frames) - gap)):
        begin = process_time()
        every = matcher(frames[i], frames[j])
        match_s = process_time() - begin
        apart = p_G[i][every.features[:, 0]] - p_G[j][every.features[:, 1]]
        right = np.linalg.norm(apart, axis=1) < SAME_POINT_M
        sure = every.confidence >= threshold(config)
        yield {
            "gap": j - i,
            "lit": lit_px(name, i, j) >= MIN_LIT_PX,
            "matches": int(sure.sum()),
            "correct": int(right[sure].sum()),
            "error_deg": rotation_error_deg(scene, every.features[sure], frames, i, j),
            "match_s": match_s,
            "confidence": np.round(every.confidence, 4).tolist(),
            "right": right.astype(int).tolist(),
        }


@cache
def lit_px(name: str, i: int, j: int) -> int:
    """Area lit in both frames of a scene, which is the same for every method."""
    return _scene(name).lit_in_both_px(i, j)


@cache
def _scene(name: str) -> UnseenScene:
    return open_scene(*folder_of(name))


def threshold(config: Frontend) -> float:
    """The confidence from which on the method, as it is configured, gives a match."""
    if config.matcher == config.features.method == "polhode":
        # a run keeps all that agree on the motion
        return 0.0
    return 1.0 - config.pairs.ratio if config.matcher == "nearest" else config.pairs.min_confidence


def rotation_error_deg(
    scene: UnseenScene, features: Ints, frames: list[StereoFeatures], i: int, j: int
) -> float | None:
    """Error of the motion that matched features (m, 2) agree on; None where no motion is found."""
    if len(features) < MIN_INLIERS:
        return None
    (left, right), a, b = features.T, frames[i], frames[j]
    rng = np.random.default_rng([0, i, j])
    fit = ransac_rigid(a.uvd_px[left], a.p_R[left], b.p_R[right], scene.rectifier.rig, rng)
    if fit.inlier.sum() < MIN_INLIERS:
        return None
    return float(np.rad2deg(np.linalg.norm(log_so3(fit.X_RiRj[:3, :3].T @ scene.rotation(i, j)))))


def precision_of(pairs: Sequence[Case]) -> float:
    """Correct matches over all, at the method's own threshold."""
    return float(sum(pair["correct"] for pair in pairs) / max(1, sum(pair["matches"] for pair in pairs)))


def correct_at(pairs: Sequence[Case], precision: float) -> float:
    """Most correct matches a pair that a threshold on the confidence gives with at least this precision."""
    confidence = np.concatenate([np.asarray(pair["confidence"], float) for pair in pairs])
    right = np.concatenate([np.asarray(pair["right"], float) for pair in pairs])
    if len(right) == 0:
        return 0.0
    order = np.argsort(-confidence, kind="stable")
    correct = np.cumsum(right[order])
    # A threshold takes all matches of one confidence or none.
    last = np.append(np.diff(confidence[order]) != 0, True)
    good = last & (correct >= precision * np.arange(1, len(order) + 1))
    return float(correct[good].max(initial=0.0)) / len(pairs)


def row(method: str, lines: Sequence[Case], pairs: Sequence[Case], precision: float) -> list[str]:
    """One method; ``pairs`` are those of one gap."""
    own = [line for line in lines if line["case"]["method"] == method]
    features, wrong, seconds = (
        np.concatenate([line[name] for line in own]) for name in ("features", "wrong_stereo", "features_s")
    )
    errors = [pair["error_deg"] for pair in pairs if pair["error_deg"] is not None]
    lit = [pair["error_deg"] for pair in pairs if pair["lit"]]
    right = sum(error is not None and error < RIGHT_DEG for error in lit)
    return [
        method,
        f"{np.mean(features):.0f}",
        f"{100 * wrong.sum() / max(1, features.sum()):.1f}",
        f"{np.mean([pair['matches'] for pair in pairs]):.0f}",
        f"{np.mean([pair['correct'] for pair in pairs]):.1f}",
        f"{precision_of(pairs):.2f}",
        f"{correct_at(pairs, precision):.1f}",
        f"{np.median(errors):.2f}" if errors else "-",
        f"{100 * right / max(1, len(lit)):.0f}",
        f"{1e3 * np.median(seconds):.0f}",
        f"{1e3 * np.median([pair['match_s'] for pair in pairs]):.0f}",
    ]


if __name__ == "__main__":
    command(main)
