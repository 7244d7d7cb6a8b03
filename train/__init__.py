"""Data, losses and loop of the weights that the front end ships. Nothing is trained yet: all methods are classical."""
