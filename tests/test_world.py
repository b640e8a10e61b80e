"""The worlds of the tasks: what an episode draws, rough ground, what may touch it, and the world of
the curriculum.
"""

from math import pi

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import (
    FROZEN,
    LEGS,
    NOMINAL,
    ON_ITS_BACK,
    ON_ITS_SIDE,
    QUARTER,
    UPRIGHT,
    make,
    place,
    quiet,
    random_actions,
    same_bits,
    soles,
    still,
)

import go1
import go1_env
import rewards
import tasks
import terrain

# ---- what an episode draws ----


def drawn(env):
    """What the episodes of env draw of the physics, (N, n) each, in the units of tasks.Config."""
    model, state = go1.build_model(0.005, None, looks=False), env.state
    trunk, feet = model.body("trunk").id, [model.geom(f"{leg}_foot").id for leg in LEGS]
    mass, com = state.mass - model.body_mass, state.com - model.body_ipos
    friction = state.friction[..., 0] - model.geom_friction[:, 0]
    for x, changed in ((mass, trunk), (com, trunk), (friction, feet)):
        assert not np.delete(x, changed, axis=1).any()  # other bodies and geoms are as they are
    return dict(
        friction=state.friction[:, feet, 0].copy(),
        payload=mass[:, [trunk]],
        com=com[:, trunk],
        motor_strength=state.strength.copy(),
        motor_offset=state.offset.copy(),
        gravity=state.gravity - [0, 0, -9.81],
    )


USUAL = dict(friction=(0.5, 1.25), payload=(-1, 1), com=(0, 0))
USUAL |= dict(motor_strength=(1, 1), motor_offset=(0, 0), gravity=(0, 0))
HARD = dict(friction=(0.55, 1.25), payload=(-1, 3), com=(-0.05, 0.05))
HARD |= dict(motor_strength=(0.9, 1.1), motor_offset=(-0.02, 0.02), gravity=(-1, 1))


@pytest.mark.parametrize("task", tasks.TASKS)
def test_what_an_episode_draws_is_in_its_range(task):
    """IV-A.4. All of the range and nothing else, other for every robot, axis and joint, but for
    the four feet, which are alike.
    """
    found = drawn(make(64, task=task))
    for name, (low, high) in (HARD if task == "curriculum" else USUAL).items():
        x, margin = found[name], 0.1 * (high - low)
        assert low - 1e-12 <= x.min() <= low + margin, name
        assert high - margin <= x.max() <= high + 1e-12, name
        if high > low:
            assert len(np.unique(x.round(12))) == (64 if name == "friction" else x.size), name
    assert (found["friction"] == found["friction"][:, :1]).all()


def test_what_is_drawn_lasts_one_episode():
    """IV-A.2, IV-A.4. 16 of 32 robots end their episode at step 2 and get another ground, and
    another of all that is drawn. The others keep theirs.
    """
    env = make(32, task="rough", episode_steps=4, **HARD)
    env.state.age[:16] = 2
    tile, before = env.state.tile.copy(), drawn(env)
    still(env)
    assert same_bits([tile, *before.values()], [env.state.tile, *drawn(env).values()])
    assert still(env)[3].tolist() == [True] * 16 + [False] * 16
    moved = env.state.tile != tile
    assert not moved[16:].any() and moved[:16].sum() >= 10  # 1 in 16 draws the same
    for name, new in drawn(env).items():
        old = before[name]
        assert (old[16:] == new[16:]).all() and (old[:16] != new[:16]).all(), name


# ---- rough ground ----


def rays(env, points):
    """Height of the ground [m] at points (n, 2), by rays of MuJoCo straight down on the floor."""
    model = go1.build_model(0.005, env.ground)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    floor, hit = [1, 0, 0, 0, 0, 0], np.zeros(1, np.int32)
    return np.array(
        [5 - mujoco.mj_ray(model, data, [*xy, 5], [0, 0, -1], floor, 1, -1, hit) for xy in points]
    )


