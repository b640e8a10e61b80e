"""The promises of the layout: imports, tags, and pages whose tables, links and quotes are true."""

import ast
import importlib
import inspect
import re
import sys
from dataclasses import fields
from pathlib import Path

import pytest

import eipo
import train
from results import paper, tables
from runtime import flags

ROOT = Path(train.__file__).parent
FOLDERS = "runtime", "results", "tutorial"
FILES = [*ROOT.glob("*.py"), *(path for x in FOLDERS for path in (ROOT / x).glob("*.py"))]
MODULES = sorted(str(path.relative_to(ROOT).with_suffix("")) for path in FILES)
# imports go down this list, never up; the second entry is what a module may import beyond it and
# the standard library. The paper's part ends with eipo. results/ comes after all of it
LAYERS = {
    "policy": {"numpy"},  # it runs on a robot, without the rest
    "energy": {"numpy"},
    "rewards": {"numpy"},
    "terrain": {"numpy", "scipy"},
    "tasks": {"numpy", "scipy"},
    "go1": {"numpy", "mujoco", "scipy"},
    "go1_env": {"numpy", "mujoco", "scipy"},
    "networks": {"numpy", "jax"},
    "mirror": {"numpy", "jax"},
    "runtime/__init__": set(),
    "runtime/cli": set(),
    "runtime/kinds": set(),
    "ppo": {"numpy", "jax", "optax"},
    "eipo": {"numpy", "jax"},
    "runtime/robot": {"numpy", "mujoco"},
    "runtime/run_folder": {"numpy"},
    "evaluate": {"numpy", "scipy"},
    "runtime/viewer": {"numpy", "mujoco", "PIL"},
    "play": {"numpy"},
    "runtime/jax_setup": {"jax"},
    "runtime/flags": set(),
    "runtime/checkpoint": {"numpy", "jax"},
    "runtime/metrics": {"numpy", "matplotlib"},
    "runtime/start": set(),
    "train": set(),
}
# what the learner may import of ours: it knows no robot, no file and no process
LEARNER = dict(
    networks=set(),
    mirror={"networks"},
    ppo={"networks"},
    eipo={"networks", "ppo"},
)
PACKAGES = set().union(*LAYERS.values())


def source(module):
    return (ROOT / f"{module}.py").read_text()


def imports(module):
    """The modules of ours and the packages beyond the standard library that a module imports."""
    imported = set()
    for node in ast.walk(ast.parse(source(module))):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package, *inside = node.module.split(".")
            names = inside or [alias.name for alias in node.names]
            ours = package in FOLDERS
            imported |= {f"{package}/{x}" for x in names} if ours else {package}
    return imported - set(sys.stdlib_module_names)


@pytest.mark.parametrize("module", MODULES)
def test_imports_go_one_way(module):
    """A reader may stop at any file: the paper's equations know nothing of the environment, and so
    on.
    """
    if module.startswith(("results/", "tutorial/")):
        assert imports(module) <= set(MODULES) | PACKAGES
        return
    above = list(LAYERS)[: list(LAYERS).index(module)]
    assert imports(module) <= LAYERS[module] | set(above)
    if module in LEARNER:
        assert imports(module) & set(LAYERS) == LEARNER[module]
        assert not re.search(r"^(import|from) (os|pathlib|json)\b", source(module), re.M)


def test_modules_are_listed_and_packages_declared():
    """Not only what other packages bring along: they may stop to."""
    others = "results/", "tutorial/"
    assert {module for module in MODULES if not module.startswith(others)} == set(LAYERS)
    page = (ROOT / "pyproject.toml").read_text()
    declared = re.search(r"^dependencies = \[(.*)\]", page, re.M)[1]
    assert PACKAGES - {"PIL"} | {"pillow"} == set(re.findall(r'"(\w+)', declared))


@pytest.mark.parametrize("module", MODULES)
def test_what_is_public_is_documented(module):
    tree = ast.parse(source(module))
    kinds = ast.FunctionDef | ast.ClassDef
    classes = [n for n in tree.body if isinstance(n, ast.ClassDef)]
    inside = [n for part in (tree, *classes) for n in part.body if isinstance(n, kinds)]
    public = [n for n in inside if not n.name.startswith("_")]
    assert [n.name for n in [*public, tree] if not ast.get_docstring(n)] == []


@pytest.mark.parametrize("config", flags.GROUPS.values(), ids=lambda c: c.__module__)
def test_every_setting_says_what_it_is_and_is_used(config):
    """A flag that nothing reads, or a number without a source, is how copies rot."""
    comments = flags.describe(config)
    assert set(comments) == {field.name for field in fields(config)}
    code = "".join(source(module) for module in MODULES)
    for name, comment in comments.items():
        if config is not flags.Options:
            assert re.match(r"\[(I|II|III|IV|V|lab code|ours|Eq\.)[-\w. ]*\] \S", comment), name
        assert re.search(rf"(config|cfg|options)\.{name}\b", code), f"unread: {name}"


