"""Features and matches of every method on scenes that no method was made with, beside their time.

    python -m benchmarks.frontend.matching [--methods METHOD ...] [--short] [--again METHOD ...] [--by-scene]
                                  [--picture docs/images/frontend_pareto.png] [--record FILE]

A method is written features-zoom+matcher: ``disk-1x+lightglue`` is DISK on the crop as it is, matched by
LightGlue; without a matcher, mutual nearest neighbours; ``polhode`` alone has its own matcher, and so has
``surface``, the same with the surface network instead of blobs and their patches; ``rootsift-2x+polhode`` is
RootSIFT with that matcher. Methods whose weights are missing are left out, with the reason. What was measured
before is read from the record, whatever has become of the method since: ``--again`` measures again.

Frames 30 and 60 degrees of turn apart. Wrong stereo: the disparity is off by more than 1 px from every
surface within a pixel. Correct: the two features show the same place of the body within 5 mm. Correct at
equal precision: matches in order of confidence, over all pairs, as many as keep the precision that RootSIFT
has at its own threshold. Motion: the same RANSAC for all (frontend/matching/ransac.py); a pair without motion
counts as wrong; shares are over pairs with 30 stereo features in both frames. Times: of one core, in its own
seconds. Lit pairs: at least 3,000 px of the body are seen and lit in both frames, whatever the method finds.
Guided: the same from a prediction that is 5 degrees off (benchmarks/frontend/matching.py).
Normalised residuals: mean squares of what correct matches are off by, over their variance.
"""

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence, Set
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter
from tyro.conf import arg

from benchmarks.command import ROOT, Record, Short, command
from benchmarks.frontend.scenes import CONFIGS, UnseenScene, open_scene, render, scene_names
from benchmarks.presentation import print_table as print_rows
from benchmarks.presentation import save_figure, subplots
from benchmarks.record import Case, complete, forget
from polhode.config.frontend_settings import Frontend
from polhode.errors import InputError
from polhode.frontend.extract import extract_pair
from polhode.frontend.features.methods import feature_method
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.features.surface_features import with_patch_size
from polhode.frontend.matching.methods import Matches, match_method
from polhode.frontend.matching.pairs import MIN_INLIERS
from polhode.frontend.matching.ransac import ransac_rigid
from polhode.frontend.tracks.guided_matching import reconnect
from polhode.frontend.tracks.tracks import Association
from polhode.lie import Array, exp_so3, inverse_pose, log_so3
from polhode.records import Bools, InitialMotion, Ints

ENOUGH_FEATURES = 30
"""Pairs of frames with so many stereo features each are expected to give a motion."""
ENOUGH_LIGHT_PX = 3000
"""So much of the body must be lit and seen in both frames [px]: with less, motions are luck."""
Lit = Mapping[str, Set[tuple[int, int]]]
"""Per scene, the pairs of frames with enough light in common."""
COLUMNS = (
    "method",
    "stereo features",
    "wrong stereo [%]",
    "matches",
    "correct",
    "precision",
    "correct at equal precision",
    "rotation error [deg]",
    "within 2 deg [%]",
    "within 5 deg [%]",
    "lit pairs within 2 deg [%]",
    "guided within 2 deg: all, lit [%]",
    "ms / stereo pair",
    "ms / match",
    "normalised residuals u, v, d",
)


def lines_of(lines: Iterable[Case], method: str) -> list[Case]:
    """The measurements of one method."""
    return [line for line in lines if line["case"]["method"] == method]


def pairs_of(lines: Iterable[Case], gap: int) -> list[Case]:
    """Pairs of frames so far apart, of all scenes."""
    return [pair for line in lines for pair in line["pairs"] if pair["gap"] == gap]


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


def success(
    pairs: Sequence[Case],
    limit_deg: float,
    least_features: int = ENOUGH_FEATURES,
    key: str = "error_deg",
) -> float:
    """Share of the pairs with enough features whose rotation is right."""
    errors = [pair.get(key) for pair in pairs if pair["features"] >= least_features]
    return float(sum(e is not None and e < limit_deg for e in errors) / max(1, len(errors)))


def lit_pairs(light: Iterable[Case]) -> Lit:
    """Pairs with enough light in common, from what was measured of the scenes."""
    return {
        line["case"]["light"]: {(i, j) for i, j, area_px in line["pairs"] if area_px >= ENOUGH_LIGHT_PX}
        for line in light
    }


