"""The renderer beside Mitsuba: against_mitsuba prints differences of images of the same scene, and times."""
