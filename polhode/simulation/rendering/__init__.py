"""One image. In: body, light, camera and poses. Out: light and coverage of every pixel, before the lens.

render.py      rays, hits, light, and the mean over the samples of a pixel
raycast.py     rays against the body
appearance.py  what light meets at a hit: charts, colours, materials
shading.py     light from Sun, Earth and lamp, and specular reflections that are traced
indirect.py    light by way of the body itself, gathered at probes
probes.py      points on the surface, what they see in every direction, interpolation between them
reflection.py  diffuse and GGX reflection
light.py       Sun, Earth and lamp at one moment
sampling.py    patterns of directions and of points on discs
"""