@pytest.mark.parametrize("task", ["rough", "velocity"])
def test_start_touches_rough_ground(task):
    """The lowest foot or knee, a ball of 2 cm, ends within 5 mm of the ground, by MuJoCo's
    kinematics and rays. MuJoCo's ground is made of triangles, so that it is not exactly there.
    """
    env = make(32, task=task)
    model = go1.build_model(0.005, env.ground)
    data, centres = mujoco.MjData(model), []
    for qpos in env.qpos:
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        assert data.contact.dist.min(initial=0.0) > -0.005
        for leg in LEGS:
            centres += [data.geom(f"{leg}_foot").xpos.copy(), data.body(f"{leg}_calf").xpos.copy()]
    gaps = np.array(centres)[:, 2] - 0.02 - rays(env, np.array(centres)[:, :2])
    assert np.abs(gaps.reshape(32, 8).min(1)).max() < 0.005


def test_the_ground_is_of_its_seed_cells_and_roughness():
    """5 cm on all tiles of `velocity`, and from 0 to 15 cm on those of `rough`."""
    ground = make(1, task="velocity", ground_seed=1).ground
    assert (ground == terrain.make_ground([0.05] * 16, seed=1, cells_per_m=4)).all()
    assert (ground != make(1, task="velocity").ground).any()
    ground = make(1, task="rough", tiles=4).ground
    expected = terrain.make_ground([0.0, 0.05, 0.1, 0.15], seed=0, cells_per_m=1)
    assert ground == pytest.approx(expected, abs=1e-12)


def test_start_is_anywhere_on_the_tile():
    """x and y of 256 robots are correlated by chance alone, by 1/16. All 16 tiles are used, from

    6 index + 1 to 6 index + 5 m in x
              1 to           5 m in y
    """
    env = make(256, task="rough")
    xy = env.qpos[:, :2] - np.stack([6.0 * env.state.tile + 1, np.ones(256)], -1)
    assert ((xy >= 0) & (xy < 4)).all() and (xy.min(0) < 0.1).all() and (xy.max(0) > 3.9).all()
    assert abs(np.corrcoef(xy.T)[0, 1]) < 5 / 16
    assert sorted(set(env.state.tile)) == list(range(16))


@pytest.mark.go1
def test_the_seam(monkeypatch):
    """A robot that leaves its tile is put back and does not notice. Its twin, on the same ground,
    stays on its own, because its tiles begin 2 m further on in x and in y.

    Four robots on 5 cm run over the far and the near edge in x, the far one in y, and a corner.
    """
    env = make(4, task="velocity")
    amid = 20 + (np.arange(120) + 20) % 80  # 20 points of apron, 80 of tile, each 40 points on
    heights = env.ground.reshape(120, 16, 120)[amid][:, :, amid].reshape(120, -1)
    monkeypatch.setattr(go1_env.terrain, "make_ground", lambda *_, **__: heights)
    twin = make(4, task="velocity")
    heading = np.array([[1, 0], [-1, 0], [0, 1], [-(0.5**0.5), -(0.5**0.5)]])
    half = np.array([0, pi / 2, pi / 4, 5 * pi / 8])  # of the yaw
    quaternion = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], -1)
    corner = np.stack([6.0 * env.state.tile + 1, np.ones(4)], -1)
    starts = [[3.9, 3.0], [0.1, 3.0], [3.0, 3.9], [0.1, 0.1]]
    twins_starts = [[1.9, 1.0], [2.1, 1.0], [1.0, 1.9], [2.1, 2.1]]
    for world, start in ((env, starts), (twin, twins_starts)):
        place(world, height=0.34, quaternion=quaternion)
        world.qpos[:, :2], world.qvel[:, :2] = corner + start, 3.0 * heading
    for action in random_actions(env, 10) / 2:
        obs, reward, ended, _, info = env.step(action)
        twins_obs, twins_reward, _, _, twins_info = twin.step(action)
        assert not ended.any()
        assert obs == pytest.approx(twins_obs, abs=1e-6)
        assert reward == pytest.approx(twins_reward, abs=1e-6)
        assert info["cost"] == pytest.approx(twins_info["cost"], abs=1e-3)
        assert env.qpos[:, 2:] == pytest.approx(twin.qpos[:, 2:], abs=1e-6)
        assert env.qvel == pytest.approx(twin.qvel, abs=1e-6)
    moved = env.qpos[:, :2] - twin.qpos[:, :2]
    # 2 m before, all in x or y
    assert moved == pytest.approx(np.array([[-2, 2], [2, 2], [2, -2], [2, 2]]), abs=1e-6)


