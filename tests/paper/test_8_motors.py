"""Sections IV-C.a, IV-A.4 and V-D: the PD controller and the torque limits of the paper and of the
URDF, by hand.
"""

import numpy as np
import pytest

import go1

TOP_SPEED = np.array([30.1, 30.1, 20.06] * 4)  # rad/s, URDF: hip, thigh, calf


@pytest.mark.go1
@pytest.mark.parametrize(
    ("target", "q", "qd", "torque"),
    [(0.5, 0.25, 0.0, 5.0), (0.0, 0.0, 2.0, -1.0), (0.5, 0.25, 2.0, 4.0), (-1.0, 0.5, -4.0, -28.0)],
)
def test_pd(target, q, qd, torque):
    """The last one is beyond the limit, and is not cut here:

    20 (1/2 - 1/4)           =   5
    -0.5 * 2                 =  -1
    both                     =   4
    20 (-1 - 1/2) + 0.5 * 4  = -28
    """
    assert go1.pd_torque(*np.full((3, 12), [[target], [q], [qd]])).tolist() == [torque] * 12


@pytest.mark.go1
def test_motor_model():
    """D11. 20 N m per rad of error, and 0.7 N m per rad/s of speed: 20 * 0.5 - 0.7 * 10 = 3."""
    torque = go1.motor_model(np.full(12, 0.5), np.zeros(12), np.full(12, 10.0))
    assert torque == pytest.approx(np.full(12, 3.0))


@pytest.mark.go1
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("speed", "torque_speed", "hip", "calf"),
    [
        (0, False, 23.7, 35.55),
        (-1, False, 23.7, 35.55),
        (3, False, 23.7, 35.55),
        (0, True, 23.7, 33.0),
        (0.25, True, 23.7, 24.75),
        (0.5, True, 16.5, 16.5),
        (-0.5, True, 16.5, 16.5),
        (2, True, 0, 0),
    ],
)
def test_limit_of_urdf_and_of_section_v_d(sign, speed, torque_speed, hip, calf):
    """The URDF limits torques to 23.7 N m (hip and thigh) and 35.55 N m (calf) at any speed. With
    Section V-D the smaller one holds of these and 33 (1 - |qd| / qd_max). For hip and calf, by |qd|
    as a share of qd_max:

    0       min(33, 23.7)       min(33, 35.55)
    1/4     min(24.75, 23.7)    24.75
    1/2     16.5                16.5
    2       0, where the print has 33 (1 - 2) = -33 (D7)
    """
    asked, expected = np.full(12, sign * 100.0), np.tile([hip, hip, calf], 4)
    limited = go1.limit_torque(asked, speed * TOP_SPEED, torque_speed)
    assert limited == pytest.approx(sign * expected, rel=1e-14)
