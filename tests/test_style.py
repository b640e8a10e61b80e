"""The promises of the layout: sizes, imports, tags, and a README whose table is true."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from zipfile import ZipFile

import pytest

import eipo
import tasks
import train
from runtime import flags

ROOT = Path(train.__file__).parent
FILES = [*ROOT.glob("*.py"), *ROOT.glob("runtime/*.py"), *ROOT.glob("lab/*.py")]
MODULES = sorted(str(path.relative_to(ROOT).with_suffix("")) for path in FILES)
# imports go down this list, never up; the second entry is what else a module may import beyond the
# standard library. All before "lab" is the reference
LAYERS = {
    "policy": {"numpy"},  # it runs on a robot, without the rest
    "energy": {"numpy"},
    "rewards": {"numpy"},
    "terrain": {"numpy", "scipy"},
    "shaped": {"numpy"},
    "curriculum": {"numpy", "scipy"},
    "tasks": {"numpy"},
    "go1": {"numpy", "mujoco"},
    "go1_env": {"numpy", "mujoco", "scipy"},
    "networks": {"numpy", "jax"},
    "runtime/__init__": set(),
    "runtime/interrupt": set(),
    "runtime/parallel": {"numpy", "jax"},
    "ppo": {"jax", "optax"},
    "eipo": {"numpy", "jax"},
    "runtime/flags": set(),
    "runtime/run_folder": {"numpy", "jax"},
    "runtime/deploy": {"numpy"},
    "runtime/metrics": {"numpy", "matplotlib"},
    "train": {"numpy", "jax"},
    "evaluate": {"numpy", "jax", "scipy"},
    "play": {"numpy", "mujoco", "PIL"},
    "lab/__init__": set(),
    "lab/statistics": {"numpy", "scipy"},
    "lab/record": {"numpy"},
    "lab/sweep": {"matplotlib"},
    "lab/figures": {"numpy", "matplotlib", "PIL"},
    "lab/footfalls": {"numpy", "matplotlib"},
    "lab/claims": {"numpy"},
    "lab/promise": {"numpy", "matplotlib"},
    "lab/__main__": set(),
}
CORE = [
    "energy",
    "rewards",
    "terrain",
    "shaped",
    "curriculum",
    "go1",
    "tasks",
    "go1_env",
    "networks",
    "ppo",
    "eipo",
]


def source(module):
    return (ROOT / f"{module}.py").read_text()


def functions(module):
    return [
        node for node in ast.walk(ast.parse(source(module))) if isinstance(node, ast.FunctionDef)
    ]


@pytest.mark.parametrize("module", MODULES)
def test_imports_go_one_way(module):
    """A reader may stop at any file: the paper's equations know nothing of the environment, and so
    on.
    """
    imported = set()
    for node in ast.walk(ast.parse(source(module))):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package, *inside = node.module.split(".")
            names = inside or [alias.name for alias in node.names]
            ours = package in ("runtime", "lab")
            imported |= {f"{package}/{x}" for x in names} if ours else {package}
    above = list(LAYERS)[: list(LAYERS).index(module)]
    assert imported - set(sys.stdlib_module_names) <= LAYERS[module] | set(above)
    if module in CORE:  # what runs need is not the paper's, but for the averaging of gradients
        runtime = {name for name in imported if name.startswith("runtime")}
        assert runtime <= ({"runtime/parallel"} if module == "ppo" else set())
    learner = dict(networks=set(), ppo={"networks", "runtime/parallel"}, eipo={"networks", "ppo"})
    if module in learner:  # they know nothing of robots or files, nor through each other
        assert imported & set(LAYERS) == learner[module]
        assert not imported & {"os", "pathlib", "json"}


@pytest.mark.parametrize("module", MODULES)
def test_functions_are_short_and_documented(module):
    for function in functions(module):
        lines = function.end_lineno - function.lineno + 1
        assert lines <= (60 if function.name == "eipo" else 40), (
            f"{function.name} has {lines} lines"
        )
    tree = ast.parse(source(module))
    public = [
        n
        for n in tree.body
        if isinstance(n, ast.FunctionDef | ast.ClassDef) and not n.name.startswith("_")
    ]
    assert [n.name for n in [*public, tree] if not ast.get_docstring(n)] == []


@pytest.mark.parametrize("config", flags.CONFIGS, ids=lambda c: c.__module__)
def test_every_setting_says_where_it_comes_from_and_is_used(config):
    """A flag that nothing reads, or a number without a source, is how copies rot."""
    comments = flags.describe(config)
    code = "".join(source(module) for module in MODULES)
    for field in fields(config):
        assert re.match(
            r"\[(I|II|III|IV|V|lab code|ours|Eq\.)[-\w. ]*\] \S", comments[field.name]
        ), field.name
        assert re.search(rf"(config|cfg|options)\.{field.name}\b|\"{field.name}\"", code), (
            f"nothing reads {field.name}"
        )


def table_rows(page):
    """The table of equations on a page: [(tag, functions, tests)]."""
    rows = re.findall(
        r"^\| ((?:Eq|Alg|Section|GAE|PPO)[^|]*) \| ([^|]*) \| ([^|]*) \|$",
        (ROOT / page).read_text(),
        re.M,
    )
    return [
        (tag, re.findall(r"`([\w.]+)`", where), re.findall(r"`([\w.]+)`", tests))
        for tag, where, tests in rows
    ]


def test_equation_table_resolves_both_ways():
    """Every row names a function and a test that exist, and every equation that the source mentions
    has a row.
    """
    rows = table_rows("tests/paper/README.md")
    tests = "".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    for tag, where, names in rows:
        assert where and names, tag
        for name in where:
            module, attribute = name.rsplit(".", 1)
            assert hasattr(importlib.import_module(module), attribute), name
        for name in names:
            assert f"def {name}(" in tests, name
    listed = {int(n) for tag, _, _ in rows for n in re.findall(r"\d+", tag) if tag.startswith("Eq")}
    used = {int(n) for module in MODULES for n in re.findall(r"Eq\. \((\d+)\)", source(module))}
    assert used | set(range(1, 12)) == listed


TAGS = [f"eq{n:02}" for n in range(1, 12)] + [f"line{n:02}" for n in (6, 8, 9, 12, 13)]


@pytest.mark.parametrize("tag", [*TAGS, "algorithm1"])
def test_each_equation_selects_its_tests(tag):
    """`pytest -k eq03` must not come back empty, nor with tests that have nothing to do with the
    paper.
    """
    named = {
        path
        for path in (ROOT / "tests").rglob("test_*.py")
        if re.search(rf"def test_\w*{tag}_", path.read_text())
    }
    assert named and {path.parent.name for path in named} == {"paper"}


def test_every_deviation_that_is_cited_is_an_entry():
    """deviations.md has D1, D2, ... without a gap, each once, as a heading or as a paragraph that
    begins with number and title. Whatever number the source, tests or pages cite is among them.
    """
    page = (ROOT / "deviations.md").read_text()
    entries = [int(n) for n in re.findall(r"^(?:### |\*\*)D(\d+)\. \S", page, re.M)]
    assert sorted(entries) == list(range(1, len(entries) + 1))
    folders = [ROOT / name for name in ("docs", "lab", "results", "runtime", "tests", "tutorial")]
    files = [*ROOT.glob("*.*"), *(path for folder in folders for path in folder.rglob("*.*"))]
    for path in files:
        if path.suffix in (".md", ".py", ".xml"):
            cited = {int(n) for n in re.findall(r"\bD(\d+)\b", path.read_text())}
            assert cited <= set(entries), path


def test_readme_is_one_sitting_and_its_files_exist():
    text = (ROOT / "README.md").read_text()
    words = re.sub(r"```.*?```", "", text, flags=re.S).split()
    assert len(words) <= 700
    pages = [str(path.relative_to(ROOT)) for path in ROOT.glob("docs/*.md")]
    for page in ("README.md", "deviations.md", "tests/paper/README.md", *pages):
        for link in re.findall(r"\]\(([^)#:]+)\)", (ROOT / page).read_text()):
            assert (ROOT / page).parent.joinpath(link).exists(), f"{page}: {link}"
    shown = re.findall(r"play\.py (results/\S+)", text)
    assert shown and all((ROOT / folder / "policy.npz").exists() for folder in shown)
    for name in re.findall(r"`([\w/]+\.(?:py|xml))`", text):
        assert (ROOT / name).exists(), name


def test_readme_quotes_algorithm_1_as_it_is():
    """Its lines are those of `eipo.eipo`, in order."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    quoted = [line for line in code.splitlines() if not line.startswith("#")]
    source_lines = [line.strip() for line in inspect.getsource(eipo.eipo).splitlines()]
    places = [source_lines.index(line) for line in quoted]
    assert len(places) == 6 and places == sorted(places)


