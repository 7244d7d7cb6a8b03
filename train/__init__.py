"""Data, losses and loop of the weights that the front end ships; nothing is trained yet."""
