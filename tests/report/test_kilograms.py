"""Kilograms, unknown pushes and assumptions: in summary.json, pushes.csv and the report, each by its name."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from polhode.config.backend_settings import Backend
from polhode.pipeline.uniform_density import assumed_properties
from polhode.records.estimate import Disturbances, Impulse
from polhode.report import finish_run
from polhode.report.tables import inertia_rows
from polhode.run_directory.outputs import write_estimate
from polhode.run_directory.summary import build_summary
from polhode.run_directory.summary_schema import ShapeFindings


def test_what_is_known_in_kilograms_and_what_is_assumed_stand_apart(example: Any, tmp_path: Path) -> None:
    mass = replace(
        example.estimate.mass, mass_kg=4.56, sigma_mass_kg=0.07,
        inertia_scale_kg_m2=0.0234, sigma_inertia_scale_kg_m2=np.inf,
    )  # fmt: skip
    first_ns = int(example.estimate.timestamps_ns[0])
    push = Impulse(
        first_ns + 2 * 10**9, first_ns + 3 * 10**9, np.array([0.0, -0.004, 0.003]), np.full(3, 1e-4),
        np.array([0.1, 0.0, 0.2]), np.full(3, np.inf),
    )  # fmt: skip
    step = np.zeros((1, 3))
    steps = np.array([push.start_ns]), np.array([push.end_ns])
    disturbances = Disturbances(*steps, step, step + 0.1, step, step + 0.1, (push,))
    estimate = replace(example.estimate, mass=mass, disturbances=disturbances)
    assumed, _ = assumed_properties(mass, example.surface, Backend(mass_kg=4.5))
    write_estimate(tmp_path, example.tracks, estimate)
    summary = build_summary(
        example.tracks, estimate, example.surface, {}, shape=ShapeFindings(assumed=assumed)
    )
    finish_run(tmp_path, summary)

    content = json.loads((tmp_path / "summary.json").read_text())
    assert content["inertia"]["mass_kg"] == 4.56 and content["inertia"]["sigma_scale_kg_m2"] is None
    assert content["assumed"]["mass_kg"] == 4.5
    (pulse,) = content["unknown_pushes"]
    assert (pulse["start_s"], pulse["end_s"]) == (2.0, 3.0)
    assert pulse["sigma_delta_w_P"] == [None, None, None]
    page = (tmp_path / "report.html").read_text()
    for words in (
        "In kilograms, from known",
        "4.560 ± 0.070",
        "Unknown forces and torques",
        "Assumed, not estimated",
    ):
        assert words in page
    assert (tmp_path / "pushes.csv").is_file()
    # a later round without pushes leaves no table of an earlier one
    write_estimate(tmp_path, example.tracks, example.estimate)
    assert not (tmp_path / "pushes.csv").exists()


def test_the_moments_have_the_sigmas_of_the_ratios(example: Any) -> None:
    summary = build_summary(example.tracks, example.estimate, example.surface, {})
    assert summary.inertia is not None
    given = {"moments": [1.5, 1.0, 0.8], "sigma_moments": [0.03, 0.0, 0.04]}
    inertia = summary.inertia.model_copy(update=given)
    (row,) = (r for r in inertia_rows(summary.model_copy(update={"inertia": inertia})) if "moments" in r.name)
    assert row.value == "1.500 ± 0.030 : 1 (exact) : 0.800 ± 0.040"
    unknown = inertia.model_copy(update={"sigma_moments": [None, 0.0, 0.04]})
    (row,) = (r for r in inertia_rows(summary.model_copy(update={"inertia": unknown})) if "moments" in r.name)
    assert row.value == "1.5 : 1 (exact) : 0.800 ± 0.040"
