"""From images to results: the whole program on simulated scenes.

In: configurations of scenes. Out: errors, consistency of covariances, predictions, the
pictures and tables of README.md.

    scenes             simulate, run and evaluate every scene
    range_images       a stereo sequence against the same with ranges instead of the right images
    photographs        a real object with known motion
    prediction_error   a prediction against what came after it
    report_page        what a report costs its reader
    report_picture     a part of a report as a picture
    readme_picture     one frame, the surface in the same view, and the polhode
    animation          the same for all frames of closed_tumble.yaml: the animation of README.md
    footprint          disk and memory that the program needs
    thesis             the replica of Test Session 38 beside the thesis's own results
    against_slam       beside COLMAP (colmap) and stereo odometry (orb_odometry), compared by found_poses
"""
