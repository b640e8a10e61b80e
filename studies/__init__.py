"""What one may ask of trained robots and the paper does not need, each a figure or a table of `evaluate.py`.

How the feet and the joints move is in `gait.py` and `joints.py`, what a policy endures in `robust.py`, and how runs
differ from seed to seed in `seeds.py`. `adopt.py` reads other models of the Go1, and `sweep.py` knows which runs the
figures of the paper need.
"""
