"""Photographs of a real object with known motion: displacements, rate, axis, and mesh outside of its box.

    python -m benchmarks.end_to_end.photographs SEQ --run RUN [--box None] [-o PNG]

SEQ holds ``mav0/`` and ``truth.csv``: timestamp [ns], rotation row by row and translation [m] that take the
object's frame O to the left camera. The truth is the calibration of the views. RUN is made by
configs/default.yaml unless it exists. The run's landmarks of the first frame are carried to the other frames
by the estimate and by the truth; the rate is that of the whole sequence, the axis that of its rotation. The
mesh is laid into O by all frames.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from tyro.conf import Positional, arg

from benchmarks.command import DEFAULT, Png, command, polhode
from benchmarks.end_to_end.readme_picture import (
    GAP_PX,
    INK,
    PAPER,
    SIDE_PX,
    Picture,
    square_around,
    surface_panel,
)
from polhode.dataset import open_sequence
from polhode.errors import InputError
from polhode.frontend.rectification import Crop, make_rectifier, rectified_pair, target_crop
from polhode.lie import Array, exp_so3, inverse_pose, log_so3, make_pose, transform_points
from polhode.pipeline.run_directory.stored_run import StoredRun, read_stored_run
from polhode.records import Ints
from polhode.rigid_fit import fit_rigid
from polhode.tables import read_table

TEMPLE_BOX_M = (-0.023121, -0.038009, -0.091940, 0.078626, 0.121636, -0.017395)
"""The object of the templeRing set lies between these corners of its frame."""
FAR_M = 2e-3
"""The box of the temple ends up to 2 mm above the cloth on which it stands."""
SHIFT_M = 0.2e-3
"""Half of what the landmarks are displaced by against the calibration."""
DOCS = "docs/validation.md"


@dataclass(frozen=True)
class Agreement:
    """A run against the calibrated views."""

    pairs: tuple[int, int]
    """Compared, and in the truth"""
    displacement_mm: Array
    """(F - 1,) median over the landmarks, of each frame but the first"""
    rate_error: float
    """Relative"""
    axis_error_deg: float
    vertices: int
    outside: float
    """Share of the mesh's vertices outside of the box"""
    far_outside: float
    """Share that is farther outside than FAR_M"""

    def lines(self) -> list[str]:
        """What the benchmark prints."""
        return [
            f"pairs: {self.pairs[0]} of {self.pairs[1]}",
            f"displacement of landmarks: {np.median(self.displacement_mm):.3f} mm (median of the frames), "
            f"{self.displacement_mm.max():.3f} mm (largest)",
            f"rate: {100 * self.rate_error:+.3f} %",
            f"axis: {self.axis_error_deg:.3f} deg",
            f"mesh outside the box: {100 * self.outside:.2f} % of {self.vertices} vertices, "
            f"{100 * self.far_outside:.2f} % by more than {1e3 * FAR_M:g} mm",
        ]


def main(
    sequence: Positional[Path],
    run: Annotated[Path, arg(metavar="RUN", help="The run; made unless it exists.")] = Path("runs/temple"),
    box: Annotated[
        tuple[float, float, float, float, float, float] | None,
        arg(help="Lower and upper corner of the object's box in its frame [m]; None: not known."),
    ] = TEMPLE_BOX_M,
    output: Png = None,
    frame: Annotated[int, arg(help="Frame that the figure shows.")] = 0,
) -> None:
    """Run, compare, print, draw."""
    if not run.is_dir():
        polhode("run", DEFAULT, "--data", sequence, "-o", run)
    content = read_stored_run(run, run.name)
    if content.motion is None or content.landmarks is None:
        raise InputError(f"{run}: the run found no motion")
    stamps, X_CO = read_poses(sequence / "truth.csv")
    found = agreement(content, stamps, X_CO, np.reshape(TEMPLE_BOX_M if box is None else box, (2, 3)))
    print("\n".join(found.lines() if box is not None else found.lines()[:-1]))
    if box is not None and content.surface is not None:
        print("\n".join(limits_of_the_box(content, stamps, X_CO, np.reshape(box, (2, 3)))))
    if output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        side_by_side(content, sequence, frame).save(output, optimize=True)
        print(f"{output}: {output.stat().st_size / 1e3:.0f} kB")


