"""The keep-out volume over independent draws, and against the true body: keepout."""
