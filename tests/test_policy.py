"""policy.py: what policy.npz promises, kept by every committed file."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation
from support import NOMINAL, ROOT, error_of, make_run

import evaluate
import go1
import go1_env
import tasks
from docs import gait, losses
from networks import MLP
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


def test_a_sensor_that_fails_is_forgotten(tmp_path):
    """A NaN, or what makes the action infinite, is answered by the last good measurement, and the
    next good one finds everything finite. At the start there is none: the target is the pose of
    action 0, and the first good one is seen as at the start of an episode.
    """
    pi, _ = run_folder.load_policy(make_run(tmp_path) / "policy.npz")
    good = [0.0, 0.0, -1.0], [0.5, 0.0, 0.0], NOMINAL, np.zeros(12)
    bad = *good[:3], np.full(12, np.nan)
    first, target = pi.act(*good), pi.act(*bad)
    assert np.isfinite(target).all() and np.isfinite(pi.action).all()
    assert np.array_equal(pi.frames[-1], pi.frames[-2])
    assert np.isfinite(pi.act(*good)).all() and np.isfinite(np.concatenate(pi.frames)).all()
    pi.start()
    assert np.array_equal(pi.act(*bad), NOMINAL)
    assert np.array_equal(pi.act(*good), first)
    pi.mean = lambda obs: np.full(12, np.nan)
    assert np.array_equal(pi.act(*good), NOMINAL) and not pi.action.any()


@pytest.mark.go1
def test_a_policy_says_what_it_is_of(tmp_path):
    """In its JSON beside the settings of its world. Files of older runs do not, and are read."""
    path, about = tmp_path / "policy.npz", dict(iteration=7, algo="eipo", lam=0.005, seed=3)
    made, env_cfg = run_folder.load_policy(make_run(tmp_path) / "policy.npz")
    params = dict(actor=MLP(made.actor), estimator=MLP(made.estimator))
    run_folder.save_policy(path, params, env_cfg, about)
    pi, same = run_folder.load_policy(path)
    assert pi.about == about and pi.config == made.config and same == env_cfg
    assert made.about == {} and {} in [run_folder.load_policy(x)[0].about for x in COMMITTED]


GOOD = [0.0, 0.0, -1.0], [0.5, 0.0, 0.0], NOMINAL, np.zeros(12)


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
    "another robot": lambda path: with_settings(path, lambda c: c | dict(about=dict(robot="0"))),
    "friction": lambda path: with_settings(path, lambda c: c.pop("friction") and c),
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
    """Four seconds at about 0.5 m/s, with physics steps of 5 ms and of 2 ms."""
    page["STEPS"] = steps or page["STEPS"]
    robot = Elsewhere(timestep)
    page["walk"]([0.5, 0.0, 0.0], 4.0, robot.measure, robot.apply)
    assert robot.data.time == pytest.approx(4)
    assert 1.2 < np.linalg.norm(robot.data.qpos[:2]) < 3 and robot.data.qpos[2] > 0.2


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
    assert np.linalg.norm(gap.data.qpos[:2]) > 0.8 and gap.data.qpos[2] > 0.2
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


@pytest.mark.go1
def test_the_table_of_deploy_md(capsys, monkeypatch):
    """It has the rows of losses.py, whose first one is what evaluate.py says. Damping slows the
    robot, and less kd makes up for it. Here episodes last a second, and a command has two.
    """
    cases = losses.CASES
    for name in cases:
        assert f"\n| {name} | " in (ROOT / "docs/deploy.md").read_text()
    few = ("nothing", "joint damping 1", "joint damping 0.5, and kd 0", "2 ms, 10 steps a target")
    monkeypatch.setattr(losses, "CASES", {name: cases[name] for name in few})
    monkeypatch.setattr(evaluate, "EPISODE_STEPS", 50)
    assert losses.main([str(ROOT / "results/velocity")]) == 2
    assert "results/velocity is of velocity" in capsys.readouterr().err
    assert losses.main([str(ROOT / "results/flat"), "--episodes", "22"]) == 0
    evaluate.main([str(ROOT / "results/flat"), "--episodes", "22"])
    lines = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()]
    head, row = lines[-3], lines[-1]
    said = dict(zip(head, row, strict=True))
    shown = {name: [float(x.split()[0].rstrip("%")) for x in row] for name, *row in lines[2:6]}
    score, _, speed, power, fell = shown["nothing"]
    assert score == pytest.approx(float(said["performance"]), abs=0.005)
    assert fell == pytest.approx(100 * float(said["fell"]), abs=0.05)
    assert power == pytest.approx(float(said["power"]), rel=0.1)  # which has falls, too
    assert shown["joint damping 1"][2] < 0.8 * speed
    for name in few[2:]:
        assert shown[name][2] == pytest.approx(speed, rel=0.2)


def trot():
    """What gait.walk returns of a trot: FR and RL stand in every other step of seven, FL and RR in
    the others. Left feet are at 12 and 14 cm, right ones at -10 and -12.
    """
    even = np.arange(7) % 2 == 0
    stands = np.stack([~even, even, even, ~even], -1)[:, None]
    feet = np.tile([(0, -0.10), (0, 0.12), (0, -0.12), (0, 0.14)], (7, 1, 1, 1))
    return np.full((7, 1), 0.5), np.full((7, 1), 100.0), stands, feet


def test_numbers_of_a_gait():
    """Each diagonal of a trot does the same always, and neighbours never. Each foot is set down 3
    times in 3 s, half of 28 feet stand, and feet are 24 cm apart on average.
    """
    found = gait.numbers(*trot())
    assert found == pytest.approx((0.5, 100, 1, 0.5, 1, 0, 0.24))


@pytest.mark.go1
def test_gaits_are_drawn_and_printed(tmp_path, capsys, monkeypatch):
    """A row for each run and speed, and a picture. Asked for more, a robot is faster and draws
    more. What cannot be compared is refused in one line, and nothing is written.
    """
    monkeypatch.setattr(gait, "NUM_ROBOTS", 4)
    out = tmp_path / "gait.png"
    run, to = str(ROOT / "results/flat"), ["--out", str(out)]
    assert gait.main([run, *to, "--v-x", "0.2", "1"]) == 0
    head, _, slow, fast = (
        line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()
    )
    assert (head[:2], slow[1], fast[1]) == (["run", "asked"], "0.2 m/s", "1 m/s")
    assert all(float(slow[i].split()[0]) < float(fast[i].split()[0]) for i in (2, 3))
    assert out.read_bytes()[:4] == b"\x89PNG"
    out.unlink()
    assert gait.main([str(ROOT / "results/velocity"), *to]) == 2
    assert "is of velocity, whose robots are not asked" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        gait.main([run, *to, "--v-x", "nan"])
    assert "--v-x is nan" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        gait.main([run, "--out", str(tmp_path / "gait.pdf")])
    assert "must end in .png" in capsys.readouterr().err
    assert not [*tmp_path.iterdir()]


@pytest.mark.go1
def test_losses_reach_the_simulation_and_falls_leave_power_alone(monkeypatch):
    """Two robots fall, at 3 m/s and on 350 W. The others draw 40 and 90 W, 65 in the mean."""
    asked = np.array([[0.5, 0, 0], [1, 0, 0], [0.5, 0, 0], [1, 0, 0]])
    seen = []

    def run_episodes(policy, env):
        dof = [env.batch.expand(f"dof_{x}")[0].tolist() for x in ("frictionloss", "damping")]
        solimp = env.batch.expand("geom_solimp")[0, env.feet, :3]
        seen.append((dof, solimp.tolist(), go1.KD, env.env_cfg.timestep, env.env_cfg.physics_steps))
        fell, v_x = np.array([False, False, True, True]), np.array([0.4, 0.9, 3, 3])
        score, power = np.array([1, 1.4, 0.2, 0.2]), 100 * v_x + 50 * fell
        return evaluate.Episodes(score, fell, v_x, power, v_x), None

    monkeypatch.setattr(evaluate, "run_episodes", run_episodes)
    changes = dict(friction=0.2, damping=0.5, kd=0.0, solimp=(0.015, 1.0, 0.031), steps=10)
    pi, env_cfg = SimpleNamespace(mean=None), tasks.task_config()
    for changed in (changes, {}):
        found = losses.measure(pi, env_cfg, asked, **changed)
        assert found == pytest.approx((0.7, 0.4, 0.9, 65, 0.5))
    lossy, plain = seen
    trunk = [0.0] * 6
    assert lossy[0] == [trunk + [0.2] * 12, trunk + [0.5] * 12]
    assert lossy[1] == [[0.015, 1.0, 0.031]] * 4 and lossy[2:] == (0.0, 0.002, 10)
    assert plain[0] == [trunk + [0.0] * 12] * 2 and plain[2:] == (0.5, 0.005, 4)
    assert plain[1] != lossy[1]


@pytest.mark.go1
def test_a_walk_is_of_robots_that_last_and_leaves_out_the_first_second(monkeypatch):
    """Control steps of 0.5 s: two of them pass, and six count. Robot 0 falls in the first one.
    Thighs that lie back and calves along them: feet 2 x 0.213 m behind the hips, which are at
    0.1881 m ahead and behind, and 0.08 + 0.04675 m aside.
    """
    env = SimpleNamespace(period=0.5, qpos=np.zeros((2, 19)), contacts=np.zeros((2, 17)), t=0)
    env.qpos[:, 8::3] = np.pi / 2  # the thighs
    env.contacts[1, go1.FEET] = [1, 0, 0, 1]

    def step(action):
        env.t += 1
        log = dict(v_x=np.array([64.0, env.t]), power=np.array([64.0, 10.0 * env.t]))
        return 0, 0, np.array([env.t == 1, False]), 0, dict(log=log)

    env.reset, env.step = lambda seed: (0, {}), step
    asked = []
    monkeypatch.setattr(gait, "NUM_ROBOTS", 2)
    monkeypatch.setattr(evaluate, "make_env", lambda cfg, x: asked.append(x.tolist()) or env)
    v_x, power, stands, feet = gait.walk(SimpleNamespace(mean=lambda obs: 0), None, 0.5)
    assert asked == [[[0.5, 0, 0]] * 2]
    assert v_x.T.tolist() == [[3, 4, 5, 6, 7, 8]] and power[0] == 30
    assert stands.tolist() == [[[True, False, False, True]]] * 6
    x, y = 0.1881 - 0.426, 0.12675
    there = [(x, -y), (x, y), (-0.1881 - 0.426, -y), (-0.1881 - 0.426, y)]
    assert feet[0, 0] == pytest.approx(np.array(there))


def test_gaits_are_of_the_nominal_pose_and_each_number_has_its_name(tmp_path, capsys, monkeypatch):
    seen = []

    def walk(pi, env_cfg, v_x):
        seen.append((env_cfg.start_spread, v_x))
        return trot()

    monkeypatch.setattr(gait, "walk", walk)
    run, out = make_run(tmp_path / "run"), tmp_path / "a.png"
    assert gait.main([str(run), "--v-x", "0.5", "--out", str(out)]) == 0
    assert seen == [(0.0, 0.5)]
    head, _, row = (x.strip("| ").split(" | ") for x in capsys.readouterr().out.splitlines())
    assert dict(zip(head, row, strict=True)) == dict(
        run="run",
        asked="0.5 m/s",
        moves="0.50 m/s",
        power="100 W",
        steps="1.0 / s",
        stands="50%",
        diagonals="100%",
        sides="0%",
        apart="24 cm",
    )


def test_footfalls_stand_in_the_rows_of_their_feet():
    """FL alone stands, from 0.02 to 0.04 s, ahead and to the left."""
    stands = np.zeros((50, 1, 4), bool)
    stands[1, 0, 1] = True
    feet = np.tile([0.2, 0.125], (50, 1, 4, 1))
    figure = Figure()
    gait.draw(figure.subfigures(), "", stands, feet, 0.02)
    falls, above = figure.subfigs[0].axes if figure.subfigs else figure.axes
    names = dict(
        zip(falls.get_yticks(), [x.get_text() for x in falls.get_yticklabels()], strict=True)
    )
    bars = [path.vertices for x in falls.collections for path in x.get_paths()]
    (bar,) = bars
    assert names[bar[:4, 1].mean()] == "FL"
    assert (bar[:, 0].min(), bar[:, 0].max()) == pytest.approx((0.02, 0.04))
    points = np.concatenate([line.get_xydata() for line in above.lines])
    assert points.tolist() == [[-0.125, 0.2]]
