"""Networks of the front end, and their weights."""
