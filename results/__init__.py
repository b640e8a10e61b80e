"""The paper's figures, tables and claims from our runs, beside the pages that they make.

`python -m results -h` lists what there is. Nothing of the reference imports this package.
"""
