"""The precision follows from what torch says of the processor."""

import pytest
import torch

from polhode.frontend.networks.precision import multiplies_in_bfloat16


@pytest.mark.parametrize(("amx", "avx512", "expected"), [(0, 0, False), (1, 0, True), (0, 1, True)])
def test_either_kind_of_instructions_is_enough(
    amx: int, avx512: int, expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: bool(amx), raising=False)
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: bool(avx512), raising=False)
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: True)
    assert multiplies_in_bfloat16.__wrapped__() is expected


def test_a_torch_that_cannot_say_multiplies_in_32_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_is_amx_tile_supported", "_is_avx512_bf16_supported"):
        monkeypatch.delattr(torch.cpu, name, raising=False)
    assert multiplies_in_bfloat16.__wrapped__() is False
