"""tutorial.md, executed: its outputs, figures, quotes, names and flags are those of this
repository.

`python tests/test_tutorial.py --write` runs the page and writes what comes out into it and into
tutorial/.
"""

import ast
import codeop
import contextlib
import inspect
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
if __name__ == "__main__":
    sys.path[:0] = str(ROOT), str(ROOT / "tests")
    os.environ.setdefault("JAX_PLATFORMS", "cpu")

from support import HAS_GL, TINY

import evaluate
import play
import train
from results import runs
from tutorial import figures

PAGE = ROOT / "tutorial.md"
PICTURES = ROOT / "tutorial"
BLOCK = re.compile(r"^```(\w+)\n((?:.*\n)*?)^```$", re.M)  # language, content
TESTS = sorted((ROOT / "tests").rglob("test_*.py"))
QUOTED = re.compile(r"# quoted from (\S+)\n")
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
MODULES = {path.stem for path in ROOT.glob("*.py")} | {"tutorial"}


def blocks(language):
    """The page's fenced blocks in that language."""
    return [content for kind, content in BLOCK.findall(PAGE.read_text()) if kind == language]


def rerun(code, scope):
    """Run a block, a statement at a time; returns it with what each one printed below it, as #>
    lines.
    """
    code = re.sub(r"^#>.*\n", "", code, flags=re.M)
    lines, result, done = code.splitlines(), [], 0
    for statement in ast.parse(code).body:
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(ast.Module([statement], []), PAGE.name, "exec"), scope)
        result += lines[done : statement.end_lineno] + [
            f"#> {x}".rstrip() for x in printed.getvalue().splitlines()
        ]
        done = statement.end_lineno
    return "\n".join([*result, *lines[done:]]) + "\n"


def run_page():
    """The page with all its python blocks run in order in one namespace, in the root of the
    repository.
    """
    scope = {"__name__": "tutorial"}

    def replace(match):
        kind, content = match.groups()
        if kind != "python" or QUOTED.match(content):
            return match[0]
        return f"```python\n{rerun(content, scope)}```"

    with contextlib.chdir(ROOT):
        return BLOCK.sub(replace, PAGE.read_text())


def alike(shown, printed):
    """Whether two lines agree: words and whole numbers exactly, decimal fractions to one unit of
    the last place.
    """
    if NUMBER.sub("#", shown).split() != NUMBER.sub("#", printed).split():
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return all(
        abs(float(a) - float(b)) <= ("." in a) * 1.01 * 10.0 ** -len(a.partition(".")[2])
        for a, b in pairs
    )


@pytest.fixture(scope="module")
def page():
    """The page as it comes out now, and its pictures by name."""
    drawn = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "draw", lambda name, figure: drawn.update({name: figure}))
        return run_page(), drawn


def test_blocks_can_be_pasted_into_a_python_session():
    """Line by line, as a prompt takes them: a blank line ends a loop (Python 3.11, 3.12)."""
    for block in blocks("python"):
        if not QUOTED.match(block):
            open_lines = ""
            for line in f"{block}\n".splitlines():
                open_lines += f"{line}\n"
                if codeop.compile_command(open_lines.removesuffix("\n"), symbol="single"):
                    open_lines = ""
            assert not open_lines


@pytest.mark.go1
def test_outputs_are_those_of_the_page(page):
    """If this fails because something was meant to change: python tests/test_tutorial.py --write,
    and read the page.
    """
    shown, printed = PAGE.read_text().splitlines(), page[0].splitlines()
    wrong = [(a, b) for a, b in zip(shown, printed, strict=False) if not alike(a, b)]
    assert not wrong and len(shown) == len(printed), wrong[:3]


@pytest.mark.go1
def test_pictures_show_what_the_page_computes(page):
    """Each picture of the page carries the means of its curves, and the code still draws those."""
    drawn = page[1]
    linked = set(re.findall(r"\(tutorial/(\w+\.\w+)\)", PAGE.read_text()))
    assert linked == {path.name for path in PICTURES.iterdir() if path.suffix in (".png", ".svg")}
    assert set(drawn) == {path.stem for path in PICTURES.glob("*.png")}
    for name, figure in drawn.items():
        with Image.open(PICTURES / f"{name}.png") as image:
            shown = [float(x) for x in image.text["Description"].split()]
        now = [float(x) for x in figures.numbers(figure).split()]
        np.testing.assert_allclose(now, shown, rtol=1e-3, atol=1e-6, err_msg=name)


def resolve(name):
    """What a dotted name stands for."""
    module, *rest = name.split(".")
    found = sys.modules.get(module) or __import__(module)
    for attribute in rest:
        fields = getattr(found, "__dataclass_fields__", None) or getattr(found, "_fields", ())
        found = (
            getattr(found, attribute, None) or (attribute in fields) or getattr(found, attribute)
        )
    return found


QUOTES = [
    (found[1], code[found.end() :]) for code in blocks("python") if (found := QUOTED.match(code))
]


@pytest.mark.parametrize(("name", "code"), QUOTES, ids=[name for name, _ in QUOTES])
def test_quotes_are_verbatim(name, code):
    """The lines stand in the source one after the other, all indented by the same amount."""
    source = inspect.getsource(inspect.unwrap(resolve(name)))
    assert any(f"\n{textwrap.indent(code, ' ' * n)}" in f"\n{source}" for n in (0, 4, 8))


def test_names_and_files_in_the_prose_exist():
    prose = BLOCK.sub("", PAGE.read_text())
    tests = "".join(path.read_text() for path in TESTS)
    named = set(re.findall(r"`([^`\n]+)`", prose))
    for name in named:
        if re.fullmatch(r"test_\w+", name):
            assert f"def {name}(" in tests, name
        elif re.fullmatch(r"[\w./-]+\.(py|md|csv|npz|json|xml|png)", name) and "runs/" not in name:
            a_run_s = name in ("metrics.csv", "checkpoint.npz", "config.json", "curves.png")
            assert a_run_s or (ROOT / name).exists(), name
        elif re.fullmatch(r"\w+(\.\w+)+", name) and name.split(".")[0] in MODULES:
            assert resolve(name) is not None, name


