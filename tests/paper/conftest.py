"""The paper as tests, a file for each of its sections. Read them beside it, in the order of their
numbers:

    1 objective    Sections II and III: Eqs. (1) to (4), Eq. (10), GAE, and the step on alpha
    2 algorithm1   Section III: Algorithm 1 whole, on probes
    3 rewards      Section IV-A: Eqs. (5) to (8), the velocity that they mean (D25), and the shaped
                   baseline of V-E
    4 terrain      Sections IV-A.2 and 3: Perlin noise and the ground made of it
    5 curriculum   Section IV-A.4: which commands the robot is ready for
    6 energy       Section IV-B: Eqs. (9) and (11)
    7 networks     Section IV-C: the MLPs, the robot's mirror (D28), and PPO
    8 motors       Sections IV-C.a, IV-A.4 and V-D: the PD controller and its limits
    9 metrics      Sections IV-D and V: episodes and statistics

Numbers are chosen so that a line of arithmetic gives the answer, and the docstring of a test does
it. Where they are dyadic, floating-point arithmetic is exact and `==` is meant. The world as a
whole, its observations, contacts, commands and settings, is tested one folder above. D2 and the
like are entries of `deviations.md`, and the lab's code is what the paper's group has published.
"""
