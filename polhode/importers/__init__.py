"""Recordings of others become datasets on disk (docs/import.md).

In: folders of images, ROS 1 and ROS 2 bags, videos, EuRoC and KITTI folders, with a calibration in the format
of many programs (docs/formats.md). Out: a dataset in the layout of docs/dataset.md, whole or not at all.

- import_sequence: the flow, from the source to the published dataset
- options: what the user chose
- times: times in tables and names of files, and their unit
- understood: the table of what was understood of a recording
- pairs: which images are imported: pairs by time, the part and the steps that the user wants
- image_writing: images into the dataset, as they are or cropped
- imported_dataset: the hidden folder that is written into, resumed and published
- sources/: what is recorded, one kind of recording a file
- calibrations/: the calibration of the rig, one format a file
"""
