"""What a study will take, before it is computed: points, and sequences that are rendered once."""

from typing import Any

from polhode.config import Scene
from polhode.studies.study import OpenStudy, setting_of


def forecast(study: OpenStudy) -> dict[str, Any]:
    """Points, values of each factor, steps, sequences and their stereo pairs."""
    frames = setting_of(study.base, "scene.frames") or Scene().frames
    for factor in study.factors:
        if "scene.frames" in factor.settings:
            # variants whose scenes leave it out have the default
            levels = [each.get("scene.frames", frames) for each in factor.changes]
            frames = sum(levels) / len(levels)
    return {
        "points": study.count,
        "factors": {", ".join(factor.columns): len(factor) for factor in study.factors},
        "steps": study.settings.steps,
        "sequences": study.sequences,
        "pairs": round(study.sequences * frames),
    }


def format_forecast(found: dict[str, Any]) -> str:
    """The same as lines for people."""
    factors = " x ".join(f"{name} {count}" for name, count in found["factors"].items()) or "the base alone"
    lines = [
        f"points      {found['points']:,} ({factors})",
        f"each        {', '.join(found['steps']) or 'nothing: the table has the settings alone'}",
    ]
    if found["sequences"]:
        said = f"{found['sequences']:,} sequences, each once; {found['pairs']:,} stereo pairs"
        lines.append(f"rendered    {said}")
    return "\n".join(lines)
