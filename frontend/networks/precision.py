"""The precision in which networks multiply on this processor."""

from functools import cache

import torch


@cache
def multiplies_in_bfloat16() -> bool:
    """Whether the processor has matrix instructions for bfloat16, which take half the time."""
    return bool(torch.backends.mkldnn.is_available() and torch.cpu._is_amx_tile_supported())
