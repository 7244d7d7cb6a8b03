"""study.html: what a study's table says, as one page that needs no other file.

In: the study and its table. Out: the page.

- write_page: the page is filled and written
- sections: the drawings and tables of each part of the page
- drawings: distributions, dependence, shares, trade-offs
- consistency: whether errors agree with their standard deviations, over all points
- variance_shares: how much of a metric's variance each axis explains; Sobol indices by SALib
- dependence: groups of an axis, their medians and shares with confidence bands
- columns: axes and metrics of a table as numbers, which of them are drawn
"""
