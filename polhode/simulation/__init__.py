"""Simulated datasets with truth. In: the scene of a configuration. Out: a dataset on disk.

dataset/          plan of a scene, its frames, truth of every pixel, the dataset on disk
monte_carlo.py    stereo measurements of landmarks without images
sky.py            Earth, stars or a wall behind the target
rendering/        rays, light, reflection: one image
motion/           target and inspector over time
bodies/           the target's shape, textures and mass
stereo_camera.py  the stereo rig and its sensor
surface/          materials and solid noise
"""

from polhode.simulation.dataset.sequence import simulate

__all__ = ["simulate"]
