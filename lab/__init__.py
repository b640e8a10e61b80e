"""The laboratory: the paper's figures, sweeps, gaits and readings, beside the reference.

`python -m lab -h` lists what there is. Nothing of the reference imports this package.
"""
