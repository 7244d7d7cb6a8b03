"""The precision in which networks multiply on this processor."""

from functools import cache

import torch

_INSTRUCTIONS = ("_is_amx_tile_supported", "_is_avx512_bf16_supported")
"""Questions of ``torch.cpu`` about instructions for bfloat16: of matrices (AMX) and of vectors (AVX-512)."""


@cache
def multiplies_in_bfloat16() -> bool:
    """Whether the processor has instructions for bfloat16, with which networks take half the time."""
    # not public, and missing in older versions of torch, which then multiply in 32 bits
    supported = (getattr(torch.cpu, name, None) for name in _INSTRUCTIONS)
    return bool(torch.backends.mkldnn.is_available() and any(ask is not None and ask() for ask in supported))
