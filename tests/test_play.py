"""play.py, and the policy outside of this project: docs/deploy.md, a GIF, the viewer, and the
ground that is drawn.
"""

import ctypes.util
import itertools
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager, nullcontext

import glfw
import jax
import mujoco
import numpy as np
import pytest
from PIL import Image
from support import DAMAGES, ROOT, contents, error_of, full_disk, make_run, started

import go1
import go1_env
import networks
import play
import tasks
import terrain
from runtime import policy_file, run_folder

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")
# it has set this for itself; processes that other tests start must not inherit it
if play.HEADLESS:
    os.environ.pop("MUJOCO_GL", None)
HEADLESS = {name: x for name, x in os.environ.items() if name not in DISPLAYS}
needs_gl = pytest.mark.skipif(
    not (ctypes.util.find_library("EGL") or ctypes.util.find_library("OSMesa")),
    reason="needs libegl1 or libosmesa6",
)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A run folder of three tasks."""
    base = tmp_path_factory.mktemp("runs")
    return {task: make_run(base / task, task) for task in ("flat", "rough", "velocity")}


# ---- the policy elsewhere ----


def test_the_lines_in_deploy_md_are_the_policy(runs, tmp_path, monkeypatch):
    """Random frames in SI units: q_nominal + scale * clip(mean of networks.policy). The last layer
    is so large that about half of the actions are beyond +- 10, so that the clip is part of it; 10
    * 0.25 rad is computed to 1e-5."""
    params, env_cfg = policy_file.load(runs["velocity"] / "policy.npz")
    params["actor"]["layers"][-1] = jax.tree.map(lambda x: 40 * x, params["actor"]["layers"][-1])
    policy_file.save(tmp_path / "policy.npz", params, env_cfg)
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/deploy.md").read_text(), re.S)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(code, names)
    rng, beyond = np.random.default_rng(0), []
    for _ in range(20):
        frames = rng.normal(size=(2, 44)) * np.where(go1_env.FRAME_SCALE < 0.1, 10, 1)
        obs = (frames * go1_env.FRAME_SCALE).astype(np.float32).ravel()
        action = np.asarray(networks.policy(params, obs)[0])
        beyond.append(np.abs(action) > 10)
        expected = go1.Q_NOMINAL + 0.25 * np.tile([0.5, 1, 1], 4) * np.clip(action, -10, 10)
        np.testing.assert_allclose(names["policy"](frames), expected, rtol=0, atol=1e-5)
    names["p"].close()
    assert 0.2 < np.mean(beyond) < 0.8


def test_what_the_other_side_needs_is_in_the_file(runs):
    """torque = kp (target - q) - kd qd with the Go1's 20 and 0.5, 200 times a second, and the
    policy 50 times.
    """
    arrays = run_folder.read_npz(runs["flat"] / "policy.npz")
    env_cfg = policy_file.load(runs["flat"] / "policy.npz")[1]
    assert (arrays["kp"], arrays["kd"]) == (20.0, 0.5)
    assert (1 / env_cfg.timestep, env_cfg.physics_steps) == (200.0, 4)


def test_training_loads_nothing_to_look_at_it():
    """A cluster's node has no display. glfw comes with `import mujoco`, which this project does not
    control.
    """
    heavy = ("play", "mujoco.viewer", "mujoco.renderer", "OpenGL", "PIL", "matplotlib")
    code = f"import sys, train; print([name for name in {heavy} if name in sys.modules])"
    said = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=HEADLESS,
        capture_output=True,
        text=True,
        check=True,
    )
    assert said.stdout == "[]\n"


# ---- without a display ----


@pytest.fixture(scope="module")
def gifs(runs, tmp_path_factory):
    """A folder with flat.gif, velocity.gif and slow.gif, all made by one process (starting one
    takes long).
    """
    folder = tmp_path_factory.mktemp("gifs")
    argvs = [
        [str(runs[task]), "--gif", f"{folder / task}.gif", "--seconds", "0.3"]
        for task in ("flat", "velocity")
    ]
    argvs += [
        [
            str(runs["flat"]),
            "--gif",
            f"{folder}/slow.gif",
            "--seconds",
            "0.1",
            "--slow",
            "4",
            "--forces",
        ]
    ]
    code = f"import play; print([play.main(argv) for argv in {argvs}])"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=HEADLESS, capture_output=True, text=True
    )
    assert (done.stdout, done.stderr) == ("[0, 0, 0]\n", "")
    return folder


@needs_gl
@pytest.mark.parametrize("task", ["flat", "velocity"])
def test_a_gif_needs_no_display(gifs, task):
    """A step is 20 ms: 0.3 s are 15 steps, every third is drawn, so 5 frames of 60 ms."""
    with Image.open(gifs / f"{task}.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"]) == (5, (480, 270), 0)
        frames, durations = [], []
        for i in range(gif.n_frames):
            gif.seek(i)
            durations.append(gif.info["duration"])
            frames.append(np.asarray(gif.convert("RGB"), int)[30:])  # without the caption
    assert durations == [60] * 5
    assert all(frame.std(axis=(0, 1)).min() > 5 for frame in frames), "nothing but one colour"
    assert all((np.abs(a - b).sum(-1) > 30).sum() > 50 for a, b in itertools.pairwise(frames)), (
        "nothing moves"
    )


@needs_gl
def test_a_slow_gif_has_every_step_and_forces(gifs):
    """0.1 s are five steps of 20 ms, each shown for 80 ms. The arrows are of a colour that nothing
    else has.
    """
    with Image.open(gifs / "slow.gif") as slow, Image.open(gifs / "flat.gif") as flat:
        assert (slow.n_frames, slow.info["duration"]) == (5, 80)
        orange = [
            (np.asarray(gif.convert("RGB"), int) @ [1, 0, -1] > 120).sum() for gif in (slow, flat)
        ]
    assert orange[0] > 10 and orange[1] == 0


BARE = """
import ctypes.util, sys
find = ctypes.util.find_library
ctypes.util.find_library = lambda name: None if name in ("EGL", "OSMesa") else find(name)
import play
print([play.main([sys.argv[1], *argv]) for argv in ([], ["--gif", sys.argv[2]])])
"""


def test_without_opengl_two_lines_say_what_to_do(runs, tmp_path):
    """A container without display and without libraries: no traceback, but what to add and what to
    install.
    """
    command = [sys.executable, "-c", BARE, runs["flat"], tmp_path / "a.gif"]
    done = subprocess.run(command, cwd=ROOT, env=HEADLESS, capture_output=True, text=True)
    window, gif = done.stderr.splitlines()
    assert done.stdout == "[2, 2]\n" and "--gif" in window and "libegl1" in gif


@pytest.mark.skipif(sys.platform != "linux", reason="displays have names on Linux")
@pytest.mark.parametrize(
    "name, value", [("DISPLAY", ":4321"), ("WAYLAND_DISPLAY", "gone"), ("MUJOCO_GL", "glfw")]
)
@pytest.mark.parametrize("gif", [[], ["--gif", "a.gif"]], ids=["window", "gif"])
def test_a_display_that_does_not_answer_is_one_line(
    runs, tmp_path, capsys, monkeypatch, name, value, gif
):
    """A connection that is gone, as tmux and screen keep it in DISPLAY. GLFW warns, and MuJoCo ends
    the process.
    """
    for display in DISPLAYS:
        monkeypatch.delenv(display, raising=False)
    monkeypatch.setenv(name, value)
    monkeypatch.setattr(play, "make_scene", None)
    monkeypatch.chdir(tmp_path)
    says = error_of(capsys, play.main, runs["flat"], *gif)
    assert "--gif" in says and "DISPLAY" in says and not list(tmp_path.iterdir())


def test_a_backend_that_mujoco_does_not_have_is_one_line():
    """It is an error of `import mujoco` itself."""
    command = [sys.executable, ROOT / "play.py", "-h"]
    done = subprocess.run(
        command, env=HEADLESS | dict(MUJOCO_GL="foo"), capture_output=True, text=True
    )
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2 and line.startswith("play.py: MUJOCO_GL=foo ") and "unset" in line


def test_a_full_disk_is_told_before_anything_is_drawn_and_keeps_the_old_gif(
    runs, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(play, "make_scene", None)
    (tmp_path / "a.gif").write_bytes(b"before")
    with full_disk(10_000):
        assert "a.gif" in error_of(capsys, play.main, runs["flat"], "--gif", tmp_path / "a.gif")
    assert contents(tmp_path) == {"a.gif": b"before"}


class FakeRenderer(nullcontext):
    """mujoco.Renderer without OpenGL: frames of noise, which a GIF cannot make small."""

    def __init__(self, model, height, width):
        self.shape, self.rng, self.enter_result = (height, width, 3), np.random.default_rng(0), self

    def update_scene(self, data, camera, options):
        """Noise needs no scene."""

    def render(self):
        return self.rng.integers(256, size=self.shape, dtype=np.uint8)


def test_a_gif_says_how_often_the_robot_fell(env, tmp_path, monkeypatch):
    """0.2 s are ten steps, in the second and seventh of which it falls."""
    monkeypatch.setattr(mujoco, "Renderer", FakeRenderer)
    steps = [
        dict(v_x=np.zeros(1), power=np.zeros(1), ended_fall=np.array([i in (1, 6)]))
        for i in range(10)
    ]
    unseen = steps[:1] * 50  # a second
    fell = play.save_gif(tmp_path / "a.gif", env, iter(unseen + steps), 0.2, np.zeros(3))
    assert fell == 2


def test_a_gif_is_replaced_in_one_step(env, tmp_path, monkeypatch):
    """A disk that fills up while it is written keeps the old one whole."""
    monkeypatch.setattr(mujoco, "Renderer", FakeRenderer)
    path, log = tmp_path / "a.gif", dict(v_x=np.zeros(1), power=np.zeros(1))
    log["ended_fall"] = np.zeros(1, bool)
    path.write_bytes(b"before")
    with full_disk(10_000), pytest.raises(OSError):
        play.save_gif(path, env, itertools.repeat(log), 0.2, np.zeros(3))
    assert contents(tmp_path) == {"a.gif": b"before"}
    play.save_gif(path, env, itertools.repeat(log), 0.2, np.zeros(3))
    with Image.open(path) as gif:
        assert (gif.format, gif.n_frames) == ("GIF", 4)


@pytest.mark.parametrize(
    "run, argv, says",
    [
        ("none", "", "none"),
        ("none", "--gif a.gif", "none"),
        ("none", "--follow", "none"),
        ("truncated", "", "truncated"),
        *(("rough", f"--roughness {x}", "roughness") for x in ("-1", "nan", "1000000")),
        *(("flat", f"--command {x}", "--command") for x in ("1e300 0 0", "0 nan 0", "0 0 -11")),
        ("flat", "--gif=", "--gif is ''"),
        *(
            ("flat", f"--gif a.gif --seconds {x}", "--seconds")
            for x in ("0", "-3", "0.02", "inf", "nan")
        ),
        *(("flat", f"--gif a.gif --slow {x}", "--slow") for x in ("0", "nan")),
        ("flat", "--gif none/a.gif", "none/a.gif"),
        ("flat", "--gif a.png", "a.png"),
    ],
)
def test_what_goes_wrong_is_one_line_before_anything_is_drawn(
    runs, tmp_path, capsys, monkeypatch, run, argv, says
):
    """What is no run folder or no policy; no ground; a GIF without frames, without end or without a
    place.
    """
    monkeypatch.setattr(play, "make_scene", None)
    monkeypatch.chdir(tmp_path)
    if run == "truncated":
        DAMAGES[run](make_run(tmp_path / run) / "policy.npz")
    before = sorted(tmp_path.rglob("*"))
    assert says in error_of(capsys, play.main, runs.get(run, run), *argv.split())
    assert sorted(tmp_path.rglob("*")) == before


# ---- what is played ----


@pytest.mark.parametrize(
    "task, argv, command",
    [
        ("flat", "", [1, 0, 0]),
        ("velocity", "", [0, 0, 0]),
        ("flat", "--command 0.5 -0.25 2", [0.5, -0.25, 2]),
    ],
)
def test_the_command_is_the_tasks_greatest_or_the_given_one(runs, monkeypatch, task, argv, command):
    seen = []
    monkeypatch.setattr(play, "check_drawing", lambda gif: None)
    monkeypatch.setattr(
        play, "watch", lambda env, steps, asked, *_: seen.append((next(steps), env, asked))
    )
    assert play.main([str(runs[task]), *argv.split()]) == 0
    ((log, env, asked),) = seen
    assert (
        asked.tolist() == command
        and env.state.command.tolist() == [command]
        and log["command_x"] == command[:1]
    )


@pytest.mark.parametrize(
    "argv, warns", [("--command 1.5 0 0", "1.5"), ("--command 0.5 0 0", ""), ("", "")]
)
def test_a_command_that_was_not_trained_is_a_warning(runs, monkeypatch, capsys, argv, warns):
    monkeypatch.setattr(play, "check_drawing", lambda gif: None)
    monkeypatch.setattr(play, "watch", lambda *_: None)
    assert play.main([str(runs["flat"]), *argv.split()]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == bool(warns) and all(warns in line for line in lines)


@pytest.mark.parametrize(
    "task, asked, height",
    [
        ("rough", None, 0.15),
        ("velocity", None, 0.05),
        ("flat", None, 0),
        ("rough", 0.03, 0.03),
        ("flat", 0.1, 0.1),
    ],
)
def test_the_ground_is_the_runs_roughest_or_the_given_one(runs, task, asked, height):
    """Sections IV-A.2 and IV-A.3: 15 cm and 5 cm, from lowest to highest point; the episode does
    not end by time.
    """
    env = play.make_env(policy_file.load(runs[task] / "policy.npz")[1], asked)
    assert (env.ground is None) == (height == 0)
    assert env.ground is None or np.ptp(env.ground) == pytest.approx(height)
    assert env.num_envs == 1 and env.env_cfg.episode_steps >= 10**9 and not env.env_cfg.stagger


@pytest.mark.parametrize("follow, then", [(True, 1.5), (False, 0.5)])
def test_follow_takes_a_new_policy_and_nothing_else_does(tmp_path, follow, then):
    """The first policy answers 0.5 to everything, the one that replaces it 1.5."""
    make_run(tmp_path, "flat", action=0.5)
    env, seen = play.make_env(policy_file.load(tmp_path / "policy.npz")[1]), []
    for i, _ in zip(range(4), play.play(env, tmp_path, np.zeros(3), follow), strict=False):
        seen.append(env.state.action.copy())
        if i == 1:
            make_run(tmp_path, "flat", action=1.5)
            # the clock of a file system may be coarse
            later = (tmp_path / "policy.npz").stat().st_mtime + 1
            os.utime(tmp_path / "policy.npz", (later, later))
    assert [np.unique(action).tolist() for action in seen] == [[0.5], [0.5], [then], [then]]


def test_the_command_may_change_on_the_way(runs):
    """What the arrow keys do: from the next observation on it is another command. Scale 2 [lab
    code], no noise.
    """
    env, command = (
        play.make_env(policy_file.load(runs["flat"] / "policy.npz")[1]),
        np.array([0.5, 0, 0]),
    )
    steps = play.play(env, runs["flat"], command)
    next(steps)
    assert env.state.frames[0, :, 3].tolist() == [1.0, 1.0]
    command[0] = 0.75
    next(steps)
    assert env.state.frames[0, :, 3].tolist() == [1.0, 1.5]


# ---- the viewer ----


class FakeViewer:
    """What mujoco.viewer.launch_passive returns, without a window: presses a key in each frame,
    then closes.
    """

    def __init__(self, keys):
        self.keys, self.texts, self.cam, self.lock = iter(keys), [], mujoco.MjvCamera(), nullcontext
        self.left, self.opt = len(keys), mujoco.MjvOption()

    @contextmanager
    def launch_passive(self, model, data, key_callback, **_):
        self.press, self.model, self.data = key_callback, model, data
        yield self

    def is_running(self):
        return self.left > 0

    def set_texts(self, texts):
        self.texts.append(texts[2])

    def sync(self):
        self.left -= 1
        self.press(next(self.keys))


LOG = dict(v_x=np.array([1.26]), power=np.array([300.4]))


def watch(monkeypatch, env, keys, command, *options):
    """The fake viewer after one frame for each key."""
    viewer = FakeViewer(keys)
    monkeypatch.setattr(mujoco.viewer, "launch_passive", viewer.launch_passive)
    play.watch(env, itertools.repeat(LOG), command, *options)
    return viewer


@pytest.fixture
def env():
    env = play.make_env(tasks.task_config("flat"))
    env.reset(0)
    return env


@pytest.mark.parametrize(
    "keys, command",
    [
        ([glfw.KEY_UP], [0.6, 0, 0.2]),
        ([glfw.KEY_DOWN] * 2, [0.3, 0, 0.2]),
        ([glfw.KEY_LEFT], [0.5, 0, 0.3]),
        ([glfw.KEY_RIGHT] * 3, [0.5, 0, -0.1]),
        ([glfw.KEY_BACKSPACE], [0, 0, 0]),
        ([glfw.KEY_UP, glfw.KEY_BACKSPACE, glfw.KEY_LEFT], [0, 0, 0.1]),
        ([glfw.KEY_SPACE, glfw.KEY_A, glfw.KEY_ENTER, glfw.KEY_F1], [0.5, 0, 0.2]),
    ],
)
def test_keys_set_the_command(monkeypatch, env, keys, command):
    """From 0.5 m/s and 0.2 rad/s: 0.1 for each press of an arrow, left is positive yaw; other keys
    do nothing.
    """
    asked = np.array([0.5, 0, 0.2])
    watch(monkeypatch, env, keys, asked)
    assert asked == pytest.approx(command)


def test_the_overlay_says_what_is_asked_and_done(monkeypatch, env):
    """1.26 m/s and 300.4 W of the log, rounded; what is not asked for is not mentioned."""
    keys = [glfw.KEY_UP, glfw.KEY_LEFT, glfw.KEY_BACKSPACE, glfw.KEY_SPACE]
    texts = [
        re.sub(" +", " ", text)
        for text in watch(monkeypatch, env, keys, np.array([0.4, 0, 0])).texts
    ]
    assert all(text.endswith("v_x 1.3 m/s 300 W") for text in texts)
    assert [text.removesuffix("v_x 1.3 m/s 300 W").strip() for text in texts] == [
        "asked 0.4 m/s",
        "asked 0.5 m/s",
        "asked 0.5 m/s 0.1 rad/s",
        "",
    ]


def test_the_viewer_shows_the_simulated_robot_in_real_time(monkeypatch, env):
    """The drawn pose is the simulated one; a frame lasts 20 ms, so four of them take 80 ms at
    least.
    """
    slept = []
    monkeypatch.setattr(play.time, "sleep", slept.append)
    # a frame's work takes 5 ms
    monkeypatch.setattr(play.time, "monotonic", itertools.count(0, 0.005).__next__)
    viewer = watch(monkeypatch, env, [0] * 4, np.zeros(3))
    assert slept == pytest.approx([0.015] * 4)
    assert viewer.data.qpos.tolist() == env.qpos[0].tolist()
    assert viewer.cam.trackbodyid == viewer.model.body("trunk").id


def test_the_viewer_shows_it_slower_and_with_forces(monkeypatch, env):
    """Four times slower a frame of 20 ms lasts 80, of which its work takes 5; no forces unless they
    are asked for.
    """
    slept, force = [], mujoco.mjtVisFlag.mjVIS_CONTACTFORCE
    monkeypatch.setattr(play.time, "sleep", slept.append)
    monkeypatch.setattr(play.time, "monotonic", itertools.count(0, 0.005).__next__)
    assert watch(monkeypatch, env, [0] * 2, np.zeros(3), 4.0, True).opt.flags[force] == 1
    assert slept == pytest.approx([0.075] * 2)
    assert watch(monkeypatch, env, [0], np.zeros(3)).opt.flags[force] == 0


def test_the_forces_that_are_drawn_carry_the_robot(env):
    """Over the half second in which it lands and stands: their mean is the weight, as drawn, to 5
    %.
    """
    model, data = play.make_scene(env)
    env.state.mass[0, env.trunk.id] += 2.0  # kg
    env.state.com[0, env.trunk.id] += [0.03, 0.0, 0.0]  # m
    env.state.gravity[0] = [0.5, 0.0, -8.0]  # m/s^2
    pushes = []
    for step in range(75):
        env.step(np.zeros((1, 12)))
        play.show(env, model, data)
        force, up = np.zeros(6), 0.0
        for i, contact in enumerate(data.contact):
            mujoco.mj_contactForce(model, data, i, force)
            up += (force[:3] @ contact.frame.reshape(3, 3))[2]
        pushes.append(up if step >= 50 else 0.0)
    weight = 8.0 * env.state.mass.sum()
    assert np.mean(pushes[50:]) == pytest.approx(weight, rel=0.05) and weight > 8.0 * 14
    assert np.abs(model.body_ipos - env.state.com[0]).max() == 0


@pytest.mark.parametrize("yaw, azimuth", [(0, 125), (90, 215), (-90, 35)])
def test_the_camera_looks_from_the_front_right(env, yaw, azimuth):
    """MuJoCo's azimuth is the direction of sight: with a heading of 0 along x, 125 degrees looks to
    back and left.
    """
    env.qpos[0, 3:7] = np.cos(np.radians(yaw) / 2), 0, 0, np.sin(np.radians(yaw) / 2)
    camera = mujoco.MjvCamera()
    play.point(camera, env, play.make_scene(env)[0])
    assert camera.azimuth == pytest.approx(azimuth) and camera.elevation < 0


LOUD = """
import os, sys, play
show = play.show
def loud(*a):
    show(*a)
    print("shown", flush=True)
