"""The renderer: agreement with Mitsuba, and time.

In: scenes of the simulator. Out: differences of images, seconds.

    against_mitsuba   differences of the images
    mitsuba_scene     our bodies, camera and lights as a scene of Mitsuba
    rendering_time    seconds a pair of images
"""
