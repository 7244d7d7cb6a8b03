"""The precision in which networks multiply on this processor."""

from functools import cache

import torch


@cache
def multiplies_in_bfloat16() -> bool:
    """Whether the processor has matrix instructions for bfloat16, which take half the time."""
    # not public, and missing in older versions of torch, which then multiply in 32 bits
    supported = getattr(torch.cpu, "_is_amx_tile_supported", None)
    return bool(torch.backends.mkldnn.is_available() and supported is not None and supported())
