"""The report: one self-contained HTML page, made from what a run stored; or one page for several runs.

In: a run directory. Out: report.html.

- page: fills the template with tables and figures; finish_run writes the summary and the report of a run,
  evaluate_and_report its metrics and the report with them
- comparison: the page about several runs
- template: templates, style, script, plotting library and figures inside one file
- tables: the finding in a sentence, and the rows of every table
- motion_figures: centre of mass, attitude, angular velocity
- polhode_and_inertia_figures: polhode, inertia ratios, energy and angular momentum
- convergence_figures: the causal estimate after each frame
- residual_figures: residuals against their noise, observations per frame and landmark
- shape_figures: sparse map and surface
- plot_style: axes, traces and colours that the figures share
- page_pictures: pictures and film of the run inside the page
- page_size: the size of the page, and fewer points for the figures of a long run
- evaluation: a run against the truth of its dataset, which nothing else reads
- pictures/: pictures and film of a run
- templates/: the pages (Jinja), their style (page.css) and script (page.js)
"""

from polhode.report.comparison import write_comparison
from polhode.report.page import (
    evaluate_and_report,
    finish_run,
    page_file,
    write_evaluation,
    write_report,
)
from polhode.report.tables import finding

__all__ = [
    "evaluate_and_report",
    "finding",
    "finish_run",
    "page_file",
    "write_comparison",
    "write_evaluation",
    "write_report",
]
