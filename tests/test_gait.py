"""gait.py: the names of footfall patterns made by hand, and what a Record of real
robots adds up to.
"""

import csv
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from PIL import Image
from support import error_of, make, make_run, same_bits

import energy
import evaluate
import go1
import go1_env
import tasks
from lab import gait
from lab.__main__ import main

DT = 0.005  # s, a physics step
LAGS = np.array(
    [
        [0, 0.5, 0.5, 0],
        [0, 0.5, 0, 0.5],
        [0, 0.5, 0.75, 0.25],
        [0, 0.5, 0.25, 0.75],
        [0, 0, 0, 0],
        [0, 0, 0.5, 0.5],
        [0, 0.2, 0.5, 0.7],
        [0, 0.2, 0.5, 0.5],
        [0, 0.5, 0, 0],
    ]
)
NAMES = ("trot", "pace", "walk", "walk", "pronk", "bound", "gallop", "gallop", "none")
PATTERNS = list(zip(LAGS, NAMES, strict=True))


def footfalls(phases, hz=2.5, duty=0.4, seconds=4.0):
    """Contacts (T, 4): foot f is down while its turn, t hz - phase, is within the first `duty` of a
    stride.
    """
    turns = hz * DT * np.arange(round(seconds / DT))[:, None] - np.asarray(phases) + 1e-9
    return turns % 1 < duty


# ---- from contacts to a name ----


@pytest.mark.parametrize("turned", [0.0, 0.3, 0.96])
@pytest.mark.parametrize("phases, name", PATTERNS)
def test_names_of_gaits(phases, name, turned):
    """Hildebrand's patterns, wherever a stride is said to begin; so are they with right and left
    exchanged.
    """
    for at in (phases, phases[[1, 0, 3, 2]]):
        assert gait.gait_name((at + turned) % 1) == name


@pytest.mark.parametrize(
    "phases, below, above",
    [
        # front feet follow hind feet by 3/8: between 1/4 and 1/2
        ([0, 0.5, 0.625, 0.125], "walk", "trot"),
        ([0, 0.5, 0.875, 0.375], "pace", "walk"),
        ([0, 0, 0.125, 0.125], "pronk", "bound"),
    ],
)
def test_the_rule_between_two_names(phases, below, above):
    """1 % of a stride to either side of its edge."""
    step = np.array([0, 0, 0.01, 0.01])
    names = [gait.gait_name((phases + sign * step) % 1) for sign in (-1, 1)]
    assert sorted(names) == sorted([below, above]) and names[0] != names[1]


@pytest.mark.parametrize(
    "fl, name", [(0.12, "bound"), (0.13, "gallop"), (0.37, "gallop"), (0.38, "none")]
)
def test_a_pair_is_together_up_to_an_eighth_and_alternates_from_three_eighths(fl, name):
    """Hind feet together, half a stride behind the middle of the front feet."""
    assert gait.gait_name([0, fl, 0.5 + fl / 2, 0.5 + fl / 2]) == name


@pytest.mark.parametrize(
    "hz, duty", [(2.5, 0.4), (2.5, 0.75), (6.25, 0.5), (10.0, 0.25), (1.25, 0.6)]
)
@pytest.mark.parametrize("phases, name", PATTERNS)
def test_a_pattern_is_read_as_it_was_made(phases, name, hz, duty):
    """Strides of whole numbers of steps of 5 ms, whose stances may be rounded to one: up to 5 ms of
    100 ms at 10 Hz.
    """
    found, frequency, lags = gait.strides(footfalls(phases, hz, duty), DT)
    assert (found, frequency) == (name, pytest.approx(hz, abs=0.06))
    away = (lags - phases + 0.5) % 1 - 0.5
    np.testing.assert_allclose(away, 0, atol=DT * hz)


def test_a_pattern_of_whole_steps_is_exact():
    """80 steps a stride, lags of 40 and 20 of them."""
    contact = footfalls([0, 0.5, 0.75, 0.25], duty=0.5)
    phases, agreement = gait.foot_phases(contact, 2.5, DT)
    np.testing.assert_allclose(phases, [0, 0.5, 0.75, 0.25], atol=1e-9)
    np.testing.assert_allclose(agreement, 1, atol=1e-9)
    assert contact.mean(0).tolist() == [0.5] * 4


