"""The documentation as a site: ``make docs`` builds it from docs/ and from the code.

In: the pages of docs/, the package, the registry of benchmarks. Out: site/, which needs no network to read.

- hooks: what MkDocs calls: generated pages, links to files of the repository, mathematics
- reference_pages: commands, settings, fields of summary.json and benchmarks, from the code
- source_pages: files of the repository that the pages link to, and the paths that they have in the site
- mathematics: LaTeX in the pages as MathML
- external_links: whether the links that leave the site still answer (``make docs-links``)
"""
