"""The names of a run's own files (docs/run_directory.md). Nothing under another name is removed with it."""

import re

SUMMARY = "summary.json"
LATER: tuple[str, ...] = (SUMMARY, "config.yaml", "log.txt", "report.html", "metrics.json")
"""Of every run, whether or not its list of files has them: some are written after it."""
PICTURES = "pictures"
STAGES = "stages"
"""Folder of the results of finished stages"""
SCHEMA = "polhode-summary/"
"""At the beginning of every summary."""

_FILE = re.compile(
    r"summary\.json|config\.yaml|log\.txt|report\.html|metrics\.json|trajectory(_online)?\.csv"
    r"|(pushes|live_states)\.csv|(covariance|measurements|online|hypotheses|occupancy)\.npz"
    r"|landmarks\.ply|mesh\.(ply|glb)|mesh_lod\d+\.glb"
    r"|pictures/(captions\.json|\d+\.(jpg|png)|(landmarks|mesh)\.png|masks\.jpg|model\.(mp4|gif|csv)|model_\d+\.jpg)"
)
_STAGE_FILE = re.compile(r"stages/(recording\.json|(earlier/)?(recording\.json|\w+/[0-9a-f]+\.npz))")
_PARTIAL = re.compile(
    r"(?P<folder>(pictures/|stages/((earlier|\w+)/)?)?)\.(?P<stem>[^/]+)\.partial-\d+(?P<suffix>\.\w+)"
)


def is_run_file(name: str) -> bool:
    """Whether a run writes a file of this name, relative to its folder, with "/"."""
    partial = _PARTIAL.fullmatch(name)
    if partial is not None:
        name = partial["folder"] + partial["stem"] + partial["suffix"]
    return _FILE.fullmatch(name) is not None or _STAGE_FILE.fullmatch(name) is not None


def is_stage_file(name: str) -> bool:
    """Whether a run keeps the result of a stage, or what these are of, under this name."""
    return name.startswith(f"{STAGES}/") and is_run_file(name)
