"""What a step costs: the power model of Eq. (9) and the smoothness cost of Eq. (11).

Sections IV-B and V-E. Both are *costs*: although the paper calls them rewards, positive is bad, and
the learner weighs them against the task in `eipo.py`. How torques come about is in `go1.py`.
Torques and speeds have any leading batch shape. Their last axis, which is reduced, is the twelve
joints in the order FR, FL, RR, RL x hip, thigh, calf:

    torque  (..., 12) [N m]    of the joints
    qd      (..., 12) [rad/s]  of the joints

A power is (...,) [W]. The argument clip says how Eq. (9) is read, see `mechanical_power`.
"""

import numpy as np

HEATING = 0.7  # W / (N m)^2, Eq. (9)
BATTERY = 42.0  # W drawn by the electronics whatever the motors do, Eq. (9)
# W, bonus that makes the cost of a frugal robot negative, so that falling does not pay, Eq. (9)
SURVIVAL = 200.0

# [-] g of Eq. (9), motor torque per joint torque, relative to the hip motor. The calf motor drives
# its joint through an extra 1.5:1 linkage, so a calf torque needs 2/3 of the motor torque that the
# same hip or thigh torque needs (D4).
GEAR_RATIO = np.tile([1.0, 1.0, 2.0 / 3.0], 4)


def norm2(x):
    """||x||^2 of x (..., n), (...,)."""
    return np.square(x).sum(-1)


def mechanical_power(torque, qd, clip):
    """Mechanical power that the motors draw [W]. Eq. (9), line 2: clip(tau, min=-3, max=1e4)^T qd.

    clip: "torque" clips each torque at -3 N m, as printed;
          "power" clips each joint's power at -3 W, i.e. limits what braking recovers

    Deviation D3: the paper prints "torque", but training uses "power". By the printed formula a
    joint that is driven hard in the negative direction is charged as if its torque were -3 N m, and
    a policy finds that out.
    """
    if clip == "torque":
        return (np.clip(torque, -3.0, 1e4) * qd).sum(-1)
    return np.clip(torque * qd, -3.0, 1e4).sum(-1)


def heating_power(torque):
    """Joule heating of the motors [W]. Eq. (9), line 3: 0.7 ||tau * g||^2."""
    return HEATING * norm2(torque * GEAR_RATIO)


def total_power(torque, qd, clip):
    """Power drawn from the battery [W]: Eq. (9) without its bonus."""
    return mechanical_power(torque, qd, clip) + heating_power(torque) + BATTERY


def energy_cost(power):
    """The auxiliary cost f of Eq. (3) [W]: r_energy of Eq. (9), total_power less the bonus."""
    return power - SURVIVAL


def smoothness_cost(torque, action, qdd):
    """The auxiliary cost of Section V-E [-].

    Eq. (11): 2e-4 ||tau||^2 + 1e-2 ||a||^2 + 2.5e-7 ||qdd||^2.

    action: (..., 12) [-]        the policy's action itself, not its change (D15)
    qdd:    (..., 12) [rad/s^2]  joint acceleration, mean over a control step
    """
    return 2e-4 * norm2(torque) + 1e-2 * norm2(action) + 2.5e-7 * norm2(qdd)
