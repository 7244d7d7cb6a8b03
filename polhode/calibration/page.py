"""What ``polhode calibrate`` writes: calibration.json, the calibration in each format, and report.html; the
folder is checked before the work and written whole."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polhode.calibration.adjustment import CornerData, epipolar_errors
from polhode.calibration.calibrate import CalibratedRig
from polhode.calibration.formats import FORMAT_FILES, calibration_files
from polhode.calibration.image_pairs import SIDES
from polhode.calibration.result import CalibrationResult, Parameter, result_of
from polhode.files.output.marked_folder import claim, marked_folder, read_mark, write_files
from polhode.files.output.single_file import make_parent
from polhode.geometry.lie import Array
from polhode.report.plot_style import AXIS_COLORS, FAINT, Figure, Trace, axis, color_bar, layout, packed
from polhode.report.template import fill
from polhode.run_directory.summary_schema import json_text
from polhode.runtime.errors import InputError, printable

COMMAND = "calibrate"
"""In the mark of the folder."""
PAGE, RESULT = "report.html", "calibration.json"
FILES = (*FORMAT_FILES, RESULT, PAGE)
"""All that the command may ever write, some below folders"""
TITLES = {
    "cam0": "Left camera",
    "cam1": "Right camera",
    "cam1_from_cam0": "From the left into the right camera",
    "rig": "Rig",
}
MODEL_WORDS = {
    "brown5": "pinhole, Brown's distortion with 5 coefficients",
    "brown8": "pinhole, Brown's rational distortion with 8 coefficients",
    "fisheye": "equidistant fisheye",
}


@contextmanager
def results_folder(path: Path) -> Iterator[Path]:
    """The folder, links followed, locked until the block ends. Raises InputError for one that is not ours."""
    with marked_folder(path, COMMAND, FILES.__contains__) as place:
        own = (read_mark(place) or {}).get(COMMAND, ())
        for target in (place / name for name in FILES if "/" in name):
            name = target.relative_to(place).as_posix()
            if target.parent.is_symlink() or (target.exists() and name not in own):
                raise InputError(
                    f"{path}: {name} was not written by polhode {COMMAND}; choose another folder"
                )
        yield place


def write_results(place: Path, files: Mapping[str, bytes]) -> None:
    """All files, or none. Raises RunFailure."""
    claim(place, COMMAND, list(files))
    for name in files:
        make_parent(place / name, place)
    write_files(place, COMMAND, files, FILES.__contains__)


def files_of(rig: CalibratedRig, name: str) -> dict[str, bytes]:
    """All files of a calibration, by their names."""
    result = result_of(rig)
    sizes = (rig.views.size_px(0), rig.views.size_px(1))
    return {
        **calibration_files(rig.state, sizes, rig.adjusted.covariance),
        RESULT: json_text(result).encode(),
        PAGE: _render(rig, result, name).encode(),
    }


def format_calibration(rig: CalibratedRig) -> str:
    """What the screen shows: images that are left out, residuals, warnings."""
    result = result_of(rig)
    lines = [f"left out  {each.file}: {each.reason}" for each in result.rejected]
    lines += [f"warning  {each}" for each in result.warnings]
    rms = result.rms_px
    baseline = result.parameters["rig"]["baseline"]
    lines.append(
        f"{result.pairs} pairs, {len(result.used)} images used, {len(result.rejected)} left out; residuals "
        f"{rms.cam0:.3f} px (left alone), {rms.cam1:.3f} px (right alone), {rms.stereo:.3f} px (together); "
        f"epipolar error {result.epipolar_rms_px:.3f} px; baseline {1e3 * baseline.value:.3f} mm "
        f"(sigma {1e3 * baseline.sigma:.3f})"
    )
    return "\n".join(lines)


def _render(rig: CalibratedRig, result: CalibrationResult, name: str) -> str:
    """The whole page."""
    data, residuals = rig.data, rig.adjusted.residuals
    sizes = (rig.views.size_px(0), rig.views.size_px(1))
    sections = {
        "Residuals": [_residual_figure(data[c], residuals[c], sizes[c], c) for c in (0, 1)],
        "Epipolar error": [_epipolar_figure(*epipolar_errors(rig.state, data), sizes[1])],
        "Coverage": [_coverage_figure(data[c], sizes[c], c) for c in (0, 1)],
    }
    groups = [
        (TITLES[group], [_row(key, each) for key, each in own.items()])
        for group, own in result.parameters.items()
    ]
    return fill(
        "calibration.html.j2",
        title=f"Calibration of {printable(name)}",
        name=printable(name),
        result=result,
        board=rig.views.board.words,
        models=[MODEL_WORDS[each.model] for each in result.cameras],
        groups=groups,
        sections=sections.items(),
    )


def _row(name: str, each: Parameter) -> dict[str, str]:
    # two digits of the standard deviation
    exponent = int(f"{each.sigma:e}".partition("e")[2]) if each.sigma > 0.0 else 1
    value = f"{each.value:.{max(0, min(12, 1 - exponent))}f}"
    return {"name": name, "value": value, "sigma": f"{each.sigma:.2g}", "unit": each.unit}


def _residual_figure(data: CornerData, residuals: Array, size_px: tuple[int, int], camera: int) -> Figure:
    """Residuals as arrows over the image; the usual one has 0.02 of the image's width."""
    usual = float(np.median(np.linalg.norm(residuals, axis=1)))
    scale = float(f"{0.02 * size_px[0] / max(usual, 1e-6):.1g}")
    gap = np.full(residuals.shape, np.nan)
    path = np.stack([data.uv_px, data.uv_px + scale * residuals, gap], axis=1).reshape(-1, 2)
    color = (AXIS_COLORS[2], AXIS_COLORS[0])[camera]
    arrows = _trace("scattergl", *path.T, mode="lines", line={"color": color, "width": 1.1}, hoverinfo="skip")
    words = [f"{u:+.2f}, {v:+.2f} px" for u, v in residuals.tolist()]
    marker = {"color": color, "size": 3}
    heads = _trace("scattergl", *data.uv_px.T, mode="markers", marker=marker, text=words, hoverinfo="text")
    return _over_image(
        f"residuals-{camera}",
        f"Residuals of the {SIDES[camera]} camera",
        f"Measured minus projected corners of all used images, {scale:g} times enlarged. Arrows of "
        "all directions side by side are noise; arrows that agree with their neighbours are a lens that the "
        "model does not describe, or a board that is not flat.",
        [arrows, heads],
        size_px,
    )