def lit_of(lines: Iterable[Case], gap: int, lit: Lit) -> list[Case]:
    """Those of ``pairs_of`` with enough light in common; a scene's pairs are in the order of their frames."""
    return [
        pair
        for line in lines
        for i, pair in enumerate(pairs_of([line], gap))
        if (i, i + gap) in lit[line["case"]["scene"]]
    ]


def times_ms(lines: Sequence[Case], gap: int) -> tuple[float, float]:
    """Median time of a stereo pair, and of matching two frames."""
    features = np.concatenate([line["features_s"] for line in lines])
    matching = np.array([pair["match_s"] for pair in pairs_of(lines, gap)])
    return 1e3 * float(np.median(features)), 1e3 * float(np.median(matching))


def residual_variances(pairs: Sequence[Case]) -> Array:
    """Mean normalised squares (3,) of u, v, disparity over the correct matches of the motions found."""
    sums = np.array([pair["squares"] for pair in pairs]).sum(axis=0)
    return np.asarray(sums[:3] / max(1.0, sums[3]))


def print_table(lines: Sequence[Case], methods: Sequence[str], reference: str, gap: int, lit: Lit) -> None:
    """One row a method."""
    target = precision_of(pairs_of(lines_of(lines, reference), gap))
    first = lines_of(lines, reference)
    count, lit_count = len(pairs_of(first, gap)), len(lit_of(first, gap, lit))
    counts = f"{count} pairs, {lit_count} of them lit"
    print(f"\n{30 * gap} degrees between frames: {counts}; equal precision: {target:.3f}\n")
    print_rows(COLUMNS, (_row(method, lines_of(lines, method), target, gap, lit) for method in methods))


def _row(method: str, lines: Sequence[Case], target: float, gap: int, lit: Lit) -> list[str]:
    pairs = pairs_of(lines, gap)
    features = np.concatenate([line["features"] for line in lines])
    wrong = np.concatenate([line["wrong_stereo"] for line in lines])
    errors = [pair["error_deg"] for pair in pairs if pair["error_deg"] is not None]
    stereo_ms, match_ms = times_ms(lines, gap)
    return [
        method,
        f"{np.mean(features):.0f}",
        f"{100 * wrong.sum() / max(1, features.sum()):.1f}",
        f"{np.mean([pair['matches'] for pair in pairs]):.0f}",
        f"{np.mean([pair['correct'] for pair in pairs]):.1f}",
        f"{precision_of(pairs):.2f}",
        f"{correct_at(pairs, target):.1f}",
        f"{np.median(errors):.2f}" if errors else "-",
        *(f"{100 * success(pairs, limit):.0f}" for limit in (2.0, 5.0)),
        f"{100 * success(lit_of(lines, gap, lit), 2.0, least_features=0):.0f}",
        ", ".join(
            f"{100 * success(some, 2.0, least, 'guided_deg'):.0f}"
            for some, least in ((pairs, ENOUGH_FEATURES), (lit_of(lines, gap, lit), 0))
        ),
        f"{stereo_ms:.0f}",
        f"{match_ms:.0f}",
        ", ".join(f"{value:.2f}" for value in residual_variances(pairs)),
    ]


def print_by_scene(lines: Sequence[Case], methods: Sequence[str], scenes: Sequence[str], gap: int) -> None:
    """Correct matches a pair, and the share of rotations within 2 degrees, scene by scene."""
    print(f"\n{30 * gap} degrees: correct matches, and rotations within 2 degrees [%]\n")
    rows = []
    for method in methods:
        cells = [method]
        for scene in scenes:
            pairs = pairs_of([ln for ln in lines_of(lines, method) if ln["case"]["scene"] == scene], gap)
            correct = np.mean([pair["correct"] for pair in pairs])
            cells.append(f"{correct:.0f}, {100 * success(pairs, 2.0):.0f}")
        rows.append(cells)
    print_rows(("method", *scenes), rows)


ANGLES_DEG = {1: 30, 2: 60}
NAME_WIDTH = 0.6
"""Width of a name on the axis of the times, in natural logarithms."""
OURS, OTHERS = "#b3261e", "#33556e"


