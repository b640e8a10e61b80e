"""Section IV-B: Eqs. (9) and (11) by hand, what is clipped (D3), gear ratios (D4), and work as
physics has it (D17).
"""

import mujoco
import numpy as np
import pytest
from support import FROZEN, NOMINAL, QUARTER, ROOT, make, place, quiet, still

import energy
import evaluate
import go1
import go1_env
import policy
import tasks


def joints(*values):
    """Twelve joints, of which the first few have the given values and the others 0."""
    return np.array([*values, *[0.0] * (12 - len(values))])


@pytest.mark.parametrize(("clip", "power"), [("torque", 0.0), ("power", 3.0)])
def test_eq09_mechanical(clip, power):
    """D3. tau = (2, -5) and qd = (3, 2):

    as printed:     2 * 3 +    (-3) * 2  = 0
    power clipped:  2 * 3 + max(-10, -3) = 3
    """
    assert energy.mechanical_power(joints(2.0, -5.0), joints(3.0, 2.0), clip) == power


@pytest.mark.parametrize(("clip", "power"), [("torque", 12.0), ("power", 20.0)])
def test_eq09_mechanical_of_a_joint_driven_backwards(clip, power):
    """D3. A motor that works, at tau = -5 and qd = -4:

    as printed:     (-3) (-4) = 12
    power clipped:  (-5) (-4) = 20
    """
    assert energy.mechanical_power(joints(-5.0), joints(-4.0), clip) == power


@pytest.mark.parametrize(("clip", "power"), [("torque", 20000.0), ("power", 10000.0)])
def test_eq09_mechanical_upper_bound(clip, power):
    """tau = 2e4 and qd = 2. The torque is cut to 1e4, the power of 4e4 to 1e4."""
    assert energy.mechanical_power(joints(2e4), joints(2.0), clip) == power


def test_eq09_heating():
    """tau = (1/2, 1), g = (2, 3): tau * g = (1, 3) and 0.7 (1 + 9) = 7."""
    assert energy.heating_power(np.array([0.5, 1.0]), np.array([2.0, 3.0])) == 7.0


@pytest.mark.parametrize("leg", range(4), ids=["FR", "FL", "RR", "RL"])
@pytest.mark.parametrize(
    ("joint", "torque"), [(0, 2.0), (1, -2.0), (2, 3.0)], ids=["hip", "thigh", "calf"]
)
def test_eq09_gear_ratio(leg, joint, torque):
    """D4, g = (1, 1, 2/3). 2 N m at a hip or thigh and 3 N m at a calf heat alike, 0.7 * 2^2."""
    tau = np.zeros(12)
    tau[3 * leg + joint] = torque
    assert energy.heating_power(tau) == 2.8


@pytest.mark.parametrize(("clip", "power"), [("torque", 56.0), ("power", 59.0)])
def test_eq09_total(clip, power):
    """tau = (2, -4) and qd = (3, 2):

    heat and electronics:  0.7 (4 + 16) + 42 = 56
    mechanical:            6 - 6 = 0, or by power 6 - 3 = 3
    """
    assert energy.total_power(joints(2.0, -4.0), joints(3.0, 2.0), clip) == power


@pytest.mark.parametrize(("clip", "cost"), [("torque", -144.0), ("power", -141.0)])
def test_eq09_survival_bonus(clip, cost):
    """The totals of 56 W or 59 W, less the bonus of 200.

    Without torque 42 W are left, and the cost of 42 - 200 = -158 makes living on pay.
    """
    assert energy.energy_cost(joints(2.0, -4.0), joints(3.0, 2.0), clip) == cost
    idle = np.zeros(12), np.full(12, 7.0), clip
    assert (energy.total_power(*idle), energy.energy_cost(*idle)) == (42.0, -158.0)


@pytest.mark.parametrize(("clip", "expected"), [("torque", -170.8), ("power", -149.8)])
def test_eq09_cost_of_a_step(clip, expected):
    """A hip on target at 8 rad/s has tau = -0.5 * 8 = -4:

    as printed:     (-3) 8 + 0.7 * 16 + 42 - 200 = -170.8
    power clipped:      -3 + 0.7 * 16 + 42 - 200 = -149.8
    """
    env = make(1, clip=clip, **FROZEN)
    place(env, qd=[8.0] + [0.0] * 11)
    info = still(env)[4]
    assert info["cost"] == pytest.approx([expected], abs=1e-3)
    assert info["log"]["power"] == pytest.approx([expected + 200], abs=1e-3)


def test_eq09_cost_at_the_torque_limit():
    """The torque of Eq. (9) is the one that is applied, not the one that was asked for.

    Action 10 asks hips for 20 * 1.25 = 25 N m, the others for 50. They get 23.7, calves 35.55, of
    which 2/3 is 23.7 again:

    12 * 0.7 * 23.7^2 + 42 - 200 = 4560.196
    """
    env = make(1, **FROZEN)
    place(env)
    assert env.step(np.full((1, 12), 10.0))[4]["cost"] == pytest.approx([4560.196], abs=0.01)


