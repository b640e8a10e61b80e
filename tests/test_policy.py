"""policy.py: what policy.npz promises, kept by every committed file."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from support import NOMINAL, ROOT, error_of, make_run

import evaluate
import go1
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
    next good one finds everything finite. At the start there is none: the target is some pose.
    """
    pi, _ = run_folder.load_policy(make_run(tmp_path) / "policy.npz")
    good = [0.0, 0.0, -1.0], [0.5, 0.0, 0.0], NOMINAL, np.zeros(12)
    bad = *good[:3], np.full(12, np.nan)
    first, target = pi.act(*good), pi.act(*bad)
    assert np.isfinite(target).all() and np.isfinite(pi.action).all()
    assert np.array_equal(pi.frames[-1], pi.frames[-2])
    assert np.isfinite(pi.act(*good)).all() and np.isfinite(np.concatenate(pi.frames)).all()
    pi.start()
    assert np.isfinite(pi.act(*bad)).all() and not pi.frames[0].any()
    pi.start()
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
    assert made.about == {} and run_folder.load_policy(COMMITTED[0])[0].about == {}


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


def test_the_lines_of_deploy_md_run(tmp_path, monkeypatch):
    make_run(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/deploy.md").read_text(), re.S)
    monkeypatch.chdir(tmp_path)
    exec(code, names := {})
    assert names["target"].shape == names["torque"].shape == (12,)