play.show = loud
print("returned", play.main(sys.argv[1:]), flush=True)
os._exit(0)  # at exit GLFW and Mesa's software renderer may wait for each other forever
"""


@pytest.mark.skipif(not shutil.which("Xvfb"), reason="needs Xvfb")
def test_the_viewer_runs_until_ctrl_c(runs):
    """On a virtual display: it draws, complains of nothing, and Ctrl-C ends it without a
    traceback.
    """
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", "1", "-screen", "0", "320x240x24"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    with server:
        try:
            display = HEADLESS | dict(DISPLAY=f":{server.stdout.readline().strip()}")
            command = [sys.executable, "-c", LOUD, runs["velocity"]]
            with started(command, cwd=ROOT, env=display) as viewer:
                shown = [viewer.stdout.readline() for _ in range(10)]
                running = viewer.poll() is None
                viewer.send_signal(signal.SIGINT)
                stdout, stderr = viewer.communicate(timeout=20)
        finally:
            server.terminate()
    assert shown == ["shown\n"] * 10 and running
    assert stderr == "" and stdout.endswith("returned 130\n")


# ---- the ground that is drawn ----


def drawn_ground(model, data, xy):
    """Height [m] of the drawn height field under xy (2,) [m], NaN where there is none: a ray from 5
    m above.
    """
    down = mujoco.mj_rayHfield(
        model, data, model.geom("floor").id, np.array([*xy, 5.0]), np.array([0, 0, -1.0])
    )
    return 5 - down if down >= 0 else np.nan


@pytest.fixture(scope="module")
def hills():
    """An environment on 15 cm, and its drawing: env, model, data."""
    env = play.make_env(tasks.task_config("rough"))
    env.reset(0)
    return env, *play.make_scene(env)


def test_the_drawn_robot_stands_on_the_drawn_ground_as_the_simulated_one(hills):
    """Anywhere on the tile, at the points of the height field, where rays and terrain.height need
    not interpolate.
    """
    env, model, data = hills
    rng = np.random.default_rng(0)
    for corner in rng.integers(80, size=(30, 2)) * 0.05:
        env.qpos[0, :2] = terrain.origin(0) + corner + 1e-6
        play.show(env, model, data)
        real = terrain.height(env.ground, env.qpos[0, :2])
        assert drawn_ground(model, data, data.qpos[:2]) == pytest.approx(real, abs=1e-4)
        assert data.body("trunk").xpos[2] == env.qpos[0, 2]


def test_the_camera_looks_at_a_robot_with_a_payload(hills):
    """It follows the robot's centre of mass, which 3 kg more in the trunk move by less than 20 cm,
    also 14 m away.
    """
    env, model, data = hills
    env.reset(0)
    env.state.mass[0, env.trunk.id] += 3.0
    play.show(env, model, data)
    assert np.abs(data.qpos[:2]).max() > 10
    assert np.linalg.norm(data.subtree_com[1] - data.qpos[:3]) < 0.2


@pytest.mark.parametrize("corner", [(0, 0), (0, 4), (4, 0), (4, 4)], ids=str)
def test_at_the_edge_of_its_tile_there_is_ground_on_all_sides(hills, corner):
    """Ten metres in every direction, and it is the ground on which the robot will find itself
    there: the tile's own.
    """
    env, model, data = hills
    env.qpos[0, :2] = terrain.origin(0) + np.clip(corner, 0.05, 3.95)
    play.show(env, model, data)
    for way in np.array([(x, y) for x in (-10, -2.3, 0, 0.1, 10) for y in (-10, 0, 1.5, 10)]):
        real = terrain.height(env.ground, terrain.wrap(env.qpos[0, :2] + way + 1e-6, np.array(0)))
        assert drawn_ground(model, data, data.qpos[:2] + way + 1e-6) == pytest.approx(
            real, abs=1e-4
        )


def test_a_plane_needs_no_shift(env):
    """On flat ground the robot is drawn where it is."""
    model, data = play.make_scene(env)
    env.qpos[0, :2] = 123.0, -45.0
    play.show(env, model, data)
    assert data.qpos[:2].tolist() == [123.0, -45.0]