def read_poses(path: Path) -> tuple[Ints, Array]:
    """Timestamps (F,) [ns] and X_CO (F, 4, 4) of the calibrated views."""
    table = read_table(path, columns=12, docs=DOCS)
    rows = table.values
    return table.timestamps_ns, make_pose(rows[:, :9].reshape(-1, 3, 3), rows[:, 9:])


def agreement(content: StoredRun, stamps: Ints, X_CO: Array, box_O: Array) -> Agreement:
    """Compare a run whose inspector is at rest, so that N is the left camera, with the views; box (2, 3)."""
    motion, landmarks = content.motion, content.landmarks
    assert motion is not None and landmarks is not None
    common, estimated, true = np.intersect1d(motion.trajectory.timestamps_ns, stamps, return_indices=True)
    X_CG, X_CO = motion.X_NG[estimated], X_CO[true]
    p_G = landmarks.p_G
    first = transform_points(X_CG[0], p_G)
    moved = X_CO @ inverse_pose(X_CO[0])
    off = [
        np.median(np.linalg.norm(transform_points(X, p_G) - transform_points(D, first), axis=1))
        for X, D in zip(X_CG[1:], moved[1:], strict=True)
    ]
    w, w_true = (mean_rate(1e-9 * (common - common[0]), X[:, :3, :3]) for X in (X_CG, X_CO))
    cosine = float(w @ w_true / np.linalg.norm(w) / np.linalg.norm(w_true))
    mesh_G = np.zeros((0, 3)) if content.surface is None else np.asarray(content.surface.mesh.vertices)
    vertices_O = transform_points(object_frame(X_CO, X_CG, p_G), mesh_G)
    off_m = np.linalg.norm(vertices_O - np.clip(vertices_O, box_O[0], box_O[1]), axis=1)
    return Agreement(
        (len(common), len(stamps)),
        1e3 * np.array(off),
        float(np.linalg.norm(w) / np.linalg.norm(w_true) - 1.0),
        float(np.rad2deg(np.arccos(min(cosine, 1.0)))),
        len(vertices_O),
        *(float(np.mean(off_m > limit)) if len(off_m) else float("nan") for limit in (0.0, FAR_M)),
    )


def limits_of_the_box(content: StoredRun, stamps: Ints, X_CO: Array, box_O: Array) -> list[str]:
    """What the share of the vertices outside of the box (2, 3) depends on, as lines: frames that a vertex was
    seen in, its sigma, and where the mesh is laid into O."""
    motion, landmarks, surface = content.motion, content.landmarks, content.surface
    assert motion is not None and landmarks is not None and surface is not None
    _, estimated, true = np.intersect1d(motion.trajectory.timestamps_ns, stamps, return_indices=True)
    X_OG = object_frame(X_CO[true], motion.X_NG[estimated], landmarks.p_G)
    vertices_O = transform_points(X_OG, np.asarray(surface.mesh.vertices))
    views, sigma_m = np.asarray(surface.views), np.asarray(surface.sigma_m)

    def off_m(moved_O: Array) -> Array:
        at_O = vertices_O + moved_O
        return np.asarray(np.linalg.norm(at_O - np.clip(at_O, box_O[0], box_O[1]), axis=1))

    off, known = off_m(np.zeros(3)), np.isfinite(sigma_m)
    seen = [(n, views >= n) for n in (4, 6, 8)]
    sure = [(q, known & (sigma_m <= np.percentile(sigma_m[known], q))) for q in (95, 80)]
    beyond = [(k, np.mean(off[known] > k * sigma_m[known])) for k in (1, 2, 3)]
    shifts = [np.mean(off_m(sign * SHIFT_M * axis) > 0.0) for axis in np.eye(3) for sign in (-1.0, 1.0)]
    return [
        "outside, of the vertices seen in at least n frames: "
        + ", ".join(f"{n}: {100 * np.mean(off[one] > 0.0):.2f} % ({one.mean():.0%} left)" for n, one in seen),
        "outside, of those with the smallest sigmas: "
        + ", ".join(f"{q} % of them: {100 * np.mean(off[one] > 0.0):.2f} %" for q, one in sure),
        "outside by more than k of their sigmas: "
        + ", ".join(f"{k}: {100 * share:.2f} %" for k, share in beyond),
        f"outside if the mesh is moved by {1e3 * SHIFT_M:g} mm along one of the axes: "
        f"{100 * min(shifts):.2f} to {100 * max(shifts):.2f} %",
    ]