@pytest.mark.go1
@pytest.mark.parametrize("task", tasks.TASKS)
def test_no_foot_sinks_in(task):
    """D43. With the most friction and payload of a task, the soles of a robot that stands are at
    most 5 mm deep.

    MuJoCo's pyramidal contacts give way the more friction they have. At 3, as in the lab's code,
    the shins would touch the ground, which is a fall.
    """
    settings = tasks.task_config(task)
    most = dict(friction=settings.friction[1:] * 2, payload=settings.payload[1:] * 2)
    env = make(1, task=task, roughness=(0.0, 0.0), **most)
    place(env, height=0.31)
    assert not any(still(env)[2] for _ in range(100))
    assert -0.005 < soles(env.qpos[0]).min() < 0


def test_no_foot_is_caught_in_the_ground():
    """D12. The centre of a foot that is pressed into the ground comes out again within 0.1 s.

    On a height field a centre below the surface may be nearer to the side of a prism than to its
    top, and is then pushed along, not up.
    """
    env, below = make(64, task="rough", roughness=(1e-6, 1e-6)), np.zeros((64, 4), int)
    for action in random_actions(env, 100):
        ended = env.step(action)[2]
        up = Rotation.from_quat(env.qpos[:, 3:7], scalar_first=True).as_matrix()[:, 2]
        feet = go1.leg_points(env.qpos[:, 7:])[:, 1::2]
        centres = env.qpos[:, 2:3] + np.einsum("nj,nkj->nk", up, feet)
        below = np.where((centres < 0) & ~ended[:, None], below + 1, 0)
        assert below.max() <= 5


# ---- what the tasks differ in: contacts and motors ----


SOME = ["velocity", "curriculum"]  # where nothing but the feet may touch the ground


@pytest.mark.go1
@pytest.mark.parametrize("high", [0.0, 1e-6], ids=["plane", "height field"])
@pytest.mark.parametrize(
    ("quaternion", "height", "q", "ends"),
    [
        (UPRIGHT, 0.4, NOMINAL, []),
        (UPRIGHT, 0.44, np.zeros(12), []),
        (UPRIGHT, 0.41, np.zeros(12), SOME),
        (UPRIGHT, 0.21, np.zeros(12), tasks.TASKS),
        (ON_ITS_BACK, 0.056, np.tile([0.0, 0.8, -1.5], 4), tasks.TASKS),
        (UPRIGHT, 0.056, np.tile([0.0, 3.0, -1.5], 4), tasks.TASKS),
        (ON_ITS_SIDE, 0.14, np.tile([0.0, 0.8, -1.5], 4), tasks.TASKS),
    ],
    ids=["in the air", "feet", "shins", "thighs", "back", "belly, legs up", "side, on the hips"],
)
@pytest.mark.parametrize("task", tasks.TASKS)
def test_what_may_touch_the_ground(task, quaternion, height, q, ends, high):
    """IV-A.3, D13. 1 mm into the ground is a fall. How far parts reach from the trunk's middle:

    down, legs straight:  soles 0.446 m, shins 0.413 m, thighs 0.217 m, the trunk itself 0.057 m
    to the side:          hips 0.147 m
    """
    env = make(task=task, roughness=(high, high), max_power=None, **FROZEN)
    place(env, q, height=height, quaternion=quaternion)
    _, _, terminated, truncated, info = still(env)
    assert terminated.tolist() == info["log"]["ended_fall"].tolist() == [task in ends] * 2
    assert not truncated.any() and not info["log"]["ended_diverged"].any()


