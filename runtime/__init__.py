"""What a run needs and the paper does not mention: its flags, its folder, its policy, its numbers and its end.

`flags.py` makes the flags, and `limits.py` and `settings.py` say with which settings one can train. `run_folder.py` is
what a run leaves on disk, `snapshot.py` what a checkpoint has of an environment, `policy_file.py` what policy.npz
promises, and `metrics.py` its numbers and pictures. `mirror.py` has the coordinates in which the networks work, and
`scene.py` draws a robot. `interrupt.py` is how a run ends when it is told to, and `parallel.py` how several processes
share it.
"""
