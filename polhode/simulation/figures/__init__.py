"""Figures of scenes. In: configurations or a dataset. Out: PNG files; each module is a command.

contact_sheet.py           frames of many scenes
correspondence_picture.py  dense correspondences of two views, as a file and as a picture
motion_plot.py             cones, polhode and herpolhode
"""
