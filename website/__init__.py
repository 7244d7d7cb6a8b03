"""The documentation as a site: ``make docs`` builds it from docs/ and from the code.

In: the pages of docs/, the package, the registry of benchmarks. Out: site/, which needs no network to read.

- hooks: what MkDocs calls: generated pages, links to files of the repository, mathematics
- generated: the pages that are made from the code, by their paths in the site
- commands_page: the help of every command
- configuration_page: every setting with its type, range, default and text
- summary_page: the files of a run, and every field of summary.json
- benchmarks_page: every benchmark with its command, what it prints, and the date of its record
- source_pages: files of the repository that the pages link to, and the paths that they have in the site
- mathematics: LaTeX in the pages as MathML
- external_links: whether the links that leave the site still answer (``make docs-links``)
"""