def test_bouncing_feet_and_drifting_strides_have_the_same_name():
    """Every foot loses contact for 5 ms, in a fifth of the samples; the stride takes 5 % more time
    at the end.
    """
    time = np.linspace(0, 4, 800)
    turns = 5 * (time - 0.05 * time**2 / 8)[:, None] - LAGS[2]
    contact = (turns % 1 < 0.6) & (np.random.default_rng(0).random((800, 4)) < 0.8)
    name, frequency, _ = gait.strides(contact, DT)
    assert name == "walk" and 4.75 < frequency < 5


@pytest.mark.parametrize("still", [True, False])
def test_a_foot_that_takes_no_step_has_no_gait(still):
    """Standing, or on three legs."""
    contact = footfalls(LAGS[0])
    contact[:, 2] = still
    name, frequency, phases = gait.strides(contact, DT)
    assert name == "none" and np.isnan(frequency) and np.isnan(phases).all()


def test_without_a_rhythm_there_is_no_gait():
    """Each foot changes at random, every 100 ms on average; or the hind feet step faster than the
    front feet.
    """
    rng = np.random.default_rng(0)
    names = {
        gait.strides(np.cumsum(rng.random((800, 4)) < 0.05, 0) % 2 == 1, DT)[0] for _ in range(20)
    }
    assert names == {"none"}
    assert (
        gait.strides(np.hstack([footfalls([0, 0.5]), footfalls([0, 0.5], hz=3.5)]), DT)[0] == "none"
    )


# ---- of robots ----


@pytest.fixture(autouse=True)
def short(monkeypatch, tmp_path):
    """0.04 s to settle and 0.4 s to measure."""
    monkeypatch.setattr(gait, "SETTLE", 2)
    monkeypatch.setattr(gait, "WINDOW", 20)
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    base = tmp_path_factory.mktemp("runs")
    return {
        task: make_run(base / task, task, action=0.0)
        for task in ("flat", "rough", "velocity", "curriculum")
    }


