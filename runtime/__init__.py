"""What a run needs and the paper does not mention.

flags.py        the flags of `train.py`, and with which settings one can train
start.py        how a run starts, or goes on
robot.py        whether go1.xml holds the robot of go1.py, and of which robot a file is
run_folder.py   what a run leaves on disk; checkpoint.py has the file with which it goes on
viewer.py       a robot as MuJoCo draws it
kinds.py        what runs are called
metrics.py      the numbers of a run, its line on the console, its pictures
jax_setup.py    what JAX computes with, and on what the last digits of a run depend
cli.py          how the commands speak and end
"""
