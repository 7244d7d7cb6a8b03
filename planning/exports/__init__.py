"""What leaves the project: records in, file contents out. Nothing here reads a run or writes a file."""
