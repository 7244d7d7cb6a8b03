"""The keep-out volume over independent draws: keepout."""
