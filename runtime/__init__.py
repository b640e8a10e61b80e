"""What a run needs and the paper does not mention.

flags.py        the flags of `train.py`, and with which settings one can train
run_folder.py   what a run leaves on disk; policy_file.py: what policy.npz promises
metrics.py      the numbers of a run, its line on the console, its pictures
interrupt.py    how a run ends when it is told to
parallel.py     how several processes share it
"""
