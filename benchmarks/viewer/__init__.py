"""What the viewer costs a live run, and its picture in the documentation."""
