"""From images to results: the whole program on simulated scenes.

In: configurations of scenes. Out: errors, consistency of covariances, predictions, the picture of README.md.

    scenes             simulate, run and evaluate every scene
    range_images       a stereo sequence against the same with ranges instead of the right images
    photographs        a real object with known motion
    prediction_error   a prediction against what came after it
    readme_picture     the picture of README.md
    report_page        what a report costs its reader
    report_picture     a part of a report as a picture
"""