def _epipolar_figure(right_px: Array, error_px: Array, size_px: tuple[int, int]) -> Figure:
    """Epipolar errors over the right image."""
    rms, mean = float(np.sqrt(np.nanmean(error_px**2))), float(np.nanmean(error_px))
    limit = max(3.0 * rms, 1e-3)
    marker = {
        "color": packed(error_px),
        "colorscale": [[0.0, "#0072b2"], [0.5, "#e8ecf0"], [1.0, "#d55e00"]],
        "cmin": -limit,
        "cmax": limit,
        "size": 5,
        "line": {"color": FAINT, "width": 0.3},
        "colorbar": color_bar("px"),
    }
    return _over_image(
        "epipolar-map",
        "Epipolar error over the right image",
        f"Distance of each corner in the right image from the epipolar line of the same corner in the left "
        f"one; {rms:.3f} px rms, {mean:+.3f} px in the mean. Stereo matching looks along these lines.",
        [_trace("scattergl", *right_px.T, mode="markers", marker=marker)],
        size_px,
    )


def _coverage_figure(data: CornerData, size_px: tuple[int, int], camera: int) -> Figure:
    """How many corners each part of the image has."""
    u, v = (np.linspace(0.0, side, 1 + max(1, round(16 * side / max(size_px)))) for side in size_px)
    count, *_ = np.histogram2d(data.uv_px[:, 0], data.uv_px[:, 1], (u, v))
    heat = _trace(
        "heatmap",
        0.5 * (u[1:] + u[:-1]),
        0.5 * (v[1:] + v[:-1]),
        z=packed(count.T, "i4"),
        colorscale=[[0.0, "#f7f9fb"], [0.15, "#cfe1f2"], [1.0, "#1f5a92"]],
        colorbar=color_bar("corners"),
        zmin=0,
    )
    return _over_image(
        f"coverage-{camera}",
        f"Coverage of the {SIDES[camera]} image",
        f"Corners in each part of the image; {100 * (count == 0).mean():.0f} % of the parts have none. Where "
        "there are none, the distortion is extrapolated.",
        [heat],
        size_px,
    )


def _trace(kind: str, x: ArrayLike, y: ArrayLike, **more: Any) -> Trace:
    return {"type": kind, "x": packed(x), "y": packed(y), "showlegend": False, **more}


def _over_image(key: str, title: str, caption: str, traces: list[Trace], size_px: tuple[int, int]) -> Figure:
    width, height = size_px
    drawing = layout(
        xaxis=axis("u [px]", range=[0, width], showgrid=False),
        yaxis=axis("v [px]", range=[height, 0], scaleanchor="x", constrain="domain", showgrid=False),
    )
    return Figure(key, title, caption, traces, drawing, height_px=460, wide=False)
