"""Points that another installation has computed count as computed, and name what they were made with."""

from pathlib import Path

import pytest
import yaml

from benchmarks import adopt
from polhode.progress import Silent
from polhode.studies import sweep as flow
from polhode.studies.cluster import ClusterOptions
from polhode.studies.study import open_study
from polhode.studies.table import read_table

Capture = pytest.CaptureFixture[str]


def write(path: Path, seeds: list[int], **base: object) -> Path:
    path.write_text(yaml.safe_dump({"base": base, "axes": {"seed": seeds}, "steps": []}))
    return path


@pytest.mark.usefixtures("sweep_here")
def test_only_what_no_machine_has_computed_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    part = open_study(write(tmp_path / "part.yaml", [1, 3]))
    with monkeypatch.context() as patch:
        for module in ("steps", "study", "sweep"):
            patch.setattr(f"polhode.studies.{module}.code_digest", lambda: "other")
        flow.sweep(part, tmp_path / "other", Silent(), ClusterOptions())
    whole = write(tmp_path / "study.yaml", [1, 2, 3])
    adopt.main(whole, (tmp_path / "other",), tmp_path / "whole")
    assert "2 points of" in (said := capsys.readouterr().out) and "1 of 3 points are missing" in said
    swept = flow.sweep(open_study(whole), tmp_path / "whole", Silent(), ClusterOptions())
    assert (swept.points, swept.stored) == (3, 2)
    table = read_table(tmp_path / "whole").to_pydict()
    assert table["seed"] == [1, 2, 3]
    assert [each == "other" for each in table["digest.code"]] == [True, False, True]


@pytest.mark.usefixtures("sweep_here")
def test_a_study_of_other_settings_is_refused(tmp_path: Path) -> None:
    other = open_study(write(tmp_path / "part.yaml", [1], backend={"accel_psd": 1e-3}))
    flow.sweep(other, tmp_path / "other", Silent(), ClusterOptions())
    with pytest.raises(SystemExit, match="another base"):
        adopt.main(write(tmp_path / "study.yaml", [1]), (tmp_path / "other",), tmp_path / "whole")
    with pytest.raises(SystemExit, match=r"study\.yaml is missing"):
        adopt.main(write(tmp_path / "study.yaml", [1]), (tmp_path / "none",), tmp_path / "whole")
    assert not (tmp_path / "whole").exists()