@pytest.mark.go1
@pytest.mark.parametrize(
    ("task", "expected"),
    [
        ("flat", [17.475, 23.7, 35.55]),
        ("rough", [17.475, 23.7, 35.55]),
        ("velocity", [16.5] * 3),
        ("curriculum", [14.465, 16.5, 16.5]),
    ],
)
def test_torque_speed_limit_by_task(task, expected):
    """V-D. At half its largest speed, 15.05 or 10.03 rad/s, a joint gives 33/2 N m on `velocity`
    and `curriculum`, whose hips (D11) ask for less: 20 * 1.25 - 0.7 * 15.05 = 14.465.

    Elsewhere the URDF's limit holds. What action 10 asks for:

    hips    20 * 1.25 - 0.5 * 15.05 = 17.475
    thighs  20 * 2.5  - 0.5 * 15.05 = 42.475
    calves  20 * 2.5  - 0.5 * 10.03 = 44.985
    """
    env = quiet(task=task, max_power=None)
    place(env, qd=np.tile([15.05, 15.05, 10.03], 4))
    env.step(np.full((2, 12), 10.0))
    assert env.ctrl == pytest.approx(np.tile(expected, (2, 4)), abs=1e-3)


def test_torque_speed_limit_before_every_physics_step():
    """Four physics steps are four times one, while the limit sinks with each as joints speed up."""
    four, one = (make(task="velocity", roughness=(0.0, 0.0), physics_steps=n) for n in (4, 1))
    place(four), place(one)
    action = np.full((2, 12), 4.0)
    four.step(action)
    for _ in range(4):
        one.step(action)
    assert same_bits([four.qpos, four.qvel, four.ctrl], [one.qpos, one.qvel, one.ctrl])


# ---- the curriculum's world ----


@pytest.mark.go1
def test_latency_in_steps():
    """Six physics steps are one and a half control steps of four, so that a new target reaches the
    motors in the middle of the second one.

    The joints rest at the old target: 0 N m before, and 20 * 0.25 N m after.
    """
    env = quiet(latency=6)
    torques, step = [], env.batch.step
    env.batch.step = lambda: (torques.append(env.ctrl.copy()), step())
    for _ in range(2):
        env.step(QUARTER)
    assert np.array(torques)[:, 0, 0] == pytest.approx([0.0] * 6 + [5.0] * 2, abs=1e-6)


@pytest.mark.go1
def test_motor_strength_and_offset():
    """Motors of half strength, whose encoders read 0.125 rad too much: 1/2 * 20 (0.25 - 0.125).

    A strong one is limited like any other: action 10 asks a hip for 20 * 1.25 * 1.1 = 27.5 N m, and
    it gets the URDF's 23.7, not 1.1 times that.
    """
    weak = quiet(motor_strength=(0.5, 0.5), motor_offset=(0.125, 0.125))
    weak.step(QUARTER)
    assert weak.ctrl == pytest.approx(np.full((2, 12), 0.5 * 20 * (0.25 - 0.125)), abs=1e-6)
    strong = quiet(motor_strength=(1.1, 1.1), max_power=None)
    strong.step(np.full((2, 12), 10.0))
    assert strong.ctrl[:, 0] == pytest.approx([23.7] * 2)


def test_gravity_is_what_things_fall_by_and_what_is_felt():
    """In the air a trunk gains what gravity was drawn as, times 20 ms. A level robot feels gravity
    of (1, 1, -8.81) m/s^2 as that over its length.
    """
    env = quiet(8, gravity=(-1.0, 1.0), timestep=0.005)
    still(env)
    assert env.qvel[:, :3] == pytest.approx(0.02 * env.state.gravity, abs=1e-9)
    felt = still(quiet(history=1, gravity=(1.0, 1.0)))[0][0, :3]
    assert felt == pytest.approx(np.array([1.0, 1.0, -8.81]) / (2 + 8.81**2) ** 0.5, abs=1e-6)


