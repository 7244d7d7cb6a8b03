"""``polhode observability``: the edge metric along a camera trajectory, as tables and pictures.

In: a run or a mesh, and a trajectory. Out: observability.json and .csv, edges.csv, coloured edges, pictures.

- assess: edges, camera and poses from a run or from files; metric of every view, contributions, selection
- notes: descriptions of what is unobservable, doubtful or impossible
- files, pictures: output files and screen output
"""
