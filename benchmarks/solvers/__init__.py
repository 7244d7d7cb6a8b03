"""Observability, and the pose graph beside another program; ``polhode compare`` compares the optimizers.

lie_rank     rank test of observability by Lie derivatives
pose_graph   the pose graph of the cold start against GTSAM
"""
