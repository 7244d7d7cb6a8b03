"""Files of tensors from others: compared with what is expected before anything is read."""

import json
import struct
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from polhode.frontend.networks.descriptor import DescriptorNet
from polhode.frontend.networks.tensor_file import TensorFileError, read_tensors
from polhode.frontend.networks.weights import load_weights
from polhode.runtime.errors import InputError

EXPECTED = {"a": torch.zeros(2, 3), "n": torch.zeros((), dtype=torch.int64)}


def written(folder: Path, tensors: dict[str, Tensor]) -> Path:
    path = folder / "x.safetensors"
    save_file(tensors, path, metadata={"by": "someone"})
    return path


def test_tensors_and_header_are_read(tmp_path: Path) -> None:
    given = {"a": torch.arange(6.0).reshape(2, 3), "n": torch.tensor(5)}
    found, header = read_tensors(written(tmp_path, given), EXPECTED)
    assert all(torch.equal(found[name], given[name]) for name in given)
    assert header == {"by": "someone"}


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        (2 * 10**6, "2 tensors differ, the first is a: F32 500000, expected F32 2 x 3"),
        (16 * 10**12, "16,000 GB"),
    ],
)
def test_a_file_of_another_network_is_refused_unread(size: int, expected: str, tmp_path: Path) -> None:
    """The larger one has its bytes without a block on the disk."""
    header = json.dumps({"a": {"dtype": "F32", "shape": [size // 4], "data_offsets": [0, size]}}).encode()
    path = tmp_path / "large.safetensors"
    with path.open("wb") as stream:
        stream.write(struct.pack("<Q", len(header)) + header)
        stream.truncate(8 + len(header) + size)
    with pytest.raises(TensorFileError, match=rf"^another network \(.*{expected}"):
        read_tensors(path, EXPECTED)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x00" * 7,
        struct.pack("<Q", 2**62) + b"{}",
        struct.pack("<Q", 2) + b"[]",
        struct.pack("<Q", 4) + b"\xff\xfe{}",
        struct.pack("<Q", 66) + b'{"a": {"dtype": "F32", "shape": [2, 3], "data_offsets": [0, 240]}}',
        struct.pack("<Q", 65) + b'{"a": {"dtype": "F32", "shape": [2, 3], "data_offsets": [9, 0]}} ',
        struct.pack("<Q", 200_000) + b"[" * 200_000,
    ],
)
def test_what_is_no_safetensors_file_is_said_in_one_line(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x.safetensors"
    path.write_bytes(content)
    with pytest.raises(TensorFileError, match=r"^not a safetensors file \(.*\)$"):
        read_tensors(path, EXPECTED)


def test_names_with_line_feeds_stay_in_one_line(tmp_path: Path) -> None:
    path = written(tmp_path, {**EXPECTED, "x\ny" * 100: torch.zeros(1)})
    with pytest.raises(TensorFileError) as caught:
        read_tensors(path, EXPECTED)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 250


def test_weights_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    network = DescriptorNet()
    state = {name: value.contiguous() for name, value in network.state_dict().items()}
    state["project.bias"] = torch.full_like(state["project.bias"], torch.nan)
    with pytest.raises(
        InputError, match=r"x\.safetensors: project\.bias holds NaN or infinity; give weights"
    ):
        load_weights(network, written(tmp_path, state))
    with pytest.raises(InputError, match="this is a folder; give a file of weights"):
        load_weights(network, tmp_path)