def mean_rate(time_s: Array, R: Array) -> Array:
    """Constant angular velocity (3,) [rad/s] that fits rotations R (F, 3, 3) of a spin, by least squares.

    Successive frames turn by less than half a revolution per smallest interval, over gaps by as many
    revolutions as their rate says.
    """
    between = log_so3(R[1:] @ np.swapaxes(R[:-1], 1, 2))
    step_s = np.diff(time_s)
    near = step_s < 1.5 * step_s.min()
    w = np.mean(between[near] / step_s[near, None], axis=0)
    for _ in range(5):
        # What the rate leaves over, from the first frame on, is small and grows in proportion to time.
        undone = exp_so3(-w * time_s[:, None]) @ R
        left = log_so3(undone @ undone[0].T)
        centred = time_s - time_s.mean()
        w = w + centred @ left / (centred @ centred)
    return np.asarray(w)


def object_frame(X_CO: Array, X_CG: Array, p_G: Array) -> Array:
    """X_OG (4, 4) that fits all frames best, on landmarks (n, 3)."""
    seen_O = np.concatenate([transform_points(X, p_G) for X in inverse_pose(X_CO) @ X_CG])
    return fit_rigid(seen_O, np.tile(p_G, (len(X_CO), 1)))


def side_by_side(content: StoredRun, sequence: Path, k: int) -> Image.Image:
    """The photograph of a frame beside the mesh from the same camera."""
    if content.motion is None or content.tracks is None or content.surface is None:
        raise InputError(f"{content.name}: the picture needs a run with an estimate and a surface")
    images = open_sequence(sequence)
    rectifier = make_rectifier(images.calibration)
    pair = rectified_pair(images, rectifier, k)
    height, width = pair.left.shape
    crop = square_around(target_crop(pair.mask_left, margin_px=10) or Crop(0, 0, width, height))
    panels = [_photograph(pair.left, crop), surface_panel(content, k, rectifier.rig, crop)]
    titles = ("photograph, left camera", "reconstructed surface, same view")
    sheet = Image.new("RGB", (2 * SIDE_PX + 3 * GAP_PX, SIDE_PX + 2 * GAP_PX + 24), PAPER)
    draw = ImageDraw.Draw(sheet)
    for column, (panel, title) in enumerate(zip(panels, titles, strict=True)):
        left = GAP_PX + column * (SIDE_PX + GAP_PX)
        small = cv2.resize(panel, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA)
        sheet.paste(Image.fromarray(small), (left, GAP_PX))
        draw.text((left + 2, SIDE_PX + GAP_PX + 8), title, INK, ImageFont.load_default(19))
    return sheet


def _photograph(left: Picture, crop: Crop) -> Picture:
    pad = max(0, -crop.u0, -crop.v0, crop.u1 - left.shape[1], crop.v1 - left.shape[0])
    padded = cv2.copyMakeBorder(left, pad, pad, pad, pad, cv2.BORDER_CONSTANT)
    patch = padded[crop.v0 + pad : crop.v1 + pad, crop.u0 + pad : crop.u1 + pad]
    return np.asarray(cv2.cvtColor(patch, cv2.COLOR_GRAY2RGB), dtype=np.uint8)


if __name__ == "__main__":
    command(main)