def test_what_is_imported_is_declared():
    """Not only what other packages bring along: they may stop to."""
    declared = re.search(r"^dependencies = \[(.*)\]", (ROOT / "pyproject.toml").read_text(), re.M)[
        1
    ]
    packages = set().union(*LAYERS.values()) - {"PIL"} | {"pillow"}
    assert packages == set(re.findall(r'"(\w+)', declared))


def test_modules_are_listed_and_none_is_called_utils():
    assert "utils" not in MODULES
    assert set(MODULES) == set(LAYERS)


def test_a_wheel_has_all_modules_and_the_robot(tmp_path):
    """`pip install .`, not only `pip install -e .`: all modules and go1.xml, of which the robot is
    built over there.
    """
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    found = [path for pattern in ("*.*", "runtime/*", "lab/*") for path in tmp_path.glob(pattern)]
    found = {str(path.relative_to(tmp_path)) for path in found}
    info = {path.name for path in tmp_path.glob("*.dist-info")}
    assert found - {wheel.name, *info} == {*(f"{module}.py" for module in MODULES), "go1.xml"}
    code = "import go1; print(go1.__file__, go1.build_model(0.005, None).nu)"
    built = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    assert built.stdout.split() == [str(tmp_path / "go1.py"), "12"]


def test_tags_of_the_environment_and_the_learner_are_found():
    """The parser of the tags itself: it must see every field, or a test above would pass on
    nothing; no flag twice.
    """
    for config in flags.CONFIGS:
        assert set(flags.describe(config)) == {field.name for field in fields(config)}
    assert {tasks.Config, eipo.Config, flags.Options} == set(flags.CONFIGS)
    assert "discount" in flags.describe(eipo.Config)["gamma"] and inspect.getsource(eipo.Config)
    names = [field.name for config in flags.CONFIGS for field in fields(config)]
    assert len(names) == len(set(names))