def draw_pareto(lines: Sequence[Case], methods: Sequence[str], reference: str, path: Path) -> None:
    """One panel for each turn between the frames; the line joins the methods that no other beats in both."""
    figure, panels = subplots(1, len(ANGLES_DEG), (11, 4.4), layout="constrained")
    for panel, (gap, degrees) in zip(panels, ANGLES_DEG.items(), strict=True):
        precision = precision_of(pairs_of(lines_of(lines, reference), gap))
        places = [_place(lines_of(lines, method), gap, precision) for method in methods]
        front = sorted(place for place in places if not any(_beats(other, place) for other in places))
        panel.plot(*np.array(front).T, color="0.75", zorder=1)
        step, names = 0.045 * max(correct for _, correct in places), list[tuple[float, float]]()
        for correct, time_s, method in sorted((c, t, m) for m, (t, c) in zip(methods, places, strict=True)):
            colour = OURS if method.startswith("polhode") else OTHERS
            panel.plot(time_s, correct, "o", color=colour, markersize=7)
            # A name rises until it is clear of those beside it.
            beside = [height for other_s, height in names if abs(np.log(other_s / time_s)) < NAME_WIDTH]
            height = max([correct, *(taken + step for taken in beside if taken + step > correct)])
            names.append((time_s, height))
            panel.annotate(method, (1.05 * time_s, height), color=colour, fontsize=8, va="center")
        panel.set_xscale("log")
        # Room for the names to the right of the points.
        panel.set_xlim(panel.get_xlim()[0], 2.2 * panel.get_xlim()[1])
        panel.set_ylim(0, 1.08 * panel.get_ylim()[1])
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.xaxis.set_major_formatter("{x:g}")
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.grid(alpha=0.3)
        panel.set_xlabel("features of a stereo pair and one matching [s of one core]")
        panel.set_ylabel(f"correct matches at precision {precision:.2f}")
        panel.set_title(f"{degrees} degrees of turn between the frames")
    save_figure(figure, path, 110)


def _place(lines: Sequence[Case], gap: int, precision: float) -> tuple[float, float]:
    """Seconds, correct matches a pair at the given precision."""
    return sum(times_ms(lines, gap)) / 1e3, correct_at(pairs_of(lines, gap), precision)


def _beats(other: tuple[float, float], place: tuple[float, float]) -> bool:
    """Faster and at least as good, or as fast and better."""
    return other != place and other[0] <= place[0] and other[1] >= place[1]


RECORD = ROOT / "runs/records/frontend"
REFERENCE = "rootsift-2x"
SURFACE = "surface"
"""Method ``polhode`` with the surface network instead of blobs and the network of their patches."""
METHODS = (
    REFERENCE,
    "rootsift-2x+polhode",
    "polhode",
    SURFACE,
    "disk-1x",
    "disk-1x+lightglue",
    "aliked-1x",
    "aliked-1x+lightglue",
    "aliked-2x+lightglue",
    "xfeat-2x",
    "xfeat-2x+lightglue",
)
WRONG_STEREO_PX = 1.0
SAME_POINT_M = 5e-3
GAPS = (1, 2)
"""Frames between the two of a pair: 30 degrees each."""


def main(
    methods: Annotated[tuple[str, ...], arg(help="Methods to compare.")] = METHODS,
    short: Short = False,
    again: Annotated[tuple[str, ...], arg(help="Methods that are measured again.")] = (),
    by_scene: Annotated[bool, arg(help="Also print each scene by itself.")] = False,
    picture: Annotated[Path | None, arg(help="PNG of correct matches against time.")] = None,
    record: Record = RECORD,
    workers: Annotated[int, arg(help="Processes; more than one disturb the times.")] = 1,
) -> None:
    """Measure what the record lacks, print the tables, draw the picture."""
    compared = usable(dict.fromkeys((REFERENCE, *methods)))
    names = scene_names(short)
    for name in names:
        render(name)
    forget(record, lambda case: case.get("method") in again)
    cases = [case_of(method, name) for name in names for method in compared]
    lines = complete(record, cases, measure, workers)
    light = complete(record, [light_case(name) for name in names], measure_light, workers)
    for gap in GAPS:
        print_table(lines, compared, REFERENCE, gap, lit_pairs(light))
    if by_scene:
        for gap in GAPS:
            print_by_scene(lines, compared, names, gap)
    if picture is not None:
        draw_pareto(lines, compared, REFERENCE, picture)


