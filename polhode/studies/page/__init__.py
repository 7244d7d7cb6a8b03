"""study.html: what a study's table says, as one page that needs no other file.

In: the study and its table. Out: the page.

- write_page: the page is filled and written, its tables are made
- drawings: metrics along axes, shares of points
- dependence: groups of an axis: their medians, shares and variance, with confidence bands
- columns: axes and metrics of a table as numbers, which of them are drawn
"""