def test_commands_have_only_flags_that_there_are():
    commands = [shlex.split(line, comments=True) for x in blocks("sh") for line in x.splitlines()]
    for python, script, *argv in commands:
        main = {"train.py": train.main, "evaluate.py": evaluate.main, "play.py": play.main}[script]
        with contextlib.redirect_stdout(io.StringIO()) as text, pytest.raises(SystemExit):
            main(["-h"])
        flags = set(re.findall(r"--[\w-]+", text.getvalue()))
        assert python == "python" and {x for x in argv if x.startswith("--")} <= flags, argv


def copied(copy):
    """A new folder with the code and the tests of the repository."""
    copy.mkdir()
    files = *ROOT.glob("*.py"), *ROOT.glob("*.xml"), ROOT / "pyproject.toml", ROOT / "README.md"
    for path in files:
        shutil.copy(path, copy)
    for folder in ("runtime", "results", "tests"):
        shutil.copytree(ROOT / folder, copy / folder)
    return copy


def test_the_new_task_trains_as_the_page_says(tmp_path):
    """Section 12, done to the letter: function, entry and test appended, one iteration trained. The
    evaluation asks it to turn, and the other commands take it, too.
    """
    copy = copied(tmp_path / "copy")
    (block,) = [code for code in blocks("python") if "def turn(" in code]
    function, entry, test, *_ = block.split("\n\n")
    entry = entry.partition("\n")[2]  # after rewards.turn = turn
    for file, lines in (
        ("rewards.py", function.replace("rewards.", "")),
        ("tasks.py", entry.replace("tasks.", "")),
        ("tests/paper/test_3_rewards.py", test),
    ):
        with open(copy / file, "a") as end:
            end.write(f"\n\n{lines}\n")
    tested = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "turn"]
    tested += ["tests/paper/test_3_rewards.py"]
    trained = [sys.executable, "train.py", "--task", "turn", *TINY, "--iterations", "1"]
    trained += ["--out", "run"]
    evaluated = [sys.executable, "evaluate.py", "run", "--episodes", "11"]
    kept = [sys.executable, "-m", "results", "add", "run", "--results", "kept", "--episodes", "11"]
    shown = [sys.executable, "-m", "results", "table", "kept/turn"]
    played = [sys.executable, "play.py", "run", "--gif", "a.gif", "--seconds", "0.1"]
    for command in (tested, trained, evaluated, kept, shown, *[played] * HAS_GL):
        done = subprocess.run(command, cwd=copy, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    kept = json.loads((copy / "kept/turn/run.json").read_text())
    assert {*runs.columns_of(kept["did"])["asked_yaw"]} == {x / 10 for x in range(11)}


SABOTAGE = re.compile(r"# \d+\. .*\n@@ (\S+), caught by (\w+) @@\n((?:[-+].*\n)+)> (assert .*)\n")
SABOTAGES = [found.groups() for diff in blocks("diff") for found in SABOTAGE.finditer(diff)]


def sabotaged(path, diff):
    """The text of path with the - lines of diff, which stand there once, replaced by its +
    lines.
    """
    removed, added = (
        "".join(x[1:] for x in diff.splitlines(keepends=True) if x[0] == sign) for sign in "-+"
    )
    text = path.read_text()
    assert text.count(removed) == 1, removed
    return text.replace(removed, added)


def test_sabotages_fit_the_source():
    """The - lines stand in the file that the page names, and the assertion in the one test of that
    name.
    """
    assert SABOTAGES and not "".join(SABOTAGE.sub("", diff) for diff in blocks("diff")).strip()
    for file, test, diff, line in SABOTAGES:
        ast.parse(sabotaged(ROOT / file, diff))
        (home,) = (path.read_text() for path in TESTS if f"def {test}(" in path.read_text())
        assert f"    {line}\n" in home.split(f"def {test}(")[1].split("\ndef ")[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "test", "diff", "line"), SABOTAGES, ids=[test for _, test, *_ in SABOTAGES]
)
def test_sabotages_are_caught_by_the_test_they_name(file, test, diff, line, tmp_path):
    """In a copy of the repository: the named test passes before, and fails after, in that assertion
    and nowhere else.

    A test that ends in another error, of broadcasting perhaps, shows other lines, or another
    exception.
    """
    copy = copied(tmp_path / "copy")
    (home,) = (str(path.relative_to(ROOT)) for path in TESTS if f"def {test}(" in path.read_text())
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", home, "-k", test]
    before = subprocess.run(command, cwd=copy, capture_output=True, text=True)
    assert before.returncode == 0, before.stdout
    (copy / file).write_text(sabotaged(copy / file, diff))
    after = subprocess.run(command, cwd=copy, capture_output=True, text=True)
    assert after.returncode == 1 and f"FAILED {home}::{test}" in after.stdout, after.stdout
    assert set(re.findall(r"^> +(.*)$", after.stdout, re.M)) == {line}, after.stdout
    assert set(re.findall(r"^\S+:\d+: (\w+)$", after.stdout, re.M)) == {"AssertionError"}, (
        after.stdout
    )


if __name__ == "__main__":
    if sys.argv[1:] != ["--write"]:
        sys.exit("usage: python tests/test_tutorial.py --write")
    figures.FOLDER = PICTURES
    PAGE.write_text(run_page())
    print(f"{PAGE.name} and {PICTURES.name}/ are up to date: look at what changed")
