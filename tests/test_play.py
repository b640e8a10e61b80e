"""play.py: moving pictures, the window, what is played, and the ground that is drawn."""

import itertools
import os
import subprocess
import sys
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import glfw
import mujoco
import numpy as np
import pytest
from PIL import Image, ImageSequence
from support import HAS_GL, NOMINAL, ROOT, error_of, make_run, rewrite

import evaluate
import go1
import play
import tasks
import terrain
from runtime import run_folder, viewer

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")
HEADLESS = {name: x for name, x in os.environ.items() if name not in DISPLAYS}
needs_gl = pytest.mark.skipif(not HAS_GL, reason="needs libegl1 or libosmesa6")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A run folder of three tasks."""
    base = tmp_path_factory.mktemp("runs")
    return {task: make_run(base / task, task) for task in ("flat", "rough", "velocity")}


@pytest.fixture
def env():
    env = play.make_env(tasks.task_config("flat"), np.zeros(3))
    env.reset(0)
    return env


# ---- moving pictures ----


def gif_of(path, *argv):
    """The GIF that play.py draws without a display: pictures (T, height, width, 3), and how long
    each is shown [ms].
    """
    command = [sys.executable, "play.py", *argv, "--gif", path]
    env = HEADLESS | dict(MUJOCO_GL="foo")  # of some other program
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with Image.open(path) as gif:
        pictures = [np.asarray(x.convert("RGB"), int) for x in ImageSequence.Iterator(gif)]
        return np.array(pictures), gif.info["duration"]


def moves(pictures):
    """Whether something moves from each picture to the next, below the caption."""
    below = pictures[:, 50:-30]
    return all((np.abs(a - b).sum(-1) > 30).sum() > 50 for a, b in itertools.pairwise(below))


@needs_gl
def test_a_gif_without_a_display(runs, tmp_path):
    """0.1 s are 5 steps of 20 ms, each shown for 80 ms. Something moves from each to the next."""
    pictures, duration = gif_of(tmp_path / "a.gif", runs["flat"], "--seconds", "0.1")
    assert pictures.shape == (5, 270, 480, 3) and duration == 80
    assert moves(pictures)


@needs_gl
def test_three_runs_move_side_by_side(runs, tmp_path):
    """Three panels of 320 pixels. In real time there is a picture of each third of 5 steps."""
    three = runs["flat"], runs["rough"], runs["flat"]
    real_time = ["--seconds", "0.1", "--slow", "1"]
    pictures, duration = gif_of(tmp_path / "a.gif", *three, *real_time)
    assert pictures.shape == (2, 180, 3 * 320, 3) and duration == 60
    left, middle, right = np.split(pictures, 3, axis=2)
    assert all(map(moves, (left, middle, right)))
    here = np.s_[:, 50:-30]  # without what is written
    assert (left[here] == right[here]).all() and (left[here] != middle[here]).any()


@pytest.mark.parametrize(
    ("slow", "milliseconds", "says"),
    [("", 80, "4 times slower"), ("--slow 1.3", 30, "1.5 times"), ("--slow 0.2", 20, "real time")],
)
def test_a_gif_says_how_fast_it_is_and_what_its_last_second_was(
    runs, monkeypatch, slow, milliseconds, says
):
    """It shows a step of 20 ms for whole hundredths of a second, of which browsers take one for
    ten.
    """
    means, saved = [dict(v_x=1.0, power=300.0), dict(v_x=2.0, power=100.0)], []
    monkeypatch.setattr(viewer, "film", lambda *_: ([None] * 2, means))
    monkeypatch.setattr(viewer, "save_gif", lambda *given: saved.append(given))
    assert play.main([str(runs["flat"]), "--gif", "a.gif", *slow.split()]) == 0
    ((_, _, (captions,), foot, duration),) = saved
    assert duration == milliseconds and not foot and len(captions) == 2
    assert all(says in x and "v_x 2.0 m/s   100 W" in x for x in captions)


def test_panels_say_who_does_what_when_asked_for_the_same(runs, monkeypatch):
    """What all of them are asked, and how fast it is shown, is said once."""
    asked, saved = [], []

    def film(env, steps, *_):
        next(steps)
        asked.append(env.state.command[0].tolist())
        return [None], [dict(v_x=len(asked), power=100.0)]

    monkeypatch.setattr(viewer, "film", film)
    monkeypatch.setattr(viewer, "save_gif", lambda *given: saved.append(given))
    argv = [runs["flat"], runs["rough"], "--gif", "a.gif", "--command", 0.5, -0.25, 2]
    assert play.main([str(x) for x in argv]) == 0
    ((_, _, captions, foot, _),) = saved
    assert asked == [[0.5, -0.25, 2]] * 2
    done = "0.005\nv_x 1.0 m/s   100", "0.0002\nv_x 2.0 m/s   100"
    assert captions == [[f"EIPO from {x} W"] for x in done]
    assert foot == "asked 0.5 m/s, -0.25 m/s aside, 2 rad/s   4 times slower"


def test_numbers_are_means_over_the_last_second(env, monkeypatch):
    """The logs say 0, 1, 2, ...; of 0 to 49, the first second, there is no picture."""
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setattr(mujoco, "Renderer", MagicMock())
    logs = (dict(v_x=np.array([i]), power=np.array([10.0 * i])) for i in itertools.count())
    pictures, means = viewer.film(env, logs, 0.2, every=3)
    assert len(pictures) == 4
    assert [x["v_x"] for x in means] == [25.5, 28.5, 31.5, 34.5]
    assert [x["power"] for x in means] == [255, 285, 315, 345]


EIPO, PPO = dict(algo="eipo", lam=0.005), dict(algo="ppo", lam=0.01)


@pytest.mark.parametrize(
    ("folders", "abouts", "names"),
    [
        ("x/a x/b", (EIPO, PPO), ["EIPO from 0.005 smooth", "PPO(0.01) smooth"]),
        ("x/a x/b x/c", (EIPO, PPO, EIPO), ["a", "b", "c"]),
        ("x/a y/a", (EIPO, EIPO), ["x/a", "y/a"]),
    ],
)
def test_runs_have_the_names_of_the_tables_or_of_their_folders(folders, abouts, names):
    config = dict(aux="smooth", reward="paper")
    policies = [SimpleNamespace(about=about, config=config) for about in abouts]
    named = play.names_of([Path(x) for x in folders.split()], policies)
    assert [str(name) for name in named] == names


def test_legs_of_one_colour_are_diagonal(env):
    model, _ = viewer.make_scene(env)
    drawn = [i for i in range(model.ngeom) if model.geom_group[i] == 2]
    of = [(model.body(model.geom_bodyid[i]).name[:2], tuple(model.geom_rgba[i])) for i in drawn]
    colours = {leg: {colour for name, colour in of if name == leg} for leg in go1.LEGS}
    assert colours["FR"] == colours["RL"] != colours["FL"] == colours["RR"]
    assert all(len(x) == 1 for x in colours.values())


# ---- what goes wrong ----


def test_opengl_that_does_not_work_is_one_line(runs, capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("MUJOCO_GL", "off")
    said = error_of(capsys, play.main, runs["flat"], "--gif", tmp_path / "a.gif")
    assert "libosmesa6" in said and not [*tmp_path.iterdir()]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a display is always there")
def test_without_a_display_that_works_a_line_says_what_to_do(runs):
    """As a process of its own, which GLFW would tell of it in a warning and MuJoCo would end."""
    env = HEADLESS | dict(DISPLAY=":9999", MUJOCO_GL="foo")
    options = dict(env=env, capture_output=True, text=True)
    done = subprocess.run([sys.executable, "play.py", runs["flat"]], cwd=ROOT, **options)
    says = "play.py: there is no display: give --web or --gif FILE\n"
    assert (done.returncode, done.stderr) == (2, says)


@pytest.mark.parametrize(
    ("working", "way"), [("egl osmesa", "egl"), ("osmesa", "osmesa"), ("", "off")]
)
def test_osmesa_draws_where_egl_has_no_driver(monkeypatch, working, way):
    """Other processes try."""

    def run(words, env, **_):
        return SimpleNamespace(returncode=env["MUJOCO_GL"] not in working.split())

    monkeypatch.setattr(subprocess, "run", run)
    assert play.way_to_draw() == way


def test_macos_wants_mjpython(runs, capsys, monkeypatch):
    """As MuJoCo refuses a window there."""
    monkeypatch.setattr(sys, "platform", "darwin")
    assert "mjpython in place of python" in error_of(capsys, play.main, runs["flat"])


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("--seed -1", "--seed is -1: it must be at least 0"),
        ("--slow 0", "--slow is 0.0: it must be above 0"),
        ("--command 0 inf 0", "--command is inf: it must be"),
        ("--seconds 2", "needs --"),
        ("--web --seconds 2", "needs --"),
        ("--port 8123", "needs --"),
        ("--web --gif a.gif", "give one of them"),
        ("elsewhere", "draw several with --gif FILE"),
        ("elsewhere --web", "draw several with --gif FILE"),
    ],
)
def test_flags_that_make_no_sense_are_one_line(capsys, given, says):
    """Before anything is read: there is no such run."""
    assert says in error_of(capsys, play.main, "nowhere", *given.split())


@pytest.mark.parametrize(
    "name", ["a.mp4", "missing/a.gif", "folder.gif", "closed/a.gif", "closed/link.gif"]
)
def test_a_gif_is_refused_before_it_is_drawn_unless_it_can_be_one(
    capsys, tmp_path, monkeypatch, name
):
    """Drawing takes a while. To root, who may run the tests, no folder is closed."""
    (tmp_path / "folder.gif").mkdir()
    (tmp_path / "closed").mkdir()
    (tmp_path / "closed/link.gif").symlink_to(tmp_path / "a.gif")
    monkeypatch.setattr(os, "access", lambda path, mode: path.name != "closed")
    says = error_of(capsys, play.main, "nowhere", "--gif", tmp_path / name)
    assert "must end in .gif, in a folder that exists and can be written to" in says


def test_what_cannot_be_asked_for_the_same_is_refused(runs, capsys, tmp_path):
    """Nor a robot that has no commands for one."""
    other = tmp_path / "policy.npz"
    other.write_bytes((runs["flat"] / "policy.npz").read_bytes())
    rewrite(other, physics_steps=2)
    gif = "--gif", tmp_path / "a.gif"
    for argv, says in (
        ((runs["flat"], runs["velocity"]), "do not go side by side"),
        ((runs["flat"], tmp_path), "control steps of one length"),
        ((runs["velocity"], "--command", 3, 0, 0), "whose robots are not asked for a speed"),
    ):
        assert says in error_of(capsys, play.main, *argv, *gif)
    assert not gif[1].exists()


# ---- what is played ----


@pytest.mark.parametrize(
    ("task", "argv", "command", "seed", "way"),
    [
        ("flat", "", [1, 0, 0], 0, ("window", 1.0)),
        ("velocity", "--slow 3", [0, 0, 0], 0, ("window", 3.0)),
        ("flat", "--web --seed 7 --port 8123", [1, 0, 0], 7, ("browser", 8123, 1.0)),
        ("flat", "--web --slow 3 --command 0.5 -0.25 2", [0.5, -0.25, 2], 0, ("browser", 0, 3.0)),
    ],
)
def test_what_is_asked_reaches_the_window_and_the_browser(
    runs, monkeypatch, task, argv, command, seed, way
):
    """Without a word a robot is asked for its task's greatest command, in real time."""
    seen = []

    def show(name, env, steps, asked, *rest):
        assert next(steps)["command_x"] == asked[0]
        seen.append((asked.tolist(), env.state.friction.tolist(), (name, *rest)))

    for name in ("window", "browser"):
        monkeypatch.setattr(viewer, name, partial(show, name))
    assert play.main([str(runs[task]), *argv.split()]) == 0
    _, env_cfg = run_folder.load_policy(runs[task] / "policy.npz")
    env = play.make_env(env_cfg, np.zeros(3))
    env.reset(seed)
    assert seen == [(command, env.state.friction.tolist(), way)]


