"""Training of the network that refines disparities."""

from polhode.config.section import Section


class DepthTraining(Section):
    """Crops of stereo pairs with their classical disparity and the true one."""
