"""Does the test suite notice a defect? In: the repository. Out: deliberate faults and the tests that fail.

catch   puts one fault of ``faults.yaml`` at a time into a copy of the repository and runs its tests
"""
