"""The laboratory: the paper's figures and claims from tables of results, beside the reference.

`python -m lab -h` lists what there is. Nothing of the reference imports this package.
"""
