"""Textures as charts on parts. In: meshes and random numbers. Out: charts of reflectance and relief.

part_builder.py  parts with charts, and the choice of the texture generator
canvas.py        a sheet to draw on, and how it is laid onto a surface
drawn.py         the first texture generator; its lettering, stickers, rivets and scratches: drawn_marks.py
collage.py       the second generator; the two share nothing
"""
