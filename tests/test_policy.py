"""policy.py: what policy.npz promises, kept by every committed file."""

import json
import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import NOMINAL, ROOT, error_of, make_run

import evaluate
import go1
import go1_env
import policy
import tasks
from runtime import run_folder

SCALE = 0.25 * np.tile([0.5, 1.0, 1.0], 4)  # rad per unit of action
COMMITTED = sorted((ROOT / "results").rglob("policy*.npz"))


@pytest.mark.go1
def test_the_papers_tasks_have_a_committed_policy():
    """The tests below would pass on nothing. A task of one's own needs none."""
    papers = {"flat", "rough", "velocity", "curriculum"}
    assert {run_folder.load_policy(path)[1].task for path in COMMITTED} >= papers


@pytest.mark.go1
@pytest.mark.parametrize("path", COMMITTED, ids=lambda path: str(path.parent.relative_to(ROOT)))
def test_act_is_mean_of_what_a_robot_measures(path):
    """For 50 steps of each committed policy, and again after a new start: from sensors alone the
    same actions as from what the environment shows. An action of -40 is clipped at -10. A run of
    older code has more arrays in its file, which are ignored.
    """
    pi, env_cfg = run_folder.load_policy(path)
    env_cfg = replace(env_cfg, noise=0.0, stagger=False, tiles=1)
    asked = np.array([[0.5, 0.0, 0.25]])
    env = evaluate.make_env(env_cfg, asked)
    for _ in range(2):
        obs, _ = env.reset(0)
        pi.start()
        for _ in range(50):
            action = pi.mean(obs)
            seen = go1.motion(env.qpos, env.qvel).to_world
            gravity = go1.felt_gravity(seen, env.state.gravity)[0]
            target = pi.act(gravity, asked[0], env.qpos[0, 7:], env.qvel[0, 6:])
            np.testing.assert_allclose(pi.action, action[0].clip(-10, 10), rtol=1e-4, atol=1e-4)
            assert target == pytest.approx(NOMINAL + SCALE * pi.action)
            obs, _, terminated, _, _ = env.step(action)
            assert not terminated.any()
    pi.mean = lambda seen: np.full(12, -40.0)
    assert pi.act(gravity, asked[0], NOMINAL, NOMINAL) == pytest.approx(NOMINAL - 10 * SCALE)


GOOD = [0.0, 0.0, -1.0], [0.5, 0.0, 0.0], NOMINAL, np.zeros(12)


def test_a_sensor_that_fails_is_forgotten(tmp_path):
    """A NaN, or what makes the action infinite, is answered by the last good measurement, and the
    next good one finds everything finite. At the start there is none: the target is the pose of
    action 0, and the first good one is seen as at the start of an episode.
    """
    pi, _ = run_folder.load_policy(make_run(tmp_path) / "policy.npz")
    bad = *GOOD[:3], np.full(12, np.nan)
    first, target = pi.act(*GOOD), pi.act(*bad)
    assert np.isfinite(target).all() and np.isfinite(pi.action).all()
    assert np.array_equal(pi.frames[-1], pi.frames[-2])
    assert np.isfinite(pi.act(*GOOD)).all() and np.isfinite(np.concatenate(pi.frames)).all()
    pi.start()
    assert np.array_equal(pi.act(*bad), NOMINAL)
    assert np.array_equal(pi.act(*GOOD), first)
    pi.mean = lambda obs: np.full(12, np.nan)
    assert np.array_equal(pi.act(*GOOD), NOMINAL) and not pi.action.any()


def test_each_input_has_its_width(tmp_path):
    """Beside one that is too long, one that is too short made a frame of the right width."""
    pi, _ = run_folder.load_policy(make_run(tmp_path) / "policy.npz")
    names = "gravity", "command", "q", "qd"
    for short, long in ((0, 1), (1, 2), (2, 3)):
        wrong = list(GOOD)
        wrong[short], wrong[long] = wrong[short][1:], [*wrong[long], 0.0]
        with pytest.raises(ValueError, match=f"^{names[short]} has the shape"):
            pi.act(*wrong)
    with pytest.raises(ValueError, match=r"^qd has the shape"):
        pi.act(*GOOD[:3], 0.0)


@pytest.mark.go1
def test_what_no_go1_measures_has_failed(tmp_path, page):
    """A silent IMU, acceleration for gravity, degrees, joints that are sorted by kind, and a sensor
    that jumps. A gravity that is about 1 is made 1, and no command that is finite fails.
    """
    pi, _ = run_folder.load_policy(make_run(tmp_path) / "policy.npz")
    down, command, q, qd = GOOD
    for bad in (
        (page["gravity"](0, 0, 0, 0), command, q, qd),
        ([0, 0, -9.81], command, q, qd),
        ([0, 0, -0.75], command, q, qd),
        ([0, 0, -1.25], command, q, qd),
        (down, command, np.degrees(q), qd),
        (down, command, q.reshape(4, 3).T.ravel(), qd),
        (down, command, q, np.full(12, -101.0)),
        (down, [0.5, np.nan, 0], q, qd),
        (down, command, [None] * 12, qd),
    ):
        assert np.array_equal(pi.act(*bad), NOMINAL) and pi.failed and not pi.frames
    pi.act([0, 0.63, -0.84], [1000, 0, 0], q, qd)  # 3 and 4 times 0.21: length 1.05
    assert not pi.failed and pi.frames[-1][:3] == pytest.approx([0, 0.6, -0.8])
    low, high = go1.build_model(0.005, ground=None).jnt_range[1:].T
    assert (low > NOMINAL - policy.REACH).all() and (high < NOMINAL + policy.REACH).all()


