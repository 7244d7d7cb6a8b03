"""The cost of runs that ``polhode checkout`` estimates: run_cost fits its constants."""