@pytest.mark.go1
@pytest.mark.parametrize(("limit", "ends"), [(130.0, False), (125.0, True), (None, False)])
def test_power_limit_is_of_the_control_step(limit, ends):
    """IV-A.4, D17. Without torque joints that rest take the electronics' 42 W, and at 5 N m, of
    which calves need 2/3 of the motor torque, 0.7 * 25 * (8 + 4 * 4/9) + 42 = 213.1 W.

    Six physics steps late, 5 N m come in the last two of the second control step's four:

    (2 * 42 + 2 * 213.1) / 4 = 127.6 W

    A limit of 130 W, which the last two exceed by far, lets it pass.
    """
    env = quiet(latency=6, max_power=limit)
    assert not env.step(QUARTER)[2].any()
    _, _, terminated, _, info = env.step(QUARTER)
    mean = 42 + 0.7 * 25 * (8 + 16 / 9) / 2
    assert info["log"]["power"] == pytest.approx([mean] * 2, abs=1e-3)
    assert terminated.tolist() == info["log"]["ended_power"].tolist() == [ends] * 2


def test_a_touch_in_one_physics_step_of_four_is_a_fall():
    """D13. Robot 0's trunk touches the ground in the first one alone. Its feet, which were up for
    long, begin the next episode with one step.
    """
    env = quiet(reward="shaped")
    env.state.off_ground[:], env.contacts = 7, np.zeros((2, 17))
    touches = iter([1.0, 0.0, 0.0, 0.0])
    env.batch.step = lambda: env.contacts.__setitem__((0, 0), next(touches))
    _, _, terminated, _, info = still(env)
    assert terminated.tolist() == info["log"]["ended_fall"].tolist() == [True, False]
    assert env.state.off_ground.tolist() == [[1] * 4, [8] * 4]


# ---- V-E: the shaped reward ----


def test_shaped_reward_replaces_the_task_reward_and_keeps_it_in_the_log():
    """A robot that is 10 cm too high and moves at 1 m/s, where 1.5 is asked for, has 1/e + 1/2 =
    0.86788, less 30 * 0.1^2.
    """
    env = quiet(reward="shaped")
    place(env, height=0.44, velocity=(1, 0, 0))
    env.state.command[:] = 1.5, 0, 0
    _, reward, _, _, info = still(env)
    assert reward == pytest.approx([0.56788] * 2, abs=1e-3)
    assert info["log"]["task_reward"] == pytest.approx([0.86788] * 2, abs=1e-5)


@pytest.fixture
def seen(monkeypatch):
    """The Gait and the velocity that the shaped reward was given in each step, by name."""
    steps, shaped = [], rewards.shaped

    def spy(velocity, command, gait):
        given = gait._asdict() | dict(velocity=velocity)
        steps.append({name: np.array(x) for name, x in given.items()})
        return shaped(velocity, command, gait)

    monkeypatch.setattr(rewards, "shaped", spy)
    return steps


def test_what_the_shaped_reward_sees_of_the_trunk(seen):
    """Robots on their right side: the trunk's y is up, and its z is the world's -y.

    They roll at 1, pitch at 2 and yaw at 4 rad/s, and move at 8, 16, 32 m/s in the world, so at 32
    along their y, and -16 along their z. The trunk's frame is rewarded. Heights are above the
    ground below, as MuJoCo's rays find it there.
    """
    frame = dict(reward="shaped", velocity_frame="body")
    env = make(8, task="rough", roughness=(0.15, 0.15), **frame, **FROZEN)
    place(env, quaternion=ON_ITS_SIDE, velocity=(8, 16, 32), rates=(1, 2, 4))
    ground = rays(env, env.qpos[:, :2])
    env.qpos[:, 2] = ground + 0.25
    still(env)
    assert np.ptp(ground) > 0.03
    assert seen[0]["height"] == pytest.approx(np.full(8, 0.25), abs=2e-3)
    assert seen[0]["roll_pitch_rate"] == pytest.approx(np.tile([1, 2], (8, 1)), abs=1e-3)
    assert seen[0]["v_z"] == pytest.approx(np.full(8, -16))
    assert seen[0]["velocity"] == pytest.approx(np.tile([8, 32, 4], (8, 1)), abs=1e-3)
    assert seen[0]["gravity"] == pytest.approx(np.tile([0.0, -1.0, 0.0], (8, 1)), abs=1e-6)


