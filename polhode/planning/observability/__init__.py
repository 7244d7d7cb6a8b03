"""``polhode observability``: the edge metric along a camera trajectory, as tables and pictures.

In: a run or a mesh, and a trajectory. Out: observability.json and .csv, edges.csv, pictures.

- assess: edges, camera and poses from a run or from files; metric of every view, contributions, selection
- files, pictures: output files and screen output
"""
