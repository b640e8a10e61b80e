"""What a run needs and the paper does not mention: its folder, its policy, its numbers, its end, and its company.

`limits.py` and `settings.py` say which settings can be used. `run_folder.py` is what a run leaves on disk,
`policy_file.py` what policy.npz promises, and `metrics.py` its numbers and pictures. `interrupt.py` is how a run ends
when it is told to, and `parallel.py` how several processes share one.
"""
