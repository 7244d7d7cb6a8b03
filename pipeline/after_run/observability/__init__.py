"""``polhode observability``: the edge metric along a camera trajectory, as tables and pictures.

In: a run or a mesh, and a trajectory. Out: observability.json and .csv, edges.csv, coloured edges, pictures.

- subject: edges, camera and poses, from a run or from files
- assess: the metric of every view, the contribution of every edge, the selection of edges
- files, pictures: output files and screen output
"""