def usable(methods: "dict[str, None]") -> list[str]:
    """Those of the methods whose weights are there; the others are named with what they lack."""
    found = []
    for method in methods:
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
    if parts["features"] == SURFACE:
        features |= {"method": "polhode", "surface_descriptor": "surface"}
    return Frontend.model_validate({"features": features, "pairs": {"method": parts["matcher"]}})


def case_of(method: str, scene: str) -> Case:
    """Names a measurement, with a digest of the scene; new code or defaults need ``--again``."""
    text = (CONFIGS / f"{scene}.yaml").read_bytes()
    return {"method": method, "scene": scene, "digest": hashlib.sha256(text).hexdigest()[:12]}


def light_case(scene: str) -> Case:
    """Names what holds for all methods: how much of the body both frames of a pair show in the light."""
    return {"light": scene, "digest": case_of(REFERENCE, scene)["digest"]}


def measure_light(case: Case) -> Case:
    """Area lit in both frames [px], for each pair."""
    scene = open_scene(case["light"])
    pairs = [(i, i + gap) for gap in GAPS for i in range(len(scene) - gap)]
    return {"pairs": [[i, j, scene.lit_in_both(i, j)] for i, j in pairs]}


def measure(case: Case) -> Case:
    """All frames and pairs of one scene by one method."""
    scene = open_scene(case["scene"])
    config = with_patch_size(settings(case["method"]), scene.sequence, scene.rectifier)
    extract_pair(scene.pair(0), scene.rig, config)  # the first call of a network takes longer
    frames, features_s = [], []
    for k in range(len(scene)):
        pair = scene.pair(k)
        begin = process_time()
        frames.append(extract_pair(pair, scene.rig, config))
        features_s.append(process_time() - begin)
    return {"features_s": features_s, **measure_frames(scene, frames, config)}


def measure_frames(scene: UnseenScene, frames: list[StereoFeatures], config: Frontend) -> Case:
    """The features of all frames, and their matches."""
    shown = [scene.body_points(k, frame.uvd_px) for k, frame in enumerate(frames)]
    points_G = [p_G for p_G, _ in shown]
    pairs = [(i, i + gap) for gap in GAPS for i in range(len(scene) - gap)]
    return {
        "features": [len(frame) for frame in frames],
        "wrong_stereo": [int(np.sum(error > WRONG_STEREO_PX)) for _, error in shown],
        "pairs": [measure_pair(scene, frames, points_G, i, j, config) for i, j in pairs],
    }


def measure_pair(
    scene: UnseenScene, frames: list[StereoFeatures], points_G: list[Array], i: int, j: int, config: Frontend
) -> Case:
    """One pair of frames: all matches by confidence; those at the method's threshold, and their motion."""
    a, b = frames[i], frames[j]
    begin = process_time()
    every = match_method(loosened(config))(a, b)
    match_s = process_time() - begin
    every_right = correct(every, points_G[i], points_G[j])
    sure = every.confidence >= threshold(config)
    usual, right = Matches(every.features[sure], every.confidence[sure]), every_right[sure]
    error_deg, inlier = motion_of(scene, usual, a, b, i, j, config)
    return {
        "gap": j - i,
        "features": min(len(a), len(b)),
        "matches": len(right),
        "correct": int(right.sum()),
        "inliers": int(inlier.sum()),
        "correct_inliers": int((right & inlier).sum()),
        "error_deg": error_deg,
        "guided_deg": guided_error_deg(scene, frames, i, j, config),
        "match_s": match_s,
        "squares": normalised_squares(scene, usual.features[right & inlier], a, b, i, j),
        "confidence": np.round(every.confidence, 4).tolist(),
        "right": every_right.astype(int).tolist(),
    }


def threshold(config: Frontend) -> float:
    """The confidence from which on the method, as it is configured, gives a match."""
    if config.matcher == config.features.method == "polhode":
        # a run keeps all that agree on the motion
        return 0.0
    return 1.0 - config.pairs.ratio if config.matcher == "nearest" else config.pairs.min_confidence


def loosened(config: Frontend) -> Frontend:
    """The same method without a threshold on its confidence."""
    pairs = config.pairs.model_copy(update={"ratio": 1.0, "min_confidence": 0.0})
    return config.model_copy(update={"pairs": pairs})


