"""A run, a sequence or a stream in the viewer Rerun (rerun.io): images, tracks, motion, mesh and plots.

In: a run directory, the folder of a sequence, or the pairs of a stream. Out: a recording of Rerun (.rrd), or
data in the window of its viewer. All three show their frames through one ``Recorder``. Truth is never read.

- show_run: a finished run, with the images of its sequence where they are given
- show_sequence: images, masks, rig and poses of the inspector, as recorded
- show_live: the pairs of ``polhode run --live`` as their states come
- target: the file or window that a user asked for, checked before any work
- recorder: what is logged of a frame, a surface and a body
- shown_frame: what is shown of a frame
- mesh_growth: the mesh for a viewer, and which of its faces have been seen up to each frame
- blueprint: how the views are arranged
"""