def test_the_clock_goes_on_while_a_sensor_fails(tmp_path):
    """3 Hz and 20 ms: the third step is at 0.12 periods, 43.2 degrees."""
    pi, _ = run_folder.load_policy(make_run(tmp_path) / "policy.npz")
    pi.act(*GOOD)
    pi.act(*GOOD[:3], np.full(12, np.nan))
    pi.act(*GOOD)
    assert pi.frames[-1][-2:] == pytest.approx([0.684547, 0.728969], abs=1e-6)


@pytest.mark.go1
def test_a_policy_acts_by_its_own_clock_and_limit(tmp_path):
    """5 Hz and two physics steps of 4 ms: the second step is at 0.04 periods, 14.4 degrees."""
    path = make_run(tmp_path) / "policy.npz"
    own = dict(action_limit=0.5, clock_hz=5.0, timestep=0.004, physics_steps=2)
    with_settings(path, lambda c: c | own)
    pi, _ = run_folder.load_policy(path)
    pi.act(*GOOD)
    pi.act(*GOOD)
    assert pi.frames[-1][-2:] == pytest.approx([0.248690, 0.968583], abs=1e-6)
    pi.mean = lambda obs: np.full(12, -40.0)
    assert pi.act(*GOOD) == pytest.approx(NOMINAL - 0.5 * SCALE)


# ---- what is read ----


def change_npz(path, **changes):
    """Other arrays in an npz file."""
    arrays = run_folder.read_npz(path) | {name.replace("__", "."): x for name, x in changes.items()}
    with path.open("wb") as file:
        np.savez(file, **arrays)


NO_POLICY = {
    "nan": lambda path: change_npz(path, actor__0__b=np.full(8, np.nan)),
    "a layer that does not fit": lambda path: change_npz(path, actor__0__W=np.ones((90, 8))),
}


def with_settings(path, change):
    """Other settings in a policy.npz."""
    config = json.loads(str(run_folder.read_npz(path)["config"]))
    change_npz(path, config=json.dumps(change(config)))


OF_ANOTHER_WORLD = {
    "kp": lambda path: change_npz(path, kp=21.0),
    "q_nominal": lambda path: change_npz(path, q_nominal=np.zeros(12)),
    "friction": lambda path: with_settings(path, lambda c: c.pop("friction") and c),
    "algo": lambda path: with_settings(path, lambda c: c["about"].pop("algo") and c),
    "moonlight": lambda path: with_settings(path, lambda c: c | dict(moonlight=1)),
    "moon": lambda path: with_settings(path, lambda c: c | dict(task="moon")),
}


@pytest.mark.parametrize("name", OF_ANOTHER_WORLD)
def test_a_policy_of_another_robot_or_world_is_refused(tmp_path, capsys, name):
    OF_ANOTHER_WORLD[name](make_run(tmp_path) / "policy.npz")
    said = error_of(capsys, evaluate.main, tmp_path)
    assert name in said and "policy.npz" in said


@pytest.mark.parametrize("damage", NO_POLICY.values(), ids=NO_POLICY)
def test_what_is_no_policy_is_one_line_that_names_it(tmp_path, capsys, damage):
    path = make_run(tmp_path) / "policy.npz"
    damage(path)
    assert error_of(capsys, evaluate.main, tmp_path).count(str(path)) == 1


# ---- docs/deploy.md ----


class Elsewhere:
    """A robot in MuJoCo without our environment, for the loop of the page.

    timestep: [s]; broken: (from, to) [s], while which those `failing` of its three measurements are
        NaN
    """

    def __init__(self, timestep=0.005, broken=(0.0, 0.0), failing=(0, 1, 2)):
        self.data = mujoco.MjData(go1.build_model(timestep, ground=None))
        mujoco.mj_resetDataKeyframe(self.data.model, self.data, 0)
        mujoco.mj_kinematics(self.data.model, self.data)
        self.broken, self.failing = broken, failing
        self.torques, self.speeds = [], []

    def measure(self):
        seen = [self.data.qpos[3:7], self.data.qpos[7:], self.data.qvel[6:]]
        failing = self.failing if self.broken[0] <= self.data.time < self.broken[1] else ()
        return [x * np.nan if i in failing else x.copy() for i, x in enumerate(seen)]

    def apply(self, torque):
        self.data.ctrl = torque
        self.torques.append(torque)
        self.speeds.append(self.data.qvel[6:].copy())
        mujoco.mj_step(self.data.model, self.data)