@pytest.mark.parametrize(
    ("torque", "action", "qdd", "cost"),
    [
        ((2, -3), (), (), 0.0026),
        ((), (1, -0.5), (), 0.0125),
        ((), (), (60, -80), 0.0025),
        ((2, -3), (1, -0.5), (60, -80), 0.0176),
    ],
)
def test_eq11_smoothness(torque, action, qdd, cost):
    """Each term alone, then all three:

    2e-4   (4 + 9)         = 0.0026
    1e-2   (1 + 1/4)       = 0.0125
    2.5e-7 (3600 + 6400)   = 0.0025
    """
    terms = (joints(*x) for x in (torque, action, qdd))
    assert energy.smoothness_cost(*terms) == pytest.approx(cost, rel=1e-12)


@pytest.mark.parametrize(("qd", "torque"), [(0.0, 5.0), (1.0, 4.3)])
def test_eq11_smoothness_is_the_cost_of_a_step(qd, torque):
    """12 torques of 5 N m, or 0.7 less at 1 rad/s, 4 actions of 2 and 8 of 1, and small qdd:

    2e-4 * 12 * 25 + 1e-2 (4 * 4 + 8 * 1) = 0.06 + 0.24

    There is no survival bonus, and the power is logged all the same.
    """
    env = quiet(aux="smooth")
    place(env, qd=qd)
    info = env.step(QUARTER)[4]
    qdd = (env.qvel[0, 6:] - qd) / 4e-9
    expected = 2e-4 * 12 * torque**2 + 0.24 + 2.5e-7 * np.square(qdd).sum()
    assert info["cost"] == pytest.approx(expected, rel=1e-6)
    assert info["log"]["power"][0] > 200


def test_eq11_takes_the_mean_of_the_physics_steps():
    """D17. In the air, where joints move, the torques of all four physics steps count, and qdd is
    that of the 20 ms.
    """
    env, torques = quiet(aux="smooth", timestep=0.005), []
    step, before = env.batch.step, env.qvel[:, 6:].copy()
    env.batch.step = lambda: (torques.append(env.ctrl.copy()), step())
    cost, qdd = env.step(QUARTER)[4]["cost"], (env.qvel[:, 6:] - before) / 0.02
    tau = 2e-4 * np.square(torques).sum(-1)
    assert len(tau) == 4 and tau[3].max() < 0.9 * tau[0].min()
    expected = tau.mean(0) + 1e-2 * 24 + 2.5e-7 * np.square(qdd).sum(-1)
    assert cost == pytest.approx(expected, rel=1e-6)


# ---- D17: torque times the mean speed of a physics step ----


def random_targets():
    """The nominal pose at rest, qpos and qvel, and random joint targets for 50 control steps."""
    qpos = np.array([0, 0, 0.32, 1, 0, 0, 0, *NOMINAL])
    noise = np.random.default_rng(0).normal(size=(50, 12))
    return qpos, np.zeros(18), NOMINAL + 0.3 * noise


def policy_targets():
    """Where the shipped policy of flat ground is after a second at 1 m/s, and its next targets."""
    pi = policy.load(ROOT / "results" / "flat" / "policy.npz")
    plain = dict(friction=(0.8, 0.8), payload=(0.0, 0.0), start_spread=0.0, stagger=False)
    env = evaluate.make_env(tasks.task_config(**plain), [[1.0, 0.0, 0.0]])
    env.reset(0)
    targets = []
    for t in range(100):
        if t == 50:
            start = env.qpos[0].copy(), env.qvel[0].copy()
        env.step(pi.mean(env.observe()[0]))
        targets.append(NOMINAL + go1_env.ACTION_SCALE * env.state.action[0])
    return *start, targets[50:]


@pytest.mark.parametrize("motion", [random_targets, policy_targets])
def test_work_of_the_motors_is_energy_gained_and_energy_lost_to_the_ground(motion):
    """A second on its feet. Nothing but the ground takes energy, because no joint is damped:

    work of motors + work of contacts = gain of kinetic and potential energy

    This is exact but for what the mass matrix changes within a step, 2 %. By the speed before each
    step a third of the work is gone.
    """
    model = go1.build_model(0.005, None)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    robot, work, ground, before = mujoco.MjData(model), 0.0, 0.0, 0.0
    robot.qpos[:], robot.qvel[:], targets = motion()
    mujoco.mj_forward(model, robot)
    start = robot.energy.sum()
    for target in np.repeat(targets, 4, 0):
        qvel = robot.qvel.copy()
        robot.ctrl[:] = 20 * (target - robot.qpos[7:]) - 0.5 * robot.qvel[6:]
        mujoco.mj_step(model, robot)
        mean = (qvel + robot.qvel) / 2
        work += 0.005 * robot.ctrl @ mean[6:]
        before += 0.005 * robot.ctrl @ qvel[6:]
        ground += 0.005 * robot.qfrc_constraint @ mean
    mujoco.mj_forward(model, robot)
    assert model.dof_damping.max() == 0 and ground < -1  # J
    assert work + ground == pytest.approx(robot.energy.sum() - start, abs=0.02 * work)
    assert before < 0.7 * work