@pytest.mark.parametrize(("task", "height"), [("rough", 0.15), ("velocity", 0.05), ("flat", 0)])
def test_the_ground_is_the_runs_roughest(task, height):
    """Sections IV-A.2 and IV-A.3: 15 cm and 5 cm, from lowest to highest point."""
    env = play.make_env(tasks.task_config(task), np.zeros(3))
    assert height == (0 if env.ground is None else pytest.approx(np.ptp(env.ground)))


@pytest.mark.go1
def test_a_robot_that_is_watched_starts_in_the_nominal_pose_and_has_no_limit_of_time():
    """A run that learned from the clip as printed is measured as all others are (D3)."""
    env = play.make_env(tasks.Config(clip="torque"), np.zeros(3))
    env.reset(0)
    assert env.qpos[0, 7:].tolist() == NOMINAL.tolist() and not env.qvel.any()
    assert env.env_cfg.episode_steps >= 10**9 and not env.env_cfg.stagger
    assert env.env_cfg.clip == evaluate.CLIP == "power"


def test_the_robot_hears_a_command_at_once():
    env = play.make_env(tasks.task_config("flat"), asked := np.zeros(3))
    env.reset(0)
    for v_x in (0.25, 0.75):
        asked[0] = v_x
        env.step(np.zeros((1, 12)))
        assert env.state.command[0, 0] == v_x


