"""The renderer: agreement with Mitsuba, and time.

In: scenes of the simulator. Out: differences of images, seconds.

    against_mitsuba   differences of the images, of the same scene in both programs
    rendering_time    seconds per pair of images
"""