@pytest.fixture
def page(monkeypatch):
    """What the lines of the page define, with the policy of results/flat."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/deploy.md").read_text(), re.S)
    monkeypatch.chdir(ROOT / "results/flat")
    exec(code, names := {})
    return names


@pytest.mark.go1
@pytest.mark.parametrize("timestep, steps", [(0.005, None), (0.002, 10)])
def test_the_loop_of_deploy_md_walks(page, timestep, steps):
    """Four seconds at 0.5 m/s or more, with physics steps of 5 ms and of 2 ms."""
    page["STEPS"] = steps or page["STEPS"]
    robot = Elsewhere(timestep)
    page["walk"]([0.5, 0.0, 0.0], 4.0, robot.measure, robot.apply)
    assert robot.data.time == pytest.approx(4)
    assert 2 < np.linalg.norm(robot.data.qpos[:2]) < 4 and robot.data.qpos[2] > 0.2


@pytest.mark.go1
def test_the_loop_of_deploy_md_survives_its_sensors(page):
    """It walks on after a gap of 60 ms. A longer one lets it forget, and only damps what is known:
    nothing, or the joints of a robot whose quaternion or whose joint angles are NaN.
    """
    gap = Elsewhere(broken=(1.998, 2.058))
    blind, *damped = (Elsewhere(broken=(1.998, 9.0), failing=x) for x in ((0, 1, 2), (0,), (1,)))
    for robot in (gap, blind, *damped):
        page["walk"]([0.5, 0.0, 0.0], 3.0, robot.measure, robot.apply)
        assert np.isfinite(robot.torques).all()
        assert bool(page["pi"].frames) == (robot is gap)
    assert np.linalg.norm(gap.data.qpos[:2]) > 1.5 and gap.data.qpos[2] > 0.2
    assert not np.any(blind.torques[400:])
    for robot in damped:
        assert robot.torques[-1].any()
        assert robot.torques[-1] == pytest.approx(-0.5 * robot.speeds[-1])


def test_gravity_of_deploy_md(page):
    turn = Rotation.random(9, rng=0)
    down = go1.felt_gravity(turn.as_matrix(), np.tile([0.0, 0.0, -9.81], (9, 1)))
    ours = [page["gravity"](*quaternion) for quaternion in turn.as_quat(scalar_first=True)]
    np.testing.assert_allclose(ours, down, atol=1e-12)


@pytest.mark.go1
def test_the_numbers_of_deploy_md(page):
    """Those that another simulator has to reproduce, as the code has them."""
    text = " ".join((ROOT / "docs/deploy.md").read_text().split())
    robot, flat, curriculum = Elsewhere(), *map(tasks.task_config, ("flat", "curriculum"))
    model, home = robot.data.model, robot.data.qpos
    floor = robot.data.geom_xpos[model.sensor_objid[go1.FEET], 2] - go1.FOOT_RADIUS
    foot, (hip, _, calf) = model.geom("FR_foot"), model.dof_armature[6:9]
    limits, speeds = go1.TORQUE_LIMIT, go1.VELOCITY_LIMIT
    asked, grid = (tasks.TASKS[task].commands() for task in ("flat", "curriculum"))
    noise = [part.noise for part in go1_env.FRAME.values() if part.noise]
    for said in (
        f"{model.body_mass.sum():.1f} kg",
        f"{hip:g} kg m^2 to hips and thighs, and {calf:g} to calves",
        f"at {limits[0]:g} N m for hip and thigh, and at {limits[2]:g} N m for the calf",
        f"{go1.STALL_TORQUE:g} (1 - |qd| / v) N m",
        f"v is {speeds[0]:g} and {speeds[2]:g} rad/s",
        f"kd is {-go1.motor_model(0, 0, 1):g}",
        f"after {1000 * curriculum.timestep * curriculum.latency:g} ms",
        f"the trunk level at {home[2]:g} m",
        f"the rear feet are {1000 * floor.max():.0f} mm above it",
        f"balls of {100 * foot.size[0]:g} cm radius",
        "solref {:g} {:g}, solimp {:g} {:g} {:g}".format(*foot.solref, *foot.solimp[:3]),
        "friction is {} to {}".format(*flat.friction),
        "load {:g} to {:g} kg".format(*flat.payload),
        "{:g} to {:g} m/s ahead".format(*[x[0] for x in (asked.low, asked.high)]),
        f"within {grid.START:g} m/s, {grid.high[1]:g} m/s sideways and {grid.START:g} rad/s",
        "up to {} on gravity, {} rad and {} rad/s".format(*noise),
    ):
        assert said in text
    assert limits.tolist() == page["LIMIT"].tolist() and home[7:].tolist() == NOMINAL.tolist()
    assert flat.timestep == 0.005 and flat.physics_steps == page["STEPS"]
    assert tasks.TASKS["velocity"].torque_speed and curriculum.motor_model
