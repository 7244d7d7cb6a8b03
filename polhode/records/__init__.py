"""What passes between the rooms, and the dataset on disk that it begins with.

- tracks: measurements with data association, from the front end to the back end
- estimate: motion, mass properties and sparse map; predictions
- surface: depth maps and the dense surface; surface_errors: errors of the surface and how they are correlated
- truth: the truth of a simulated sequence; read_truth reads it, which only the evaluation may import
- metrics, mesh_metrics: errors of an estimate against the truth, distances between meshes
- dataset: a stereo sequence on disk, without its truth; dataset_writer writes the same layout
- rig_calibration: the calibration of the rig, from sensor.yaml
- calibration_prior: how well it is known; calibration_effects: what its errors do to the measurements
- camera_folders: which folders of a sequence hold its two cameras, or its camera and ranges
- pairing: images of two cameras that belong together, by their timestamps
- range_images: range images in the place of a second camera: format and noise model
"""
