"""Pictures of a run and of what follows from it. They illustrate; no result depends on them.

In: the run's context, tracks, estimate and surface. Out: RUN/pictures, whose captions the report shows.

- run_pictures: makes all pictures of a run; tracks on the images
- mask_strip: outlines of masks that were found before a background that is not dark
- body_views: map and mesh from all sides; the directions of view, shared with the pictures of a plan
- model_comparison: the mesh beside the images, frame by frame, as MP4 and GIF
"""

from polhode.pipeline.pictures.run_pictures import make_pictures

__all__ = ["make_pictures"]
