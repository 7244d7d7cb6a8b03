"""The report of a run: one HTML file that needs no network and no other file."""

import json
import logging
import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from polhode.files.atomic import write_all, write_text
from polhode.files.output.locks import at_work
from polhode.files.output.place import begins_with, require_writable
from polhode.files.output.run_files import SUMMARY
from polhode.files.output.single_file import make_parent, output_file, remove_all_partials
from polhode.geometry.lie import Array
from polhode.report import tables
from polhode.report.convergence_figures import convergence_figures
from polhode.report.evaluation import Metrics, evaluate
from polhode.report.motion_figures import motion_figures
from polhode.report.page_pictures import (
    MAX_FILM_BYTES,
    SHEETS,
    EmbeddedPicture,
    embed_pictures,
    film_frames,
)
from polhode.report.page_size import PAGE_BYTES, figures_within
from polhode.report.polhode_and_inertia_figures import rotation_figures
from polhode.report.residual_figures import measurement_figures
from polhode.report.shape_figures import cameras_in_target, shape_figures
from polhode.report.template import deflated, figure_text, fill, json_text
from polhode.run_directory.own_results import METRICS, OF_SUMMARY, summary_digest
from polhode.run_directory.run_folder import require_run_folder
from polhode.run_directory.stored_run import StoredRun, read_stored_run
from polhode.run_directory.summary import with_files, write_summary
from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.verdict import lower_status
from polhode.runtime.errors import InputError, printable

_log = logging.getLogger(__name__)

REPORT = "report.html"
OVERVIEW = ("polhode", "mesh")
"""Figures that stand beside the film, where the slider moves all of them."""


def page_file(path: Path, folders: Sequence[Path]) -> Path:
    """Where a page about runs goes, links followed; checked before the work. Raises InputError.

    report.html of a run may be written again by the report of that run alone.
    """
    own = Path(os.path.realpath(folders[0] / REPORT))
    is_run = len(folders) == 1 and (folders[0] / SUMMARY).is_file()
    if is_run and not own.is_dir() and own == Path(os.path.realpath(path)):
        require_writable(own.parent, path)
        return own
    mark = '<meta name="generator" content="polhode report">'
    return output_file(path, "report", REPORT, lambda path: begins_with(path, mark))


def write_report(folder: Path, path: Path | None = None, name: str | None = None) -> None:
    """Write the report of the run in ``folder`` to ``path``, RUN/report.html unless given.

    Made from the stored files alone, so it can be written again at any time. ``name`` is the run's name on
    the page, by default the folder's. Raises InputError when the folder is not a run.
    """
    require_run_folder(folder)
    content = read_stored_run(folder, name or run_name(folder))
    page = render(content)
    if path is not None:
        make_parent(path, path)
    write_text(path or folder / REPORT, page)


def write_evaluation(folder: Path, metrics: dict[str, Any]) -> None:
    """Write metrics.json, and the report that contains it: both or, where the report cannot be made, neither.

    Raises InputError and RunFailure.
    """
    stored = {**metrics, OF_SUMMARY: summary_digest(folder)}
    page = render(read_stored_run(folder, run_name(folder), metrics))
    text = json.dumps(stored, indent=2, allow_nan=False) + "\n"
    write_all({folder / METRICS: text.encode(), folder / REPORT: page.encode()})


def evaluate_and_report(folder: Path, sequence_folder: Path) -> Metrics:
    """Compare a run with the truth of its sequence; write metrics.json and the report. Returns the metrics.

    Raises InputError: no run, no truth, another sequence, or the run cannot be written.
    """
    require_run_folder(folder)
    require_writable(folder, folder, "make the run writable, or evaluate a copy of it")
    with at_work(folder, folder):
        remove_all_partials(folder)
        metrics = evaluate(folder, sequence_folder)
        write_evaluation(folder, metrics)
    return metrics


def finish_run(folder: Path, summary: Summary) -> Summary:
    """Write summary.json and report.html. Returns the summary, with the time that the report took."""
    write_summary(summary, folder / "summary.json")
    start = perf_counter()
    try:
        write_report(folder)
    except InputError as error:
        # The results stand even without their page, which is made from them; but something in them is odd.
        _log.warning("no report: %s", error)
        status = "degraded" if summary.status == "ok" else summary.status
        summary = lower_status(summary, status, f"no report: {error}")
    seconds = perf_counter() - start
    times = summary.timing_s
    timing = times.model_copy(update={"report": times.report + seconds, "total": times.total + seconds})
    timed = with_files(summary.model_copy(update={"timing_s": timing}), folder)
    write_summary(timed, folder / "summary.json")
    return timed