@pytest.fixture(scope="module")
def seen(runs):
    """The env and the Record of three robots that hold their nominal pose on rough ground."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gait, "SETTLE", 2)
        patch.setattr(gait, "WINDOW", 20)
        policy, env = evaluate.load(runs["rough"], 3)
        return env, gait.record(policy, env, np.tile([0.5, 0, 0], (3, 1)))


def test_the_power_of_the_legs_adds_up_to_that_of_the_robot(seen):
    """20 control steps of four physics steps; all but 42 W of the battery, to float32."""
    env, record = seen
    legs = gait.leg_power(record, env.env_cfg.clip)
    assert legs.shape == (80, 3, 4)
    np.testing.assert_allclose(
        legs.sum(-1).reshape(20, 4, 3).mean(1) + energy.BATTERY, record.power, rtol=1e-4
    )


def test_a_record_is_of_the_world_that_the_env_is_in(seen):
    """The last physics step: torques are those that the env still has, height is above ground."""
    env, record = seen
    np.testing.assert_allclose(record.torque[-1], env.ctrl, rtol=1e-6)
    assert (record.contact[-1] == (env.contacts[:, 13:] > 0)).all() and record.contact.any()
    assert (np.abs(record.body[-1, :, 0] - 0.3) < 0.15).all() and record.upright.dtype == bool


def test_watching_changes_nothing(runs):
    """Bit by bit, with and without a record of it."""
    ends = []
    for watched in (False, True):
        policy, env = evaluate.load(runs["flat"], 2)
        if watched:
            gait.record(policy, env, np.tile([0.5, 0, 0], (2, 1)))
        else:
            steps = evaluate.steps(policy, env, np.tile([0.5, 0, 0], (2, 1)))
            for _ in range(22):
                next(steps)
        ends.append([env.qpos.copy(), env.qvel.copy(), env.state.frames.copy()])
    assert same_bits(*ends)


def fake_record(n=4, fell=(), hz=2.5):
    """n robots that trot at 0.5 m/s with 100 W, but robot 0, which bounds, with every joint's
    torque at its limit.
    """
    contact = np.stack([footfalls(LAGS[5 if i == 0 else 0], hz) for i in range(n)], 1)
    x, c = np.zeros((800, n, 12), np.float32), np.ones((200, n))
    torque = x + np.where(np.arange(n)[:, None] == 0, go1.TORQUE_LIMIT, 1).astype(np.float32)
    body = np.stack([0.3 * c, 2 * c, -c], -1)
    upright = ~np.isin(np.arange(n), fell)
    return gait.Record(contact, x + 3, torque, body, 0.5 * c, 100 * c, upright)


def test_a_row_by_hand():
    """100 W at 0.5 m/s are 200 J/m; with 100 N that is a cost of transport of 2. Of four robots
    three trot.
    """
    row, shown = gait.gait_row(fake_record(), np.full(4, 100.0), tasks.task_config())
    assert (row["gait"], row["share"], shown) == ("trot", 0.75, 1)
    assert [row[x] for x in ("v_x", "power", "energy", "cost_of_transport")] == [0.5, 100, 200, 2]
    assert [row[x] for x in ("height", "pitch", "roll")] == pytest.approx([0.3, 2, -1])
    assert [row[f"duty_{leg}"] for leg in go1.LEGS] == pytest.approx([0.4] * 4)
    assert [row[f"phase_{leg}"] for leg in go1.LEGS] == pytest.approx([0, 0.5, 0.5, 0], abs=1e-6)
    assert row["stride_hz"] == pytest.approx(2.5, abs=0.03)
    assert [row[x] for x in ("stride_hz_sd", "v_x_sd", "duty_sd")] == pytest.approx([0, 0, 0])
    assert row["flight"] == pytest.approx(0.2)  # two stances of 0.4, half a stride apart


def test_the_weight_is_that_of_the_robot_with_its_payload(monkeypatch):
    """200 J/m by the weight of the robot in go1.xml and of 3 kg on it, at 9.81 m/s^2."""
    env = make(4, payload=(3.0, 3.0))
    mass = mujoco.MjModel.from_xml_path(str(go1.MODEL)).body_mass.sum()
    monkeypatch.setattr(gait, "played", lambda *_: [(Path("run"), 0.5, env, fake_record())])
    ((row,), _) = gait.gait(None, None)
    assert 10 < mass < 15 and row["energy"] == 200
    assert row["cost_of_transport"] == pytest.approx(200 / ((mass + 3) * 9.81), rel=1e-12)


def test_robots_that_fell_do_not_count():
    row, shown = gait.gait_row(fake_record(fell=(1, 2, 3)), np.full(4, 100.0), tasks.task_config())
    assert (row["gait"], row["share"], shown) == ("bound", 1, 0)
    row, _ = gait.gait_row(fake_record(fell=range(4)), np.full(4, 100.0), tasks.task_config())
    assert (
        row["gait"] == "none"
        and np.isnan([row["stride_hz"], row["v_x"], row["duty_FR"], row["power_RL"]]).all()
    )


# ---- the commands ----


def table(path):
    with open(path) as file:
        return list(csv.DictReader(file))


def test_files_of_the_command(runs, capsys):
    """Two runs: by default three commands for one, and the only one of the other."""
    argv = ["gait", runs["flat"], runs["velocity"], "--episodes", 6, "--out", "out"]
    assert main([str(x) for x in argv]) == 0
    assert [row["v_x_asked"] for row in table("out/gait.csv")] == ["0.3", "0.6", "1", "0"]
    with Image.open("out/gait.png") as image:
        assert len(image.convert("RGB").getcolors(2**24)) > 100, "the figure is blank"
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "task, v_x, warns",
    [
        ("flat", 1.5, True),
        ("flat", -0.1, True),
        ("flat", 1.0, False),
        ("velocity", 0.5, True),
        ("curriculum", 1.5, False),
    ],
)
def test_a_command_that_was_not_trained_is_a_warning(runs, capsys, task, v_x, warns):
    """Section IV-A: 0 to 1 m/s on flat ground, none for velocity, up to 10 m/s with the
    curriculum.
    """
    args = SimpleNamespace(
        command=[v_x], episodes=1, clip=None, roughness=0.0, world=go1_env.Go1Env
    )
    ((_, asked, env, _),) = gait.played([runs[task]], args)
    assert asked == v_x and env.state.command.tolist() == [[v_x, 0, 0]]
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == warns and all(
        str(v_x) in line and str(runs[task]) in line for line in lines
    )


@pytest.mark.parametrize("v_x", ["nan", "inf"])
def test_a_command_that_is_no_number_is_one_line(runs, capsys, v_x):
    assert "--command" in error_of(capsys, main, "gait", runs["flat"], "--command", v_x)
