"""The pages that are made from the code and from tables of studies, by their paths in the site."""

from pathlib import Path

from website.benchmarks_page import benchmarks_page
from website.commands_page import commands_page
from website.configuration_page import configuration_page
from website.source_pages import source_pages
from website.study_pages import study_pages
from website.summary_page import summary_page


def generated_pages(root: Path) -> dict[str, str]:
    """Path in the site -> Markdown, or HTML where the path says so; root: the checkout."""
    return {
        "reference/commands.md": commands_page(),
        "reference/configuration.md": configuration_page(),
        "reference/summary.md": summary_page(),
        "reference/api.md": API,
        "reference/benchmarks.md": benchmarks_page(root),
        **dict(source_pages(root)),
        **study_pages(root),
    }


API = """# Python API

[From Python](../api.md) shows how it is used; this page lists what there is, by the docstrings.

## Functions

::: polhode.api.run
::: polhode.api.load
::: polhode.api.load_study
::: polhode.api.simulate
::: polhode.api.evaluate
::: polhode.api.configuration

## A finished run

::: polhode.api.Run
::: polhode.api.MassEstimate

## Pairs as they come

::: polhode.pipeline.live.session.Session

## Records

::: polhode.records

## Errors

::: polhode.errors
"""
