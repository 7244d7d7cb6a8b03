"""What a release needs besides the code; not installed.

In: the checkout and the environment in which it is installed. Out: files in dist/.

    __main__             `make release`: the steps of a release, in their order
    version              the commit and the version to release, and what must agree with them; the notes
    distribution         sdist and wheel of a commit; what they must hold
    trial                the wheel, installed into an empty environment and run there
    bill_of_materials    dist/polhode.cdx.json: the software bill of materials
    commands             other programs, with their failure in one line
"""