def test_the_shaped_reward_feels_the_gravity_that_was_drawn(seen):
    """(1, 1, 1 - 9.81) over its length, sqrt(1 + 1 + 77.6161) = 8.922786."""
    still(quiet(1, reward="shaped", gravity=(1.0, 1.0)))
    expected = np.array([[0.112073, 0.112073, -0.987359]])
    assert seen[0]["gravity"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.go1
def test_what_the_shaped_reward_sees_of_joints_and_actions(seen):
    """Actions rise from 1 to 4, and speeds from 1/4 to 1 rad/s in the four steps of 20 ms. Joints
    stay 1/8 rad off the nominal pose:

    qdd             (1 - 1/4) / 0.02               = 37.5 rad/s^2
    speed before the last step                     = 13/16 rad/s
    hips' torque    20 (0.5 - 0.125) - 0.5 * 13/16 = 7.09375 N m
    others'         20 (1.0 - 0.125) - 0.5 * 13/16 = 17.09375 N m
    """
    env = make(reward="shaped")
    place(env, q=NOMINAL + 0.125, qd=0.25)
    env.state.action[:] = 1.0

    def faster():
        env.qvel[:, 6:] += 3 / 16

    env.batch.step = faster
    env.step(np.full((2, 12), 4.0))
    assert seen[0]["qdd"] == pytest.approx(np.full((2, 12), 37.5))
    assert seen[0]["torque"] == pytest.approx(np.tile([7.09375, 17.09375, 17.09375], (2, 4)))
    assert (seen[0]["action_change"] == 3).all() and (seen[0]["q"] == NOMINAL + 0.125).all()
    limits = [[-0.863, -0.686, -2.818] * 4, [0.863, 4.501, -0.888] * 4]
    assert seen[0]["joint_range"].tolist() == limits


def test_what_the_shaped_reward_sees_of_contacts(seen):
    """Robot i of 17 touches the ground with sensor i alone, and robot 17 with all, of which the
    four thighs and four calves are collisions.

    A foot that touches it now was up for as many steps of 20 ms as counted: FR 2, FL 3, RR 4, RL 5.
    """
    env, robot = make(18, reward="shaped"), mujoco.MjModel.from_xml_path(str(go1.MODEL))
    parts = [robot.sensor(i).name for i in range(17)]
    feet = [parts.index(f"{leg}_foot_contact") for leg in LEGS]
    env.contacts, env.state.off_ground[:] = np.vstack([2 * np.eye(17), np.ones(17)]), [2, 3, 4, 5]
    env.batch.step = lambda: None
    still(env)
    collides = [float("thigh" in part or "calf" in part) for part in parts]
    assert seen[0]["collisions"].tolist() == [*collides, 8]
    landed, times = seen[0]["landed"], [0.04, 0.06, 0.08, 0.1]
    assert landed[[*feet, 17]] == pytest.approx(np.vstack([np.diag(times), times]))
    assert not np.delete(landed, [*feet, 17], axis=0).any()
    # the foot that touches the ground counts anew
    off_ground = np.array([3, 4, 5, 6]) * (1 - np.eye(4))
    assert env.state.off_ground[feet].tolist() == off_ground.tolist()


def test_the_shaped_reward_sees_contacts_of_the_last_physics_step(seen):
    """The calf and the foot of FR, sensors 9 and 13, touch the ground in the first of four."""
    env = make(1, reward="shaped")
    env.contacts, env.state.off_ground[:] = np.zeros((1, 17)), 4
    touches = iter([1.0, 0.0, 0.0, 0.0])

    def step():
        env.contacts[:, [9, 13]] = next(touches)

    env.batch.step = step
    still(env)
    assert seen[0]["collisions"].tolist() == [0] and not seen[0]["landed"].any()
