"""ViSP's model-based edge tracker on rendered views, from starts that are wrong by a known amount.

    python -m benchmarks.edges.visp_tracker [BODY ...] [--views 50] [--angle 2] [--shift 0.02]

For each body: views of random poses, 2 to 4 m away, under random sunlight (benchmarks/edges/views.py);
each tracker gets the image, the model and a start that is off by ``--angle`` degrees and ``--shift`` metres
about each axis (sigma). Errors are those of the body's middle, along the axes of the camera, and of the
attitude, about them. ``lost``: the tracker says so; ``wrong``: it does not, but its pose is off by more than
50 mm or 5 degrees. Errors are of the rest; NEES: squared errors over the tracker's own covariance, 1 is
honest.

ViSP (Marchand, Spindler, Chaumette 2005) is a tracker for video: it learns the appearance of an edge from the
first image.

ViSP is free software under the GPL. Nothing of it is here: ``visp_edges/track.cpp`` is a small program of
our own that is linked with it, and only by who runs this benchmark: Debian's package libvisp-mbt-dev and a
C++ compiler must be there (``CXX``). The rest of polhode neither needs nor links it.

Ours (benchmarks/edges/tracking/tracker.py) gets the same images and starts; its covariance is the calibrated
one. ``kept``: as ours, but a pose that its residual statistic does not trust is lost, too.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import trimesh
from PIL import Image
from tyro.conf import Positional, arg

from benchmarks.command import command
from benchmarks.edges.tracking.calibrated_covariance import LEVELS, nees, parts_of
from benchmarks.edges.tracking.residual import TRUSTED, probability, support
from benchmarks.edges.tracking.tracker import track
from benchmarks.edges.views import (
    SOLIDS,
    EdgeViews,
    edge_body,
    edge_rig,
    middle,
    perturbed,
    pose_errors,
    random_poses,
    random_suns,
)
from benchmarks.presentation import numbers, print_table
from polhode.camera import RectifiedRig
from polhode.errors import InputError
from polhode.images import Grey
from polhode.lie import Array, hat, log_so3, right_jacobian_so3
from polhode.planning.edges.edge_model import edge_model
from polhode.records import Bools, Ints

SOURCE = Path(__file__).with_name("visp_edges") / "track.cpp"
LIBRARIES = ("-lvisp_mbt", "-lvisp_me", "-lvisp_io", "-lvisp_core")
INCLUDES = ("-I/usr/include/opencv4", "-I/usr/include/eigen3")
FAR_M, FAR_DEG = 0.05, 5.0
"""A pose that is off by more is wrong."""


class NoVispError(Exception):
    """ViSP is not installed, or does not compile here; in a line."""


SETTINGS = (
    # largest angles between a face and the line of sight; share of the sites that must be found
    "appear 88.0 disappear 89.0 good 0.2",
    # least response of the mask, change of contrast, size and number of masks, distance between sites [px]
    "edges 10000.0 0.5 0.5 5 180 2.0",
    # search ranges [px], in one round after the other, each with one call of track()
    "rounds 6 10 8 6 4 3 2 1",
)
"""Of ViSP's tracker, found on views of another seed. Several rounds with a search that narrows help it; the
threshold, the contrast and a mask of 3 or 5 px change less than 30 views can distinguish."""


@dataclass(frozen=True)
class TrackerTrial:
    """Views of one body, as a tracker gets them."""

    mesh: trimesh.Trimesh
    """In G"""
    rig: RectifiedRig
    images: Sequence[Grey]
    X_start: Array
    """(V, 4, 4) X_CG to start from"""


@dataclass(frozen=True)
class Answer:
    """What a tracker finds."""

    X_CG: Array
    """(V, 4, 4)"""
    lost: Bools
    """(V,) the tracker says that it has no pose"""
    covariance: Array
    """(V, 6, 6) of ``pose_errors`` about the mesh's middle [m, rad]; NaN where unknown"""
    statistics: dict[str, Array] = field(default_factory=dict)
    """(V,) each: what else it tells of its pose"""


Tracker = Callable[[TrackerTrial], Answer]


