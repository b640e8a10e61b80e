"""`evaluate.py` asks these modules what the paper does not ask of a trained robot.

`gait.py` says how its feet move, `joints.py` what its joints do, `robust.py` what it endures, and `seeds.py` how runs
differ from seed to seed. `adopt.py` reads other models of the Go1. `sweep.py` knows which runs a figure needs.
"""
