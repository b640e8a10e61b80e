"""The worlds of the tasks: what an episode draws, rough ground, what may touch it, and the world of
the curriculum.
"""

from math import cos, pi, sin

import mujoco
import numpy as np
import pytest
import support
from scipy.spatial.transform import Rotation
from support import (
    FROZEN,
    LEGS,
    NOMINAL,
    QUARTER,
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
import shaped
import tasks
import terrain

BOTH = pytest.mark.parametrize(
    "roughness", [(0.0, 0.0), (1e-6, 1e-6)], ids=["plane", "height field"]
)

# ---- what an episode draws ----


def drawn(env):
    """What the episodes of env draw of the physics, (N, n) each, in the units of its Config."""
    model, state = mujoco.MjModel.from_xml_path(str(go1.MODEL)), env.state
    trunk, feet = model.body("trunk").id, [model.geom(f"{leg}_foot").id for leg in LEGS]
    mass, com = state.mass - model.body_mass, state.com - model.body_ipos
    friction = state.friction[..., 0] - model.geom_friction[:, 0]
    for x, changed in ((mass, trunk), (com, trunk), (friction, feet)):
        # other bodies, and what is no foot, are as they are
        assert not np.delete(x, changed, axis=1).any()
    return dict(
        friction=state.friction[:, feet, 0].copy(),
        payload=mass[:, [trunk]],
        com=com[:, trunk],
        motor_strength=state.strength.copy(),
        motor_offset=state.offset.copy(),
        gravity=state.gravity - [0, 0, -9.81],
    )


@pytest.mark.parametrize("task", tasks.TASKS)
def test_what_an_episode_draws_is_in_its_range(task):
    """All of the range and nothing else, other for every robot, every axis and every joint; but
    feet are alike.
    """
    env = make(64, task=task)
    for name, x in drawn(env).items():
        low, high = getattr(env.env_cfg, name)
        margin, wide = 0.1 * (high - low), high > low
        assert (
            low - 1e-12 <= x.min() <= low + margin and high - margin <= x.max() <= high + 1e-12
        ), name
        assert not wide or len(np.unique(x.round(12))) == (64 if name == "friction" else x.size), (
            name
        )
    assert (drawn(env)["friction"] == drawn(env)["friction"][:, :1]).all()


def test_the_ranges_are_those_of_the_table():
    """tasks.py: friction 0.5 to 1.25 and +- 1 kg; on the curriculum 0.1 to 1.25, -1 to 3 kg, and
    five more.
    """
    usual = dict(
        friction=(0.5, 1.25),
        payload=(-1, 1),
        com=(0, 0),
        motor_strength=(1, 1),
        motor_offset=(0, 0),
        gravity=(0, 0),
    )
    hard = dict(
        friction=(0.1, 1.25),
        payload=(-1, 3),
        com=(-0.05, 0.05),
        motor_strength=(0.9, 1.1),
        motor_offset=(-0.02, 0.02),
        gravity=(-1, 1),
    )
    for task in tasks.TASKS:
        for name, expected in (hard if task == "curriculum" else usual).items():
            assert getattr(tasks.task_config(task), name) == expected, (task, name)


def test_what_is_drawn_lasts_one_episode():
    """IV-A.2: 16 of 32 robots end their episode at step 2 and get another ground, friction and
    load; 16 keep theirs.
    """
    env = make(32, task="rough", episode_steps=4)
    env.state.age[:16] = 2
    tile, before = env.state.tile.copy(), drawn(env)
    still(env)
    assert same_bits([tile, *before.values()], [env.state.tile, *drawn(env).values()])
    assert still(env)[3].tolist() == [True] * 16 + [False] * 16
    moved = env.state.tile != tile
    assert not moved[16:].any() and moved[:16].sum() >= 10  # 1 in 16 draws the same
    for name in ("friction", "payload"):
        old, new = before[name], drawn(env)[name]
        assert (old[16:] == new[16:]).all() and (old[:16] != new[:16]).all()


# ---- rough ground ----


def test_no_ground_is_too_steep_to_stand_on():
    """Feet of friction 0.5 hold up to arctan 0.5 = 26.6 degrees: not a point of the roughest tile
    is steeper.

    15 cm with 4 cells per metre, as in other code of the lab, would have a fifth of its points
    steeper (D22).
    """
    for task in ("rough", "velocity", "curriculum"):
        slopes = np.gradient(make(1, task=task, tiles=1).ground, terrain.SPACING)
        assert np.hypot(*slopes).max() < 0.5
    slopes = np.gradient(make(1, task="rough", tiles=1, cells_per_m=4).ground, terrain.SPACING)
    assert (np.hypot(*slopes) > 0.5).mean() == pytest.approx(0.2, abs=0.05)


@pytest.mark.parametrize(
    "fields, expected",
    [
        (dict(task="rough"), [k / 100 for k in range(16)]),
        (dict(task="rough", tiles=4), [0.0, 0.05, 0.1, 0.15]),
        (dict(task="velocity"), [0.05] * 16),
    ],
    ids=str,
)
def test_roughness_of_the_tiles(fields, expected):
    """16 tiles: 0, 1, ... 15 cm for `rough`, 5 cm each for `velocity`; 4 tiles: 0, 5, 10, 15 cm;
    none on the plane.
    """
    ground = (env := make(64, **fields)).ground
    tiles = ground.reshape(120, len(expected), 120)
    assert tiles.max((0, 2)) - tiles.min((0, 2)) == pytest.approx(expected, abs=1e-12)
    assert (env.state.tile.min(), env.state.tile.max()) == (0, len(expected) - 1)
    assert make(1).ground is None


def test_settings_of_the_noise_reach_the_ground():
    """2 cells per metre: 0 every 10th point from the tile's corner, not every 5th as with 4."""
    coarse, fine = (
        make(1, task="velocity", **fields).ground[20:100, 20:100]
        for fields in (dict(cells_per_m=2), dict())
    )
    assert not coarse[::10, ::10].any() and coarse[5::10, 5::10].all()
    assert not fine[::5, ::5].any()


def rays(env, points):
    """Height of the ground [m] under the points (n, 2), by MuJoCo: a ray straight down on the floor
    alone.
    """
    model = go1.build_model(0.005, env.ground)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    floor, hit = [1, 0, 0, 0, 0, 0], np.zeros(1, np.int32)
    return np.array(
        [5 - mujoco.mj_ray(model, data, [*xy, 5], [0, 0, -1], floor, 1, -1, hit) for xy in points]
    )


@pytest.mark.parametrize("task", ["rough", "velocity"])
def test_mujoco_sees_the_same_ground(task):
    """Point (i, j) of the heights is at x = 0.05 j, y = 0.05 i: not mirrored, not turned, not
    shifted, right scale.

    2 um beside the point, so that no ray slips between two triangles.
    """
    env = make(1, task=task)
    i, j = np.random.default_rng(0).integers([[119], [1919]], size=(2, 200))
    seen = rays(env, np.stack([0.05 * j + 1e-6, 0.05 * i + 1e-6], -1))
    assert seen == pytest.approx(env.ground[i, j], abs=1e-5)


@pytest.mark.parametrize("task", ["rough", "velocity"])
def test_start_touches_rough_ground(task):
    """By MuJoCo's kinematics and rays: the lowest foot or knee, a ball of 2 cm, ends within 5 mm of
    the ground below.

    Not exactly there, because MuJoCo's ground is made of triangles. No contact is deeper than 5 mm.
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


def test_start_is_anywhere_on_the_tile():
    """The tile `index` reaches from 6 index + 1 to 6 index + 5 m in x and from 1 to 5 m in y; all
    16 are used.

    x and y of 256 robots are correlated by chance alone, by 1/16.
    """
    env = make(256, task="rough")
    xy = env.qpos[:, :2] - np.stack([6.0 * env.state.tile + 1, np.ones(256)], -1)
    assert ((xy >= 0) & (xy < 4)).all() and (xy.min(0) < 0.1).all() and (xy.max(0) > 3.9).all()
    assert abs(np.corrcoef(xy.T)[0, 1]) < 5 / 16
    assert sorted(set(env.state.tile)) == list(range(16))


@pytest.mark.parametrize(("speed", "steps"), [(3.0, 10), (1.0, 20)])
def test_the_seam(monkeypatch, speed, steps):
    """A robot that leaves its tile is put back and does not notice: its twin, on the same ground,
    stays on its own.

    The twin's tiles begin 2 m further on in x and in y, as periodic ground may, so that the edge is
    amid the twin's tile. Four robots on 5 cm run over the far and the near edge in x, the far one
    in y, and over a corner.
    """
    env = make(4, task="velocity")
    amid = 20 + (np.arange(120) + 20) % 80  # 20 points of apron, 80 of tile, each 40 points on
    heights = env.ground.reshape(120, 16, 120)[amid][:, :, amid].reshape(120, -1)
    monkeypatch.setattr(go1_env.terrain, "make_ground", lambda *_, **__: heights)
    twin = make(4, task="velocity")
    heading = np.array([[1, 0], [-1, 0], [0, 1], [-(0.5**0.5), -(0.5**0.5)]])
    corner = np.stack([6.0 * env.state.tile + 1, np.ones(4)], -1)
    for world, start in (
        (env, [[3.9, 3.0], [0.1, 3.0], [3.0, 3.9], [0.1, 0.1]]),
        (twin, [[1.9, 1.0], [2.1, 1.0], [1.0, 1.9], [2.1, 2.1]]),
    ):
        place(
            world,
            height=0.34,
            quaternion=np.array(
                [
                    [1, 0, 0, 0],
                    [0, 0, 0, 1],
                    [0.5**0.5, 0, 0, 0.5**0.5],
                    [cos(5 * pi / 8), 0, 0, sin(5 * pi / 8)],
                ]
            ),
        )
        world.qpos[:, :2], world.qvel[:, :2] = corner + start, speed * heading
    for action in random_actions(env, steps) / 2:
        (obs, reward, ended, _, info), (twins_obs, twins_reward, _, _, twins_info) = (
            env.step(action),
            twin.step(action),
        )
        assert not ended.any()
        assert obs == pytest.approx(twins_obs, abs=1e-6) and reward == pytest.approx(
            twins_reward, abs=1e-6
        )
        assert info["cost"] == pytest.approx(twins_info["cost"], abs=1e-3)
        assert env.qpos[:, 2:] == pytest.approx(twin.qpos[:, 2:], abs=1e-6)
        assert env.qvel == pytest.approx(twin.qvel, abs=1e-6)
    moved = env.qpos[:, :2] - twin.qpos[:, :2]
    # 2 m before, all in x or y
    assert moved == pytest.approx(np.array([[-2, 2], [2, 2], [2, -2], [2, 2]]), abs=1e-6)


def test_standing_on_a_height_field():
    """Ground of 1 um carries like a plane: soles sink in by 1 mm or, being stiffer there, less; the
    trunk is as high.

    Within 1 cm: a foot has more contacts with triangles than the one with a plane, and so slides
        apart more slowly.
    """
    plane, field = (
        make(2, task="rough", roughness=(high, high), friction=(0.8, 0.8), payload=(0.0, 0.0))
        for high in (0.0, 1e-6)
    )
    for env in (plane, field):
        place(env, height=0.34)
        still(env, 200)
        assert np.abs(env.qvel).max() < 0.1
    for a, b in zip(plane.qpos, field.qpos, strict=True):
        assert -0.0015 < soles(a).min() < soles(a).max() < 0 and soles(a) == pytest.approx(
            soles(b), abs=1e-3
        )
    assert (plane.qpos[:, 2] > 0.2).all() and plane.qpos[:, 2] == pytest.approx(
        field.qpos[:, 2], abs=0.01
    )


@pytest.mark.parametrize("task", tasks.TASKS)
def test_no_foot_sinks_in(task):
    """With the most friction and the most payload of a task, the soles of a robot that stands are 5
    mm deep at most.

    MuJoCo's pyramidal contacts give way the more friction they have: at 2 the soles are more than 1
    cm deep, and at 3, as in the lab's code, the shins touch the ground, which is a fall (D24).
    """
    settings = tasks.task_config(task)
    env = make(
        1,
        task=task,
        roughness=(0.0, 0.0),
        friction=settings.friction[1:] * 2,
        payload=settings.payload[1:] * 2,
    )
    place(env, height=0.31)
    assert not any(still(env)[2] for _ in range(100))
    assert -0.005 < soles(env.qpos[0]).min() < 0
    env.state.friction[:, env.feet, 0] = 2.0  # which no setting allows
    still(env, 50)
    assert soles(env.qpos[0]).min() < -0.01
    if env.rules.only_feet:
        env.state.friction[:, env.feet, 0] = 3.0
        assert any(still(env)[2] for _ in range(100))


@BOTH
def test_no_foot_is_caught_in_the_ground(roughness):
    """The centre of a foot that is pressed into the ground comes out again within 0.1 s, from a
    height field as well.

    There a centre below the surface may be nearer to the side of a prism than to its top, and is
    pushed along, not up.
    """
    env, below = make(64, task="rough", roughness=roughness), np.zeros((64, 4), int)
    for action in random_actions(env, 100):
        ended = env.step(action)[2]
        up = Rotation.from_quat(env.qpos[:, 3:7], scalar_first=True).as_matrix()[:, 2]
        centres = env.qpos[:, 2:3] + np.einsum(
            "nj,nkj->nk", up, go1.leg_points(env.qpos[:, 7:])[:, 1::2]
        )
        below = np.where((centres < 0) & ~ended[:, None], below + 1, 0)
        assert below.max() <= 5


# ---- what the tasks differ in: contacts and motors ----


SOME = ["velocity", "curriculum"]  # where nothing but the feet may touch the ground


@BOTH
@pytest.mark.parametrize(
    ("quaternion", "height", "q", "ends"),
    [
        (support.UPRIGHT, 0.4, NOMINAL, []),
        (support.UPRIGHT, 0.44, np.zeros(12), []),
        (support.UPRIGHT, 0.41, np.zeros(12), SOME),
        (support.UPRIGHT, 0.21, np.zeros(12), tasks.TASKS),
        (support.ON_ITS_BACK, 0.056, np.tile([0.0, 0.8, -1.5], 4), tasks.TASKS),
        (support.UPRIGHT, 0.056, np.tile([0.0, 3.0, -1.5], 4), tasks.TASKS),
        (support.ON_ITS_SIDE, 0.14, np.tile([0.0, 0.8, -1.5], 4), tasks.TASKS),
    ],
    ids=["in the air", "feet", "shins", "thighs", "back", "belly, legs up", "side, on the hips"],
)
@pytest.mark.parametrize("task", tasks.TASKS)
def test_what_may_touch_the_ground(task, quaternion, height, q, ends, roughness):
    """IV-A.3, D13. Legs straight, down from the trunk: soles 0.446 m, shins 0.413 m, thighs 0.217
    m.

    The trunk's half height is 0.057 m, a hip reaches 0.147 m to the side; 1 mm into the ground is a
    fall.
    """
    env = make(task=task, roughness=roughness, max_power=None, **FROZEN)
    place(env, q, height=height, quaternion=quaternion)
    _, _, terminated, truncated, info = still(env)
    assert terminated.tolist() == info["log"]["ended_fall"].tolist() == [task in ends] * 2
    assert not truncated.any() and not info["log"]["ended_diverged"].any()


@pytest.mark.parametrize("task", tasks.TASKS)
def test_self_contact_ends_nothing(task):
    """Hips 0.863 rad inward: right and left thigh cross at y = 0, 0.0988 / sin(0.863) = 0.13 m down
    their 0.2 m.

    0.04675 + 0.08 cos(0.863) = 0.0988 m is how far out a thigh begins.
    """
    env = make(task=task, max_power=None, **FROZEN)
    place(env, np.tile([0.863, 0.8, -1.5, -0.863, 0.8, -1.5], 2))
    _, _, terminated, _, info = still(env)
    assert not terminated.any() and not info["log"]["ended_diverged"].any()


@pytest.mark.parametrize(
    ("task", "expected"),
    [("flat", [17.475, 23.7, 35.55]), ("rough", [17.475, 23.7, 35.55]), ("velocity", [16.5] * 3)],
)
def test_torque_speed_limit_by_task(task, expected):
    """V-D: at half its largest speed, 30.1 / 2 or 20.06 / 2 rad/s, a joint gives 33 / 2 N m, on
    `velocity` alone.

    Action 10 asks for 20 * 1.25 - 0.5 * 15.05 = 17.475 (hips), 50 - 7.525 (thighs) and 50 - 5.015 N
    m (calves).
    """
    env = make(task=task, **FROZEN)
    place(env, qd=np.tile([15.05, 15.05, 10.03], 4))
    env.step(np.full((2, 12), 10.0))
    assert env.ctrl == pytest.approx(np.tile(expected, (2, 4)), abs=1e-3)


def test_torque_speed_limit_before_every_physics_step():
    """Four physics steps are four times one, bit by bit, while the limit sinks with each as the
    joints speed up.
    """
    four, one = (make(task="velocity", roughness=(0.0, 0.0), physics_steps=n) for n in (4, 1))
    place(four), place(one)
    action = np.full((2, 12), 4.0)
    four.step(action)
    for _ in range(4):
        one.step(action)
    assert same_bits([four.qpos, four.qvel, four.ctrl], [one.qpos, one.qvel, one.ctrl])


# ---- the curriculum's world ----


def test_latency_in_steps():
    """Six physics steps are one control step of four and a half: the motors feel a new target in
    the second one only.

    The joints rest at the old target, so that the torque is 20 * 0.25 N m once the new one arrives
    and 0 before.
    """
    env = quiet(latency=6)
    torques, step = [], env.batch.step
    env.batch.step = lambda: (torques.append(env.ctrl.copy()), step())
    for _ in range(2):
        env.step(QUARTER)
    assert np.array(torques)[:, 0, 0] == pytest.approx([0.0] * 6 + [5.0] * 2, abs=1e-6)


def test_motor_strength_and_offset():
    """Half the torque from motors of half strength; an encoder that reads 0.125 rad too much costs
    20 * 0.125 N m.
    """
    env = quiet(motor_strength=(0.5, 0.5), motor_offset=(0.125, 0.125))
    env.step(QUARTER)
    assert env.ctrl == pytest.approx(np.full((2, 12), 0.5 * 20 * (0.25 - 0.125)), abs=1e-6)


def test_a_strong_motor_is_limited_like_any_other():
    """Action 10 asks a hip for 20 * 1.25 * 1.1 = 27.5 N m; it gets the URDF's 23.7, not 1.1 times
    that.
    """
    env = quiet(motor_strength=(1.1, 1.1), max_power=None)
    env.step(np.full((2, 12), 10.0))
    assert env.ctrl[:, 0] == pytest.approx([23.7] * 2)


def test_motor_model_of_the_curriculum():
    """D11 with the torque-speed line: at 10 rad/s and no error -0.7 * 10; at half its top speed
    16.5 N m for a calf.
    """
    env = quiet(max_power=None)
    place(env, qd=10.0)
    still(env)
    assert env.ctrl == pytest.approx(np.full((2, 12), -7.0), abs=1e-4)
    place(env, NOMINAL - 1.5, qd=20.06 / 2)  # PD alone would pull with 30 - 7 N m
    still(env)
    assert env.ctrl[0, 2] == pytest.approx(16.5, abs=1e-4)


def test_added_gravity_makes_things_fall_elsewhere():
    """In the air for one control step of 20 ms: the trunk gains what gravity was drawn as, times
    0.02 s.
    """
    env = quiet(8, gravity=(-1.0, 1.0), timestep=0.005)
    still(env)
    assert env.qvel[:, :3] == pytest.approx(0.02 * env.state.gravity, abs=1e-9)


def test_gravity_is_seen_as_it_is_felt():
    """Gravity of (1, 1, -8.81) m/s^2 points along that, over its length: what an accelerometer
    tells a level robot.
    """
    felt = still(quiet(history=1, gravity=(1.0, 1.0)))[0][0, :3]
    assert felt == pytest.approx(np.array([1.0, 1.0, -8.81]) / (2 + 8.81**2) ** 0.5, abs=1e-6)


@pytest.mark.parametrize(("limit", "ends"), [(220.0, False), (200.0, True), (None, False)])
def test_power_limit(limit, ends):
    """D17, IV-A.4: 12 joints that rest at 5 N m heat with 0.7 * 25 * (8 + 4 * 4 / 9) W = 171 W, and
    42 W go elsewhere.

    That is 213 W: a limit of 220 W lets it pass, one of 200 W ends the episode, and None is no
        limit.
    """
    _, _, terminated, truncated, info = quiet(max_power=limit).step(QUARTER)
    assert info["log"]["power"] == pytest.approx([0.7 * 25 * (8 + 16 / 9) + 42] * 2, abs=1e-3)
    assert terminated.tolist() == info["log"]["ended_power"].tolist() == [ends] * 2
    assert not truncated.any() and not info["log"]["ended_fall"].any()


@pytest.mark.parametrize(("limit", "ends"), [(42.0, False), (np.nextafter(42.0, 0.0), True)])
def test_power_of_exactly_the_limit_ends_nothing(limit, ends):
    """IV-A.4. A robot at rest draws the 42 W of its electronics, to the bit. More than the limit
    ends an episode, the limit itself does not.
    """
    _, _, terminated, _, info = still(quiet(max_power=limit))
    assert info["log"]["power"].tolist() == [42.0] * 2
    assert terminated.tolist() == info["log"]["ended_power"].tolist() == [ends] * 2


@pytest.mark.parametrize(("limit", "ends"), [(130.0, False), (125.0, True)])
def test_power_limit_is_of_the_control_step(limit, ends):
    """D17. Six physics steps late, 5 N m come in the last two of the second control step's four:
    twice 42 W, twice 42 + 0.7 * 25 * (8 + 4 * 4 / 9) = 213 W, 127.6 W in the mean.

    A limit of 130 W, which the last two exceed by far, lets it pass; one of 125 W does not.
    """
    env = quiet(latency=6, max_power=limit)
    assert not env.step(QUARTER)[2].any()
    _, _, terminated, _, info = env.step(QUARTER)
    mean = 42 + 0.7 * 25 * (8 + 16 / 9) / 2
    assert info["log"]["power"] == pytest.approx([mean] * 2, abs=1e-3)
    assert terminated.tolist() == info["log"]["ended_power"].tolist() == [ends] * 2


def test_a_touch_in_one_physics_step_of_four_is_a_fall():
    """D36. Robot 0's trunk touches the ground in the first one alone. Feet that were up for long
    start anew with it.
    """
    env = quiet(reward="shaped")
    env.state.off_ground[:], env.contacts = 7, np.zeros((2, 17))
    touches = iter([1.0, 0.0, 0.0, 0.0])
    env.batch.step = lambda: env.contacts.__setitem__((0, 0), next(touches))
    _, _, terminated, _, info = still(env)
    assert terminated.tolist() == info["log"]["ended_fall"].tolist() == [True, False]
    assert env.state.off_ground.tolist() == [[1] * 4, [8] * 4]


@pytest.mark.parametrize(
    ("frame", "asked", "after"),
    [("heading", 1.0, 1.0), ("heading", 0.5, 0.25), ("body", 0.5, 1.0), ("body", 1.0, 0.25)],
)
def test_the_curriculum_counts_the_speed_of_the_reward(frame, asked, after):
    """D25. Nose up by 60 degrees, 1 m/s over ground, of which the trunk's v_x is 1/2. Asked for as
    much, in the frame of the reward, both robots succeed: 1/4 + 2 * 0.4 is at most 1. An error of
    1/2 counts 1 / e < 0.8.
    """
    env = quiet(command_steps=1, frame=frame)
    place(env, quaternion=(cos(pi / 6), 0, -sin(pi / 6), 0), velocity=(1, 0, 0))
    env.state.command_weights[:], env.state.cell[:], env.state.command[:] = (
        0.0,
        [2, 19],
        (asked, 0.0, 0.0),
    )
    env.state.command_weights[2, 19] = 0.25
    still(env)
    assert env.state.command_weights[2, 19] == after


@pytest.mark.parametrize(
    "command, episode_steps, grows",
    [
        ((0.0, 0.0, 0.0), 1000, True),
        ((1.0, 0.0, 0.0), 1000, False),
        ((0.0, 0.0, 2.0), 1000, False),
        ((0.0, 0.0, 0.0), 5, False),
    ],
    ids=["follows", "too slow", "turns wrongly", "half a segment"],
)
def test_curriculum_grows_where_the_robot_succeeds(command, episode_steps, grows):
    """Ten steps per command, robots that stand: sums of 10 * 1 are means of 1 > 0.8 and 0.5, one of
    5 * 1 is not.

    Both succeed in cell (2, 19): 0.3 + 2 * 0.4 is at most 1, its neighbours gain 2 * 0.2.
    """
    env = quiet(command_steps=10, episode_steps=episode_steps)
    env.state.command_weights[:], env.state.cell[:], env.state.command[:] = 0.0, [2, 19], command
    env.state.command_weights[2, 19] = 0.3
    before = env.state.command_weights.copy()
    log = still(env, 10)[4]["log"] if episode_steps > 10 else still(env, 5)[4]["log"]
    assert (
        log["command_area"] == pytest.approx(np.full(2, before.mean()))
        and not env.state.tracked.any()
    )
    assert (env.state.command_weights != before).any() == grows
    if grows:
        assert env.state.command_weights[2, 19] == 1.0 and env.state.command_weights[
            1, 18
        ] == pytest.approx(0.4)


def test_commands_of_the_curriculum_come_from_its_weights():
    """All the weight on cell (20, 5), v_x of 9 to 9.5 m/s and yaw of -7.5 to -7 rad/s: so are the
    next commands.
    """
    env = quiet(8, command_steps=1)
    env.state.command_weights[:], env.state.command[:] = 0.0, 5.0  # which nobody follows
    env.state.command_weights[20, 5] = 1.0
    still(env)
    assert (env.state.cell == [20, 5]).all()
    assert (env.state.command[:, 0] >= 9).all() and (env.state.command[:, 2] <= -7).all()


def test_shaped_reward_replaces_the_task_reward_and_keeps_it_in_the_log():
    """V-E. A robot that hangs still 10 cm too high: 1.5 for the command 0, less 30 * 0.1^2 for its
    height.
    """
    env = quiet(reward="shaped")
    place(env, height=0.44)
    env.state.command[:] = 0.0
    _, reward, _, _, info = still(env)
    assert reward == pytest.approx([1.5 - 30 * 0.01] * 2, abs=1e-3)
    assert info["log"]["task_reward"] == pytest.approx([1.5] * 2, abs=1e-6)


def seen_by_the_shaped_reward(env, action=0.0, qd=0.0):
    """The shaped.Motion of env now; action, qd: what they were a control step ago."""
    return shaped.observe(
        env, env.tracked_velocity("heading"), np.full((env.num_envs, 12), action), qd
    )


def test_what_the_shaped_reward_sees_of_the_trunk():
    """Rough ground, robots on their right side, which is -y: the body's y is up, and its z the
    world's -y.

    They roll at 1, pitch at 2 and yaw at 4 rad/s, move at 8, 16, 32 m/s in the world and so at -16
    along the body's z. Heights are above the ground below, as MuJoCo's rays find it there; 0.25 m
    on a height field of 15 cm.
    """
    env = make(8, task="rough", roughness=(0.15, 0.15), reward="shaped")
    place(env, quaternion=support.ON_ITS_SIDE, velocity=(8, 16, 32), rates=(1, 2, 4))
    ground = rays(env, env.qpos[:, :2])
    env.qpos[:, 2] = ground + 0.25
    seen = seen_by_the_shaped_reward(env)
    assert np.ptp(ground) > 0.03
    assert seen.height == pytest.approx(np.full(8, 0.25), abs=2e-3)
    assert (seen.roll_pitch_rate == [1, 2]).all() and seen.v_z == pytest.approx(np.full(8, -16))
    assert seen.gravity == pytest.approx(np.tile([0.0, -1.0, 0.0], (8, 1)), abs=1e-9)


def test_what_the_shaped_reward_sees_of_joints_and_actions():
    """Speeds rise from 1/4 to 1 rad/s and actions from 1 to 4 in a step of 20 ms: 37.5 rad/s^2, and
    a change of 3.
    """
    env = make(reward="shaped")
    place(env, q=NOMINAL + 0.125, qd=1.0)
    env.state.action[:], env.ctrl[:] = 4.0, 7.0
    seen = seen_by_the_shaped_reward(env, action=1.0, qd=0.25)
    assert seen.qdd == pytest.approx(np.full((2, 12), 37.5)) and (seen.action_change == 3).all()
    assert (seen.torque == 7).all() and (seen.q == NOMINAL + 0.125).all()
    assert seen.joint_range.tolist() == [[-0.863, -0.686, -2.818] * 4, [0.863, 4.501, -0.888] * 4]


def test_what_the_shaped_reward_sees_of_contacts():
    """Robot i of 17 touches the ground with sensor i alone, robot 17 with all: 4 thighs and 4
    calves are collisions.

    A foot that touches it now was up for as many steps of 20 ms as counted: FR 2, FL 3, RR 4, RL 5.
    """
    env, robot = make(18, reward="shaped"), mujoco.MjModel.from_xml_path(str(go1.MODEL))
    parts = [robot.sensor(i).name for i in range(17)]
    env.contacts, env.state.off_ground[:] = np.vstack([2 * np.eye(17), np.ones(17)]), [2, 3, 4, 5]
    seen, feet = (
        seen_by_the_shaped_reward(env),
        [parts.index(f"{leg}_foot_contact") for leg in LEGS],
    )
    assert seen.collisions.tolist() == [
        float("thigh" in part or "calf" in part) for part in parts
    ] + [8]
    assert seen.landed[[*feet, 17]] == pytest.approx(
        np.vstack([np.diag([0.04, 0.06, 0.08, 0.1]), [0.04, 0.06, 0.08, 0.1]])
    )
    assert not np.delete(seen.landed, [*feet, 17], axis=0).any()


def test_air_time_counts_from_take_off_to_landing(monkeypatch):
    """After three steps in the air feet that land were up for 4 * 20 ms; then the clock starts
    anew, a step late.

    A foot that is off the ground for one step only has not left it [lab code].
    """
    env = quiet(reward="shaped", max_power=None, timestep=0.005)
    seen, observe = [], shaped.observe
    monkeypatch.setattr(shaped, "observe", lambda *x: seen.append(observe(*x)) or seen[-1])
    for height in (1.0, 1.0, 1.0, 0.305, 1.0, 0.305, 1.0, 1.0):
        place(env, height=height)
        still(env)
    landed = np.array([m.landed[0] for m in seen])
    assert landed == pytest.approx(np.array([[0.0] * 4] * 3 + [[0.08] * 4] + [[0.0] * 4] * 4))
    assert env.state.off_ground[0].tolist() == [2] * 4
