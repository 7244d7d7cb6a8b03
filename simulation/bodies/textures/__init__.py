"""Textures as charts on parts. In: meshes and random numbers. Out: charts of reflectance and relief.

part_builder.py  parts with charts, and the choice of the texture generator
by_material.py   charts for parts of which only the material is known
canvas.py        a sheet to draw on, and how it is laid onto a surface
drawn/           the first texture generator
collage/         the second; the two share nothing
"""
