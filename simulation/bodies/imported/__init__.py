"""Bodies from mesh files. In: a file and the length of its unit. Out: parts in G.

mesh_file.py  parts with materials and charts
colours.py    colours and gloss that the file states
reading.py    named pieces of an OBJ, STL, PLY or GLB
"""
