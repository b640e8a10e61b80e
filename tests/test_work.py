"""Work and velocity as they are: torque times the mean speed of a physics step (D17), velocity over ground (D25)."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_env import NOMINAL, make, place, still

import energy
import go1

HINGE = """<mujoco><option timestep="0.005" integrator="implicitfast"/><worldbody><body>
  <joint name="hinge" type="hinge" axis="0 1 0" armature="0.5"/><geom size="0.1" mass="0" contype="0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="0.5 0.5 0.5"/></body></worldbody>
  <actuator><motor joint="hinge"/></actuator></mujoco>"""


@pytest.mark.parametrize("integrator", ["implicitfast", "Euler"])
def test_work_on_a_joint_is_the_kinetic_energy_that_it_gains(integrator):
    """D17. Inertia 1/2 + 1/2 = 1 kg m^2, 8 N m for 25 steps of 5 ms: 1/8 s, so 1 rad/s and 1/2 J.

    By the mean speed of each step the work is 1/2 J, too. The speed before step k is k / 25, so by that it is
    8 * 0.005 * (0 + ... + 24) / 25 = 0.48 J: each step loses tau^2 dt / (2 I) = 0.16 W of 4 W on average.
    """
    model = mujoco.MjModel.from_xml_string(HINGE.replace("implicitfast", integrator))
    robot, before, mean = mujoco.MjData(model), 0.0, 0.0
    robot.ctrl[:] = 8.0
    for _ in range(25):
        speed = robot.qvel.copy()
        mujoco.mj_step(model, robot)
        before += 0.005 * energy.mechanical_power(robot.ctrl, speed, "power")
        mean += 0.005 * energy.mechanical_power(robot.ctrl, (speed + robot.qvel) / 2, "power")
    assert robot.qvel[0] == pytest.approx(1, abs=1e-12)
    assert (mean, before) == pytest.approx((0.5, 0.48), abs=1e-12)


def test_work_of_the_motors_is_energy_gained_and_energy_lost_to_the_ground():
    """One second of the robot on its feet under random targets: motors = kinetic + potential energy + contacts.

    Exact but for what the mass matrix changes within a step: 2 %. With the speed before each step it is 10 % off.
    """
    model = go1.build_model(0.005, None)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    robot, rng = mujoco.MjData(model), np.random.default_rng(0)
    robot.qpos[2], robot.qpos[3:7], robot.qpos[7:] = 0.32, (1, 0, 0, 0), NOMINAL
    mujoco.mj_forward(model, robot)
    start, work, ground, before = robot.energy.sum(), 0.0, 0.0, 0.0
    for t in range(200):
        if t % 4 == 0:
            target = NOMINAL + rng.normal(size=12) * 0.3
        qvel = robot.qvel.copy()
        robot.ctrl[:] = 20 * (target - robot.qpos[7:]) - 0.5 * robot.qvel[6:]
        mujoco.mj_step(model, robot)
        mean = (qvel + robot.qvel) / 2
        work += 0.005 * robot.ctrl @ mean[6:]
        before += 0.005 * robot.ctrl @ qvel[6:]
        ground += 0.005 * robot.qfrc_constraint @ mean
    mujoco.mj_forward(model, robot)
    assert model.dof_damping.max() == 0 and ground < -1  # J: nothing but the ground takes energy
    assert work + ground == pytest.approx(robot.energy.sum() - start, abs=0.02 * work)
    assert before < 0.9 * work


@pytest.mark.parametrize(
    ("frame", "expected"), [("heading", (1.0, 0.5, 0.25)), ("body", (0.75**0.5, 0.5, 0.25 * 0.75**0.5))]
)
def test_velocity_over_ground(frame, expected):
    """D25. Heading along the world's y, nose up by 30 degrees; 1 m/s along y, 1/2 m/s to its left, yaw 1/4 rad/s.

    Over ground that is (1, 1/2) m/s and 1/4 rad/s. In the body's frame cos 30 of the speed ahead and of the yaw rate
    are left: the rest looks like falling and rolling.
    """
    env = make(1)
    turned = Rotation.from_euler("ZY", [90, -30], degrees=True)
    place(env, quaternion=turned.as_quat(scalar_first=True), velocity=(-0.5, 1.0, 0.0))
    env.qvel[:, 3:6] = turned.apply([0.0, 0.0, 0.25], inverse=True)
    assert env.tracked_velocity(frame)[0] == pytest.approx(expected, abs=1e-6)


def test_a_pitched_robot_is_rewarded_for_what_it_covers():
    """Nose up by 60 degrees, 1 m/s over ground, as asked: Eq. (5) gives 1.5.

    In the body frame v_x is cos 60 = 1/2 and the reward exp(-(1/2)^2 / 0.25) + 0.5 = 0.8679.
    """
    rewards = []
    for frame in ("heading", "body"):
        env = make(1, frame=frame, timestep=1e-9)
        place(
            env, quaternion=Rotation.from_euler("Y", -60, degrees=True).as_quat(scalar_first=True), velocity=(1, 0, 0)
        )
        env.state.command[:] = 1.0, 0.0, 0.0
        rewards.append(still(env)[1][0])
    assert rewards == pytest.approx([1.5, 0.5 + np.exp(-1)], abs=1e-4)


@pytest.mark.parametrize(("turn", "expected"), [(("Y", -30), (30, 0)), (("X", 20), (0, 20)), (("Z", 50), (0, 0))])
def test_attitude(turn, expected):
    """Nose up is a turn about -y, the right side goes down in one about x, and a heading is neither. Degrees."""
    env = make(1)
    place(env, quaternion=Rotation.from_euler(*turn, degrees=True).as_quat(scalar_first=True))
    assert env.attitude()[:, 0] == pytest.approx(expected, abs=1e-9)


def test_starts_from_the_nominal_pose():
    """D35. Without spread all joints are nominal and the trunk is at rest; with it, up to half and 1/2 m/s off."""
    env = make(64, start_spread=0.0)
    assert (env.qpos[:, 7:] == NOMINAL).all() and not env.qvel.any()
    env = make(64)
    ratio, speed = env.qpos[:, 7:] / NOMINAL, np.abs(env.qvel[:, :6])
    assert 0.5 <= ratio.min() < 0.55 and 1.45 < ratio.max() <= 1.5 and 0.45 < speed.max() <= 0.5
