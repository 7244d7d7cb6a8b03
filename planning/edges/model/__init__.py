"""Edges of a mesh, and which of them a camera sees.

In: a mesh in G, a camera, a pose. Out: control points on the visible edges.

    edge_model       creases and rims as straight segments, smooth parts
    chains           edges joined into chains, chains cut into straight pieces
    measured_edges   the edge model of a run's mesh, simplified as far as its errors allow
    outlines         where smooth parts turn away from the viewer
    visible_edges    control points, and those separated from other edges
    edge_contrast    contrast of the edges in sunlight
    rays             occlusion by the body
"""
