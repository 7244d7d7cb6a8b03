"""Observability by rank: lie_rank; ``polhode compare`` compares the optimizers."""
