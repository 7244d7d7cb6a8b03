"""Initial motions without any guess: tracks and relative poses in, starting points for the solvers out.

- ``initialize``: initial poses from pose graph, bundle adjustment and interpolation.
- ``pose_graph``: one pose per frame from relative poses, by consensus and robust averaging.
- ``rates``: body rates from attitudes, in both directions where rotations are large, and by shooting;
  attitudes that jump.
- ``hypotheses``: which of several motions between two frames is the body's, where light hides it.
- ``multistart``: brief solves from several inertias and directions of rotation; gaps, by Euler's equation.
"""