def render(content: StoredRun) -> str:
    """The whole page, of at most ``PAGE_BYTES``: what figures and words leave is for the pictures."""
    summary, motion, metrics = content.summary, content.motion, content.metrics
    no_estimate = "The run did not reach an estimate of the"
    parts = [
        ("Motion", motion_figures(content), f"{no_estimate} motion."),
        ("Rotation and inertia", rotation_figures(content), f"{no_estimate} inertia."),
        ("Convergence", convergence_figures(content), "The run has no causal estimate."),
        ("Measurements", measurement_figures(content), "The run did not reach measurements."),
        ("Shape", shape_figures(content), "The run has neither a map nor a surface."),
    ]
    figures = figures_within([each for _, figures, _ in parts for each in figures], figure_text)
    drawn = {each.key: each for each in figures}
    date = data_date(content)
    values: dict[str, Any] = {
        "title": content.name,
        "name": content.name,
        "data_date": date,
        "head": f"polhode, run {content.name}, {f'data of {date}' if date else 'data without a date'}",
        "finding": tables.finding(summary, motion.trajectory if motion else None),
        "summary": summary,
        "checks": tables.check_rows(summary),
        "assumed_rows": tables.assumed_rows(summary.assumed),
        "motion_rows": tables.motion_rows(content),
        "sigma_rows": tables.sigma_rows(content),
        "run_rows": tables.run_rows(content),
        "metric_rows": tables.metric_rows(metrics),
        "overview": [each for each in figures if each.key in OVERVIEW],
        "sections": [
            (title, [drawn[each.key] for each in found if each.key not in OVERVIEW], words)
            for title, found, words in parts
        ],
        "sunlit": content.film is not None and content.film.sunlit,
        "has_surface": content.surface is not None,
        "config_text": content.config_text,
    }
    for of_summary in (
        tables.inertia_rows, tables.intervals_rest_on, tables.absolute_rows, tables.disturbance_rows,
        tables.mesh_rows, tables.mesh_sentences, tables.timing_rows,
    ):  # fmt: skip
        values[of_summary.__name__] = of_summary(summary)

    def page(film: Sequence[EmbeddedPicture], pictures: Sequence[EmbeddedPicture]) -> str:
        line = timeline(content, film)
        return fill(
            "report.html.j2",
            film=film,
            film_uris=json_text([each.uri for each in film]),
            timeline_text=deflated(json.dumps(line, separators=(",", ":"))) if line else "",
            sheets=[each for each in pictures if each.name in SHEETS],
            stills=[each for each in pictures if each.name.startswith("model")],
            masks=[each for each in pictures if each.name == "masks.jpg"],
            pictures=[each for each in pictures if each.name[0].isdigit()],
            **values,
        )

    # 8 kB for headings and captions of film and pictures; of what is left the film gets 42 %.
    left = PAGE_BYTES - 8_000 - len(page([], []).encode())
    film = film_frames(content.film, min(MAX_FILM_BYTES, round(0.42 * left)))
    left -= sum(len(each.uri) for each in [*film, *film[:1]])
    while True:
        # With longer captions the pictures are made again, smaller.
        whole = page(film, embed_pictures(content.pictures, left))
        excess = len(whole.encode()) - PAGE_BYTES
        if excess <= 0 or left <= 0:
            return whole
        left -= excess


def timeline(content: StoredRun, film: Sequence[EmbeddedPicture]) -> dict[str, Any] | None:
    """Stops of the page's slider, at most 600, as plain data; None without an estimate of two frames.

    time [s] since the first frame and frame number of each stop; picture: index of the nearest in time in
    ``film``; rate: angular velocity along P [deg/s]; eye and up: direction from the body to the left camera
    and direction that is up in its image, unit vectors in G (absent without measurements).
    """
    if content.motion is None or len(content.motion.trajectory.time_s) < 2:
        return None
    path = content.motion.trajectory
    count = len(path.time_s)
    stops = np.unique(np.linspace(0, count - 1, min(count, 600)).round().astype(int))
    out: dict[str, Any] = {
        "time": path.time_s[stops].round(3).tolist(),
        "frame": stops.tolist(),
        "frames": count,
        "rate": np.rad2deg(path.w_P[stops]).round(3).tolist(),
    }
    shown = np.array([each.frame for each in film if each.frame < count], dtype=np.int64)
    if len(shown):
        out["picture"] = np.abs(path.time_s[stops][:, None] - path.time_s[shown]).argmin(axis=1).tolist()
    views = camera_views(content)
    if views is not None:
        out["eye"], out["up"] = (each[stops].round(4).tolist() for each in views)
    return out


def camera_views(content: StoredRun) -> tuple[Array, Array] | None:
    """Directions (F, 3) in G: from the centre of mass to the left camera, and up in its image."""
    X_GR = cameras_in_target(content)
    if X_GR is None or content.motion is None:
        return None
    away = X_GR[:, :3, 3] - content.motion.com_G
    # Rows of an image count downwards.
    return away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12), -X_GR[:, :3, 1]


def data_date(content: StoredRun) -> str:
    """The day of the first frame (UTC); empty where the timestamps, being before 2000, are no dates."""
    if content.tracks is None or content.tracks.timestamps_ns[0] < 946_684_800 * 10**9:
        return ""
    return f"{datetime.fromtimestamp(int(content.tracks.timestamps_ns[0]) // 10**9, UTC):%d %B %Y}"


def run_name(folder: Path) -> str:
    """The run's name, as a text, also while it is being written into a hidden folder beside its final one."""
    return printable(re.sub(r"^\.(.+)\.partial(-\w+)?$", r"\1", folder.resolve().name))
