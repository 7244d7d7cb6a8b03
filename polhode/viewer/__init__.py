"""A run, a sequence or a stream in the viewer Rerun (rerun.io): images, tracks, motion, mesh and plots.

In: a run directory, the folder of a sequence, or the pairs of a stream. Out: a recording of Rerun (.rrd), or
data in the window of its viewer. All three show their frames through one ``Recorder``. Truth is never read.

- show_run: a finished run, with the images of its sequence where they are given; a sequence as recorded
- show_live: the pairs of ``polhode run --live`` as their states come
- target: the file or window that a user asked for, checked before any work
- recorder: what is shown of a frame, and how it and surface and body are logged
- blueprint: how the views are arranged
"""
