"""How long and how fast a network learns; the same for every task."""

from typing import Literal

from pydantic import Field

from polhode.config.scene.values import NonNegative, Positive
from polhode.config.section import Section


class Schedule(Section):
    """AdamW with a warm-up, then a cosine down to nothing."""

    steps: int = Field(5000, ge=1)
    """Number of steps; the learning rate reaches zero there."""
    learning_rate: Positive = 2e-3
    """Largest learning rate."""
    warmup_steps: int = Field(100, ge=0)
    """Steps over which the learning rate grows from zero."""
    weight_decay: NonNegative = 1e-2
    """AdamW's decay of weights."""
    clip_norm: Positive = 1.0
    """Longest gradient; a longer one is scaled down."""
    time_limit_s: Positive | None = None
    """Stop after so much time in this call [s], with a checkpoint; the same command goes on from there."""
    checkpoint_every: int = Field(250, ge=1)
    """Steps between checkpoints."""
    validate_every: int = Field(500, ge=1)
    """Steps between validations on the held-out bodies."""
    log_every: int = Field(20, ge=1)
    """Steps between points of the curves."""
    device: Literal["automatic", "cpu", "cuda"] = "automatic"
    """Where the network runs; automatic: a GPU where there is one."""
    precision: Literal["automatic", "full", "mixed"] = "automatic"
    """Mixed: products in 16 bits, sums in 32. Automatic: mixed on a GPU. On a CPU it is faster where the
    processor multiplies in bfloat16."""
    threads: int = Field(1, ge=1)
    """Threads of torch on the CPU. The weights' last bits depend on it."""
