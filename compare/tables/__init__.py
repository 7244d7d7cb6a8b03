"""What is shown of a comparison. In: the rows. Out: text, CSV, HTML.

table   the tables at the terminal, compare.csv
page    compare.html
"""
