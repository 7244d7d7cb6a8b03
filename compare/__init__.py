"""The same measurements, the same cost, through many optimizers (docs/compare.md)."""
