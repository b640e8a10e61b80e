"""policy_file.py: docs/deploy.md, and nothing else of ours, turns the sensors of a trace into its
joint targets.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import ROOT, make, make_run, place

import go1
import go1_env
from runtime import policy_file, run_folder

SENSORS = ("time", "gravity", "command", "q", "qd")
WIDTHS = dict(gravity=3, command=3, q=12, qd=12, frame=44, estimate=3, action=12, target=12)
COMMITTED = [  # the policies in the repository
    "results/flat",
    "results/rough",
    "results/velocity",
    "results/curriculum",
]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two run folders with untrained policies, whose answers are so large that some of them are
    clipped.
    """
    base = tmp_path_factory.mktemp("runs")
    folders = {task: make_run(base / task, task) for task in ("flat", "curriculum")}
    for folder in folders.values():
        params, env_cfg = policy_file.load(folder / "policy.npz")
        last = params["actor"]["layers"][-1]
        params["actor"]["layers"][-1] = last._replace(even=15 * last.even)
        policy_file.save(folder / "policy.npz", params, env_cfg)
    return folders


def trace_of(path):
    """The trace in a policy.npz: {"time": (50,), "gravity": (50, 3), ...}."""
    arrays = run_folder.read_npz(path)
    return {
        name.removeprefix("trace."): x for name, x in arrays.items() if name.startswith("trace.")
    }


def deployed(folder, monkeypatch):
    """The names that the lines of docs/deploy.md define in a folder with a policy.npz."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/deploy.md").read_text(), re.S)
    monkeypatch.chdir(folder)
    names = {}
    exec(code, names)
    return names


@pytest.mark.parametrize("name", ["flat", "curriculum", *COMMITTED])
def test_the_lines_of_deploy_md_follow_the_trace(runs, monkeypatch, name):
    """From sensors alone: frames, and the last target in them, are the lines' own. Rounded to
    float32, in N m 0.002.
    """
    folder = runs.get(name, ROOT / name)
    theirs, trace = deployed(folder, monkeypatch), trace_of(folder / "policy.npz")
    for k, time in enumerate(trace["time"]):
        if time == 0:
            target, frames = theirs["p"]["q_nominal"], []
        frame = theirs["frame"](*(trace[sensor][k] for sensor in SENSORS), target)
        np.testing.assert_allclose(
            frame, trace["frame"][k], rtol=1e-5, atol=1e-4, err_msg=f"step {k}"
        )
        frames = [*frames[1:], frame] if frames else [frame] * theirs["config"]["history"]
        target = theirs["policy"](np.array(frames))
        np.testing.assert_allclose(
            target, trace["target"][k], rtol=0, atol=1e-4, err_msg=f"step {k}"
        )
    theirs["p"].close()


@pytest.mark.parametrize("task", ["flat", "curriculum"])
def test_the_trace_is_what_the_simulation_did(runs, task):
    """The actions of the trace, played once more, make the readings of the trace: 50 steps of 20
    ms, no noise.
    """
    path = runs[task] / "policy.npz"
    trace, (_, env_cfg) = trace_of(path), policy_file.load(path)
    env = go1_env.Go1Env(
        1, replace(env_cfg, noise=0.0, stagger=False, tiles=1, episode_steps=10**9)
    )
    obs, _ = env.reset(0, [1, 0, 0])
    assert {name: x.shape for name, x in trace.items()} == dict(time=(50,)) | {
        n: (50, w) for n, w in WIDTHS.items()
    }
    assert all(x.dtype == np.float32 for x in trace.values())
    for k in range(50):
        np.testing.assert_allclose(
            trace["frame"][k] * go1_env.FRAME_SCALE, obs[0, -44:], rtol=1e-5, atol=1e-6
        )
        if k and trace["time"][k]:  # a step before which no episode ended
            np.testing.assert_allclose(trace["q"][k], env.qpos[0, 7:], atol=1e-4)
            np.testing.assert_allclose(trace["qd"][k], env.qvel[0, 6:], atol=1e-2)
        obs, *_ = env.step(trace["action"][[k]])
    beyond = np.abs(trace["action"]) == 10
    assert 0 < beyond.mean() < 1 and (trace["time"] > 0).sum() > 20


@pytest.mark.parametrize(
    "turn, entry, sign", [([0, -0.3, 0], 0, -1), ([0.3, 0, 0], 1, -1), ([0, 0, 0.3], 2, -1)]
)
def test_signs_of_gravity(turn, entry, sign):
    """Turned about -y the nose goes up, about +x the right side down; a turn about z changes
    nothing.
    """
    env = make(1)
    place(env, quaternion=Rotation.from_rotvec(turn).as_quat(scalar_first=True))
    gravity = env.felt_gravity()[0]
    assert np.sign(gravity[entry]) == sign
    others = np.delete(gravity, [entry, 2])
    np.testing.assert_allclose(others, 0, atol=1e-12)


def test_signs_of_joints():
    """Straight legs point down. A positive hip moves a foot to the left (+y), a positive thigh
    moves it back (-x).
    """
    feet = lambda q: go1.leg_points(np.tile(q, 4)).reshape(4, 2, 3)[:, 1]  # noqa: E731
    straight = feet([0.0, 0, 0])
    np.testing.assert_allclose(straight[:, 2], -2 * go1.LINK)
    assert (feet([0.1, 0, 0])[:, 1] > straight[:, 1]).all() and (
        feet([0, 0.1, 0])[:, 0] < straight[:, 0]
    ).all()
    assert (make(1).joint_range[1, 2::3] < 0).all()  # a calf's angle is always negative


def test_the_estimate_is_the_velocity_of_the_trunk(tmp_path):
    """An estimator whose answer is (1, 2, 3) m/s whatever it sees: the trace has it, and the actor
    saw it.
    """
    params, env_cfg = policy_file.load(make_run(tmp_path) / "policy.npz")
    last = params["estimator"][-1]
    params["estimator"][-1] = last._replace(
        even=0 * last.even, bias=np.array([1, 2, 3], np.float32)
    )
    assert policy_file.trace(params, env_cfg)["trace.estimate"].tolist() == [[1, 2, 3]] * 50


# ---- older policies ----


def test_an_older_policy_runs_without_a_trace(tmp_path):
    path = make_run(tmp_path) / "policy.npz"
    arrays = {
        name: x for name, x in run_folder.read_npz(path).items() if not name.startswith("trace.")
    }
    np.savez(path, **arrays)
    assert policy_file.load(path)[1].task == "flat" and trace_of(path) == {}