def visp_answer(trial: TrackerTrial) -> Answer:
    """ViSP's poses, with the mesh's flat faces for a model. Raises NoVispError."""
    X_CG, covariance, statistics = visp_poses(polygons_of(trial.mesh), trial.rig, trial.images, trial.X_start)
    lost = statistics.pop("lost").astype(bool)
    covariance[lost] = np.nan
    about_G = middle(trial.mesh)
    turned = [about_camera_axes(C, X, about_G) for C, X in zip(covariance, X_CG, strict=True)]
    return Answer(X_CG, lost, np.array(turned), statistics)


def our_answer(trial: TrackerTrial, trusted: bool = False) -> Answer:
    """Our poses, with all edges of the mesh for a model."""
    model = edge_model(trial.mesh)
    X, lost, covariance = np.array(trial.X_start), np.zeros(len(trial.X_start), dtype=bool), []
    for k, (image, start) in enumerate(zip(trial.images, trial.X_start, strict=True)):
        tracked = track(model, trial.rig, image, start)
        X[k] = tracked.X_RG
        whole = tracked.converged and len(tracked.information.unobservable) == 0
        unsure = trusted and probability(support(tracked, image).as_features[None])[0] < TRUSTED
        lost[k] = not whole or unsure
        known = LEVELS.covariance(parts_of(tracked))[0] if whole else np.full((6, 6), np.nan)
        covariance.append(known)
    return Answer(X, lost, np.array(covariance))


TRACKERS: dict[str, Tracker] = {
    "ViSP": visp_answer,
    "ours": our_answer,
    "ours, kept": partial(our_answer, trusted=True),
}


