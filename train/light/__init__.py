"""What other light does to features. In: a corpus. Out: bodies under several Suns, and a table.

lit_points.py       points of one body from several poses under several Suns
predictability.py   how many matches are right where light, pose or both differ, and what foresees them
"""