def test_an_import_takes_no_jax_and_starts_nothing():
    """JAX would take a second to start, and another process as long."""
    code = "import os, sys, play; print('jax' in sys.modules, 'MUJOCO_GL' in os.environ)"
    command = [sys.executable, "-c", code, "--gif"]
    done = subprocess.run(command, cwd=ROOT, env=HEADLESS, capture_output=True, text=True)
    assert done.stdout == "False False\n"


# ---- the window ----


class FakeViewer:
    """What mujoco.viewer.launch_passive returns, without a window: presses a key in each frame,
    then closes.
    """

    def __init__(self, keys):
        self.keys, self.cam, self.lock = iter(keys), mujoco.MjvCamera(), nullcontext
        self.left = len(keys)

    @contextmanager
    def launch_passive(self, model, data, key_callback, **_):
        self.press, self.model, self.data = key_callback, model, data
        yield self

    def is_running(self):
        return self.left > 0

    def set_texts(self, texts):
        self.text = texts[2]

    def sync(self):
        self.left -= 1
        self.press(next(self.keys))


def watch(monkeypatch, env, keys, command, *options):
    """The fake viewer after one frame for each key, which takes 5 ms; and how long it slept [s]."""
    fake, slept = FakeViewer(keys), []
    clock = SimpleNamespace(sleep=slept.append, monotonic=itertools.count(0, 0.005).__next__)
    monkeypatch.setattr(viewer, "time", clock)
    monkeypatch.setattr(mujoco.viewer, "launch_passive", fake.launch_passive)
    monkeypatch.setattr(viewer, "has_display", lambda: True)
    log = dict(v_x=np.array([1.26]), power=np.array([300.4]))
    viewer.window(env, itertools.repeat(log), command, *options)
    return fake, slept


