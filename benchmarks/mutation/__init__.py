"""Does the test suite notice a defect? In: the repository. Out: deliberate faults and the tests that fail.

- ``faults``: the list of faults, each a piece of code and what replaces it.
- ``catch``: the command; puts one fault at a time into a copy of the repository and runs its tests.
"""
