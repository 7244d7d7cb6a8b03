"""Scores of weights on chosen sequences: the table, and what is no simulated sequence."""

from pathlib import Path

import pytest
import torch

from polhode.config.train_settings import Corpus
from polhode.frontend.networks.descriptor import DescriptorNet
from polhode.train.corpus import scene_folder
from polhode.train.descriptor.scores import main, table
from polhode.train.run import write_weights


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    path = tmp_path / "w.safetensors"
    write_weights(path, DescriptorNet(), {"task": "descriptor"})
    return path


def test_each_sequence_is_a_row(
    tiny_corpus: Corpus, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(scene_folder(tiny_corpus, 1)), "--weights", str(weights)])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("|")[1].strip() for line in lines] == ["sequence", "---", "0001", "mean"]
    shares = [float(cell) for cell in lines[2].split("|")[2:5]]
    assert all(0.0 < share < 1.0 for share in shares)


def test_means_leave_out_what_is_missing() -> None:
    text = table({"a": {"rank_1_at_30": 0.4, "rank_1_at_60": 0.2}, "b": {"rank_1_at_30": 0.6}})
    cells = [cell.strip() for cell in text.splitlines()[-1].split("|")]
    assert cells[4] == "0.500"
    assert cells[7] == "0.200"


def test_a_folder_that_was_not_simulated_is_told(
    tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main([str(tmp_path), "--weights", str(weights)])
    assert stop.value.code == 2
    assert "contains no scene.yaml: give a sequence of polhode simulate" in capsys.readouterr().err