@pytest.mark.parametrize(
    ("task", "keys", "command"),
    [
        ("flat", [glfw.KEY_UP, glfw.KEY_RIGHT, glfw.KEY_RIGHT, glfw.KEY_A], [0.6, 0, 0]),
        ("flat", [glfw.KEY_DOWN, glfw.KEY_LEFT], [0.4, 0, 0.3]),
        ("flat", [glfw.KEY_UP, glfw.KEY_BACKSPACE, glfw.KEY_LEFT], [0, 0, 0.1]),
        ("velocity", [glfw.KEY_UP, glfw.KEY_LEFT], [0.5, 0, 0.2]),  # which has no commands
    ],
)
def test_keys_set_the_command(monkeypatch, task, keys, command):
    """From 0.5 m/s and 0.2 rad/s: 0.1 for each press of an arrow, left is positive yaw. Backspace
    makes it 0, and other keys leave it.
    """
    env = play.make_env(tasks.task_config(task), asked := np.array([0.5, 0, 0.2]))
    watch(monkeypatch, env, keys, asked)
    assert asked == pytest.approx(command)


def test_the_window_shows_the_simulated_robot_in_real_time_or_slower(monkeypatch, env):
    """A control step lasts 20 ms, of which a frame's work takes 5; four times slower 80."""
    shown, slept = watch(monkeypatch, env, [0] * 4, np.zeros(3))
    assert "v_x 1.3 m/s   300 W" in shown.text
    assert slept == pytest.approx([0.015] * 4)
    assert shown.data.qpos.tolist() == env.qpos[0].tolist()
    assert shown.cam.trackbodyid == shown.model.body("trunk").id
    shown, slept = watch(monkeypatch, env, [0] * 2, np.zeros(3), 4.0)
    assert slept == pytest.approx([0.075] * 2)