def correct(matches: Matches, p_Ga: Array, p_Gb: Array) -> Bools:
    """True (m,) where both features show the same place of the body."""
    apart = p_Ga[matches.features[:, 0]] - p_Gb[matches.features[:, 1]]
    return np.asarray(np.linalg.norm(apart, axis=1) < SAME_POINT_M)


def motion_of(
    scene: UnseenScene,
    matches: Matches,
    a: StereoFeatures,
    b: StereoFeatures,
    i: int,
    j: int,
    config: Frontend,
) -> tuple[float | None, Bools]:
    """Error of the rotation [deg], None where no motion is found, and the matches that agree with it."""
    left, right = matches.features.T
    none = np.zeros(len(left), dtype=bool)
    if len(left) < MIN_INLIERS:
        return None, none
    fit = ransac_rigid(
        a.uvd_px[left],
        a.p_R[left],
        b.p_R[right],
        scene.rig,
        np.random.default_rng([0, i, j]),
    )
    if fit.inlier.sum() < MIN_INLIERS:
        return None, none
    turn = fit.X_RiRj[:3, :3].T @ scene.motion(i, j)[:3, :3]
    return float(np.rad2deg(np.linalg.norm(log_so3(turn)))), fit.inlier


def normalised_squares(
    scene: UnseenScene, index: Ints, a: StereoFeatures, b: StereoFeatures, i: int, j: int
) -> list[float]:
    """Sums over matches (m, 2) of the squared residuals of u, v, disparity over their variances, and m.

    The residual is the measurement in frame i less that of frame j carried over by the true motion.
    """
    left, right = index.T
    X_RiRj, rig = scene.motion(i, j), scene.rig
    p_Ri = b.p_R[right] @ X_RiRj[:3, :3].T + X_RiRj[:3, 3]
    residual = a.uvd_px[left] - rig.project(p_Ri)
    # d uvd_i / d uvd_j: triangulate in j, turn, project in i.
    J = (
        np.linalg.inv(rig.triangulation_jacobian(p_Ri))
        @ X_RiRj[:3, :3]
        @ rig.triangulation_jacobian(b.p_R[right])
    )
    variance = a.sigma_px[left] ** 2 + np.einsum("nab,nb->na", J**2, b.sigma_px[right] ** 2)
    return [*np.sum(residual**2 / variance, axis=0).tolist(), len(left)]


PREDICTED_DEG = 3.0
"""Error of the prediction about each axis, standard deviation [deg]: 5 degrees in all."""
PREDICTED_SHARE = 0.01
"""Error of its distance, and half of it sideways, as shares of the distance."""
VIEW_DEG = 75.0
"""``frontend.guided.max_view_angle_deg`` here: a single view is compared with, 60 degrees away."""


def guided_error_deg(
    scene: UnseenScene, frames: list[StereoFeatures], i: int, j: int, config: Frontend
) -> float | None:
    """Error of the rotation between frames i and j found from a prediction, None where it is not found."""
    a, b = frames[i], frames[j]
    X_RG = np.stack([inverse_pose(scene.X_GR[i]), _predicted(scene, i, j)])
    guided = config.guided.model_copy(update={"max_view_angle_deg": VIEW_DEG})
    known = Association((np.arange(len(a)), np.full(len(b), -1, dtype=np.int64)))
    found = reconnect(
        [a, b], known, InitialMotion(X_RG, np.array([True, False])), scene.rig, guided, 0
    ).motion
    if not found.connected[1]:
        return None
    turn = found.X_RG[1, :3, :3].T @ inverse_pose(scene.X_GR[j])[:3, :3]
    return float(np.rad2deg(np.linalg.norm(log_so3(turn))))


def _predicted(scene: UnseenScene, i: int, j: int) -> Array:
    """True pose of frame j, off by the errors above."""
    rng = np.random.default_rng([i, j])
    X_RG = inverse_pose(scene.X_GR[j])
    X_RG[:3, :3] = X_RG[:3, :3] @ exp_so3(np.deg2rad(PREDICTED_DEG) * rng.normal(size=3))
    X_RG[:3, 3] *= 1.0 + PREDICTED_SHARE * rng.normal()
    X_RG[:3, 3] += 0.5 * PREDICTED_SHARE * X_RG[2, 3] * rng.normal(size=3)
    return np.asarray(X_RG)


if __name__ == "__main__":
    command(main)
