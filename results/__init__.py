"""What came out: a file for each run that is kept, and what is made of them.

runs.py      how a run is kept, and which runs are of one kind
paper.py     the sentences of the paper, with a verdict on each
figures.py   the paper's figures, and three of ours
tables.py    what each kind of run did

`python -m results -h` lists the commands. Nothing of the reference imports this package.
"""