def visp_poses(
    polygons: Sequence[Array],
    rig: RectifiedRig,
    images: Sequence[Grey],
    X_start: Array,
) -> tuple[Array, Array, dict[str, Array]]:
    """X_CG (V, 4, 4), covariances (V, 6, 6) of (translation, theta u) of X_CG, and statistics (V,) each.

    polygons (n, 3) in G [m] (visp_model.py); images uint8 (H, W); X_start (V, 4, 4). Statistics: lost (0 or
    1), sites, weights (sum of the robust ones), residual (weighted rms, of the normalised image),
    projection_error_deg (ViSP's own: between edges and gradients), seconds of the processor.
    Raises NoVispError.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "model.cao").write_text(cao_text(polygons), encoding="ascii")
        job = folder / "job"
        job.write_text(_job(folder, rig, images, X_start), encoding="ascii")
        done = subprocess.run([program(), job], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise NoVispError(f"ViSP's tracker failed: {done.stderr.strip().splitlines()[-1]}")
    lines = [line.split() for line in done.stdout.splitlines() if line.startswith(("ok ", "lost "))]
    if len(lines) != len(images):
        raise NoVispError(f"ViSP's tracker gave {len(lines)} poses for {len(images)} images")
    values = np.array([[float(value) for value in line[1:]] for line in lines])
    X_CG = np.tile(np.eye(4), (len(lines), 1, 1))
    X_CG[:, :3] = values[:, :12].reshape(-1, 3, 4)
    names = ("sites", "weights", "residual", "projection_error_deg", "seconds")
    statistics = dict(zip(names, values[:, 48:].T, strict=True))
    statistics["lost"] = np.array([float(line[0] == "lost") for line in lines])
    return X_CG, values[:, 12:48].reshape(-1, 6, 6), statistics


def _job(
    folder: Path,
    rig: RectifiedRig,
    images: Sequence[Grey],
    X_start: Array,
) -> str:
    """Write the images; the text that tells ``track`` what to do."""
    rows = [
        f"model {folder / 'model.cao'}",
        f"camera {rig.focal_px} {rig.focal_px} {rig.cx_px} {rig.cy_px}",
        *SETTINGS,
        f"views {len(images)}",
    ]
    for k, (image, X) in enumerate(zip(images, X_start, strict=True)):
        path = folder / f"{k}.pgm"
        Image.fromarray(image).save(path)
        # no earlier image to learn from
        rows.append(f"{path} - {' '.join(repr(float(value)) for value in X[:3].ravel())}")
    return "\n".join(rows) + "\n"


@cache
def _workshop() -> TemporaryDirectory[str]:
    """Where the program lies while this process lives."""
    return TemporaryDirectory(prefix="visp_edges_")


@cache
def program() -> Path:
    """Compile ``track``, once a process: a few seconds. Raises NoVispError."""
    target = Path(_workshop().name) / "track"
    compiler = os.environ.get("CXX", "g++")
    words = [compiler, "-std=c++17", "-O2", *INCLUDES, str(SOURCE), "-o", str(target), *LIBRARIES]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    except OSError:
        raise NoVispError(f"no C++ compiler {compiler}: install one, or name it by CXX") from None
    if done.returncode != 0:
        wrong = [line for line in done.stderr.splitlines() if "error" in line or "cannot find" in line]
        why = f": {wrong[0][:160]}" if wrong else ""
        raise NoVispError(f"ViSP is not here (Debian: apt-get install libvisp-mbt-dev){why}")
    return target


def about_camera_axes(covariance: Array, X_CG: Array, about_G: Array) -> Array:
    """Covariance (6, 6) of (translation, theta u) of X_CG (4, 4) -> that of ``pose_errors`` about a point."""
    lever = hat(X_CG[:3, :3] @ about_G)
    # exp(theta + d) = exp(J_left d) exp(theta), and J_left(theta) = J_right(-theta)
    J_left = right_jacobian_so3(-log_so3(X_CG[:3, :3]))
    T = np.block([[np.eye(3), -lever @ J_left], [np.zeros((3, 3)), J_left]])
    return np.asarray(T @ covariance @ T.T)


@dataclass(frozen=True)
class Options:
    """Of the trials."""

    views: int = 50
    angle_deg: float = 2.0
    shift_m: float = 0.02
    seed: int = 0


def trial_of(name: str, options: Options) -> tuple[TrackerTrial, Array]:
    """Views of a body with starts, and the true X_CG (V, 4, 4)."""
    target, rig = edge_body(name), edge_rig()
    views = EdgeViews(target, rig, options.seed)
    X_CG = random_poses(target.mesh, rig, options.views, options.seed)
    suns = random_suns(options.views, options.seed)
    X_start = perturbed(X_CG, middle(target.mesh), options.seed, options.angle_deg, options.shift_m)
    return TrackerTrial(target.mesh, rig, views.images(X_CG, suns), X_start), X_CG


HEAD = (
    "body | tracker | lost | wrong | x [mm] | y | z | about x [deg] | about y | about z | NEES / 6 | "
    "median [mm] | median [deg] | s per view"
)


def row(
    body: str, tracker: str, answer: Answer, X_CG: Array, about_G: Array, seconds: float = 0.0
) -> list[str]:
    """Cells of the table: root mean squares of the errors, and medians of their lengths."""
    errors = pose_errors(answer.X_CG, X_CG, about_G)
    place_m, turn_deg = (
        np.linalg.norm(errors[:, :3], axis=1),
        np.rad2deg(np.linalg.norm(errors[:, 3:], axis=1)),
    )
    wrong = ~answer.lost & ((place_m > FAR_M) | (turn_deg > FAR_DEG))
    good = ~answer.lost & ~wrong
    cells = [body, tracker, f"{answer.lost.sum()}", f"{wrong.sum()}"]
    if not good.any():
        return cells + ["-"] * 10
    rms = np.sqrt((errors[good] ** 2).mean(axis=0))
    cells += [*numbers(1e3 * rms[:3], ".2f"), *numbers(np.rad2deg(rms[3:]), ".3f")]
    cells.append(f"{np.mean(nees(errors[good], answer.covariance[good])) / 6:.2g}")
    cells += [f"{1e3 * np.median(place_m[good]):.2f}", f"{np.median(turn_deg[good]):.3f}"]
    return [*cells, f"{seconds / len(X_CG):.3f}"]


def main(
    bodies: Positional[tuple[str, ...]] = tuple(SOLIDS),
    views: int = Options.views,
    angle: Annotated[float, arg(help="Sigma of the start [deg].")] = Options.angle_deg,
    shift: Annotated[float, arg(help="Sigma of the start [m].")] = Options.shift_m,
    seed: int = Options.seed,
) -> None:
    """Print the table."""
    try:
        program()
        print_table(HEAD, _rows(bodies, Options(views, angle, shift, seed)), right_from=2)
    except (NoVispError, InputError) as problem:
        print(f"polhode: error: {problem}", file=sys.stderr)
        sys.exit(2)


def _rows(bodies: Sequence[str], options: Options) -> Iterator[list[str]]:
    for name in bodies:
        trial, X_CG = trial_of(name, options)
        about_G, count = middle(trial.mesh), len(X_CG)
        start = Answer(trial.X_start, np.zeros(count, dtype=bool), np.full((count, 6, 6), np.nan))
        yield row(name, "the start", start, X_CG, about_G)
        for tracker, answer_of in TRACKERS.items():
            begin = time.perf_counter()
            answer = answer_of(trial)
            yield row(name, tracker, answer, X_CG, about_G, time.perf_counter() - begin)


FLAT_DEG = 0.5
"""Neighbouring triangles that meet at less than this are one face."""


def polygons_of(mesh: trimesh.Trimesh) -> list[Array]:
    """Outlines (n, 3) of the mesh's flat faces [m], counter-clockwise from outside.

    Holes in a face are left out: the face is closed over them. Curved surfaces come as their facets, each an
    edge for ViSP: it is for bodies with flat sides.
    """
    merged = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    merged.merge_vertices()
    same = np.abs(merged.face_adjacency_angles) < np.deg2rad(FLAT_DEG)
    labels = trimesh.graph.connected_component_labels(
        merged.face_adjacency[same], node_count=len(merged.faces)
    )
    vertices, faces = np.asarray(merged.vertices), np.asarray(merged.faces)
    outlines = []
    for label in range(labels.max() + 1):
        loops = [vertices[loop] for loop in _loops(faces[labels == label])]
        outlines.append(max(loops, key=lambda loop: float(np.linalg.norm(_area_vector(loop)))))
    return outlines


def _loops(faces: Ints) -> list[list[int]]:
    """Rims of a patch of triangles (n, 3): vertices in order, closed."""
    sides = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = {(int(a), int(b)) for a, b in sides}
    after: dict[int, list[int]] = {}
    for a, b in sorted(there):
        if (b, a) not in there:
            after.setdefault(a, []).append(b)
    loops = []
    while after:
        first = here = next(iter(after))
        loop = []
        while here in after:
            loop.append(here)
            ahead = after[here].pop()
            if not after[here]:
                del after[here]
            here = ahead
            if here == first:
                break
        loops.append(loop)
    return loops


def _area_vector(loop: Array) -> Array:
    """Normal (3,) of a polygon (n, 3), as long as its area."""
    return np.asarray(0.5 * np.cross(loop, np.roll(loop, -1, axis=0)).sum(axis=0))


def cao_text(polygons: Sequence[Array]) -> str:
    """The text of a CAO file: polygons (n, 3) of three and more points; two points are a line, always seen.

    Raises InputError: no polygon, or one of a single point.
    """
    if not polygons or any(len(polygon) < 2 for polygon in polygons):
        raise InputError("a model of ViSP needs polygons, or lines of two points")
    points, index = np.unique(np.vstack(polygons).round(9), axis=0, return_inverse=True)
    each = np.split(index.reshape(-1), np.cumsum([len(polygon) for polygon in polygons])[:-1])
    lines = [corners for corners in each if len(corners) == 2]
    faces = [corners for corners in each if len(corners) > 2]
    rows = ["V1", "# points", str(len(points)), *(f"{x:.9f} {y:.9f} {z:.9f}" for x, y, z in points)]
    rows += ["# lines", str(len(lines)), *(f"{a} {b}" for a, b in lines)]
    rows += ["# faces of lines", "0", "# faces of points", str(len(faces))]
    rows += [" ".join(str(k) for k in [len(corners), *corners]) for corners in faces]
    return "\n".join([*rows, "# cylinders", "0", "# circles", "0", ""])


if __name__ == "__main__":
    command(main)
