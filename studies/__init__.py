"""What `evaluate.py` asks of trained robots beyond the paper's figures, and which runs these figures need.

`gait.py` says how its feet move, `joints.py` what its joints do, `robust.py` what it endures, and `seeds.py` how runs
differ from seed to seed. `adopt.py` reads other models of the Go1, `episodes.py` keeps what was played, `statistics.py`
makes numbers of it, and `sweep.py` knows the runs of each figure and keeps them.
"""