def test_the_browser_shows_the_simulated_robot_as_slow_as_asked(monkeypatch, env):
    seen, launch, log = [], MagicMock(), dict(v_x=np.array([1.26]), power=np.array([300.4]))
    monkeypatch.setattr(viewer, "launch_web", launch)
    monkeypatch.setattr(viewer, "paced", lambda steps, dt: seen.append(dt) or steps)
    viewer.browser(env, iter([log]), np.zeros(3), 0, 4.0)
    handle = launch.return_value.__enter__.return_value
    assert handle.set_model.call_args.kwargs["data"].qpos.tolist() == env.qpos[0].tolist()
    assert "v_x 1.3 m/s   300 W" in launch.call_args.args[3][0] and handle.sync.called
    assert seen == [pytest.approx(0.08)]


def test_sliders_set_what_the_task_asks_for(monkeypatch, env):
    """Walking on flat ground has 0 to 1 m/s ahead, and nothing else."""
    pytest.importorskip("mujoco.studio")
    from mujoco.studio import launch_thread, viewer_protocol, web_viewer
    from mujoco.studio.dear_imgui import dear_imgui as gui

    class Fake:
        def __init__(self, config, endpoint, plugins, camera):
            self.port, (self.panel,) = config.http_port, plugins

    made, asked, said = [], np.array([0.5, 0.0, 0.0]), []
    monkeypatch.setattr(web_viewer, "WebViewer", Fake)
    monkeypatch.setattr(viewer_protocol, "run_viewer_loop", made.append)
    monkeypatch.setattr(launch_thread, "launch_thread", lambda run: run(None))
    for name in ("SetNextWindowPos", "Begin", "End"):
        monkeypatch.setattr(gui, name, lambda *_: None)
    monkeypatch.setattr(gui, "Text", said.append)
    monkeypatch.setattr(gui, "SliderFloat", lambda *x: said.append(x) or (True, 0.25))
    viewer.launch_web(env, viewer.make_scene(env)[0], asked, ["1 m/s"], 8123)
    made[0].panel.build(None)
    assert said == ["1 m/s", ("v_x [m/s]", 0.5, 0.0, 1.0)] and made[0].port == 8123
    assert asked.tolist() == [0.25, 0, 0]


# ---- the ground that is drawn ----


def drawn_ground(model, data, xy):
    """Height [m] of the drawn height field under xy (2,) [m]: a ray from 5 m above."""
    floor, down = model.geom("floor").id, np.array([0, 0, -1.0])
    return 5 - mujoco.mj_rayHfield(model, data, floor, np.array([*xy, 5.0]), down)


@pytest.fixture(scope="module")
def hills():
    """An environment on 15 cm, and its drawing: env, model, data."""
    env = play.make_env(tasks.task_config("rough"), np.zeros(3))
    env.reset(0)
    return env, *viewer.make_scene(env)


@pytest.mark.parametrize("corner", [(0, 4), (1.35, 2.6)], ids=str)
def test_the_drawn_ground_is_the_simulated_one_on_all_sides(hills, corner):
    """Under the robot and ten metres around it, also at the edge of its tile, behind which it comes
    back on the other side. At the points of the height field nothing is interpolated.
    """
    env, model, data = hills
    env.qpos[0, :2] = terrain.origin(0) + np.clip(corner, 0.05, 3.95)
    viewer.show(env, model, data)
    assert data.body("trunk").xpos[2] == env.qpos[0, 2]
    for way in itertools.product((-10, -2.3, 0, 0.1, 10), (-10, 0, 1.5, 10)):
        way = np.array(way) + 1e-6
        real = terrain.height(env.ground, terrain.wrap(env.qpos[0, :2] + way, np.array(0)))
        assert drawn_ground(model, data, data.qpos[:2] + way) == pytest.approx(real, abs=1e-4)
