"""Pictures of a run and of what follows from it. They illustrate; no result depends on them.

In: tracks, estimate and surface. Out: images, which polhode/pipeline/write_results.py writes into
RUN/pictures.

- mask_strip: outlines of masks that were found before a background that is not dark
- body_views: the mesh from all sides; the directions of view, shared with the pictures of a plan
- model_comparison: the mesh beside the images, frame by frame, as MP4 and GIF
"""
