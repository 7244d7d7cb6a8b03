"""What a release needs besides the code; not installed.

In: the checkout and the environment in which it is installed. Out: files in dist/.

    __main__             `make release`: the steps of a release, in their order
    bill_of_materials    dist/polhode.cdx.json: the software bill of materials
"""