# ---- pages ----


def table_rows(page):
    """The table of equations on a page: [(tag, functions)]."""
    row = r"^\| ((?:Eq|Alg|Section)[^|]*) \| ([^|]*) \|$"
    rows = re.findall(row, (ROOT / page).read_text(), re.M)
    return [(tag, re.findall(r"`([\w.]+)`", where)) for tag, where in rows]


def test_equation_table_resolves_both_ways():
    """Every row names functions that exist, and every equation in the source has a row."""
    rows = table_rows("tests/paper/README.md")
    for tag, where in rows:
        assert where, tag
        for name in where:
            module, attribute = name.rsplit(".", 1)
            assert hasattr(importlib.import_module(module), attribute), name
    listed = {int(n) for tag, _ in rows for n in re.findall(r"\d+", tag) if tag.startswith("Eq")}
    used = {int(n) for module in MODULES for n in re.findall(r"Eq\. \((\d+)\)", source(module))}
    assert used | set(range(1, 12)) == listed


TAGS = [f"eq{n:02}" for n in range(1, 12)]
TAGS += [f"line{n:02}" for n in (3, 4, *range(6, 15))]


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
    folders = [ROOT / name for name in ("docs", "results", "runtime", "tests", "tutorial")]
    files = [*ROOT.glob("*.*"), *(path for folder in folders for path in folder.rglob("*.*"))]
    for path in files:
        if path.suffix in (".md", ".py", ".xml"):
            cited = {int(n) for n in re.findall(r"\bD(\d+)\b", path.read_text())}
            assert cited <= set(entries), path


# words at most, as `wc -w` counts them
PAGES = {
    "README.md": 850,
    "tutorial.md": 5700,
    "deviations.md": 2900,
    "results/README.md": 1800,
    "results/paper.md": 1300,
    "docs/deploy.md": 900,
    "docs/runs.md": 700,
    "tests/paper/README.md": 450,
}


@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_short_and_reads_as_it_is_meant(page):
    """No line of a paragraph begins like an item of a list, of which GitHub would make one."""
    text = (ROOT / page).read_text()
    assert len(text.split()) <= PAGES[page]
    prose = re.sub(r"^```.*?^```$|^    .*$", "", text, flags=re.M | re.S)
    for paragraph in re.split(r"\n\s*\n", prose):
        first, *rest = paragraph.strip().splitlines() or [""]
        item = r"\s*([-+*]|\d+[.)])\s"
        wrong = [line for line in rest if re.match(item, line) and not re.match(item, first)]
        assert not wrong, wrong[0]


def test_there_is_no_other_page():
    found = {str(path.relative_to(ROOT)) for path in ROOT.rglob("*.md")}
    assert {page for page in found if not page.startswith((".", "runs/"))} == set(PAGES)
    assert sum(len((ROOT / page).read_text().split()) for page in PAGES) <= 14_500


def anchors(page):
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.M)
    return {re.sub(r"[^\w\- ]", "", x.lower()).replace(" ", "-") for x in headings}


@pytest.mark.parametrize("page", PAGES)
def test_every_link_leads_somewhere(page):
    place = (ROOT / page).parent
    for link in re.findall(r"\]\(([^):]+)\)", (ROOT / page).read_text()):
        file, _, anchor = link.partition("#")
        target = place / file if file else ROOT / page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_tables_of_pages_are_what_the_commands_print():
    """If this fails because a run was added: print them again, and read the sentences around."""
    places = [ROOT / "results" / task for task in ("flat", "rough", "velocity", "curriculum")]
    page = (ROOT / "README.md").read_text()
    assert "\n".join(tables.readme(places)) in page
    page = (ROOT / "results/README.md").read_text()
    for place in places:
        for table in "\n".join(tables.short([place])).split("\n\n"):
            assert table.strip() in page
    assert "\n".join(paper.paper(places)) in (ROOT / "results/paper.md").read_text()


def test_what_the_readme_points_at_exists():
    text = (ROOT / "README.md").read_text()
    shown = re.findall(r"play\.py (results/\S+)", text)
    assert shown and all((ROOT / folder / "policy.npz").exists() for folder in shown)
    for name in re.findall(r"`([\w/]+\.(?:py|xml|txt))`", text):
        assert (ROOT / name).exists(), name


def test_readme_quotes_algorithm_1_as_it_is():
    """Its lines are those of `eipo.eipo`, in order."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    quoted = [line for line in code.splitlines() if not line.startswith("#")]
    source_lines = [line.strip() for line in inspect.getsource(eipo.eipo).splitlines()]
    places = [source_lines.index(line) for line in quoted]
    assert len(places) > 4 and places == sorted(places)
