"""Who may import whom: read from the source, so that an import inside a function counts too."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.sources import import_statements

PACKAGE = Path(__file__).parents[1] / "torchweather"

# A part may import those of its own layer or a lower one; each name is a module or a folder of the package.
LAYERS: tuple[frozenset[str], ...] = (
    frozenset({"core"}),
    frozenset({"physics"}),
    frozenset({"atmosphere", "pipeline"}),
    frozenset({"camera", "lidar", "radar"}),
    frozenset({"image", "sensors", "stages", "transforms"}),
    frozenset({"io"}),
    frozenset({"compose", "recipes"}),
    frozenset({"scenes", "export", "explain"}),
    frozenset({"datasets", "gap"}),
    frozenset({"evaluation"}),
    frozenset({"report"}),
    frozenset({"cli"}),
)
LAYER_OF = {name: number for number, names in enumerate(LAYERS) for name in names}
# It needs nothing but the core, and the mosaics of ``camera``.
ONLY_ERRORS = "metrics"

# Libraries outside: where each may be imported; everything else may be imported anywhere but in physics.
CONFINED: dict[str, set[str]] = {
    "onnx": {"export"},
    "onnxscript": {"export"},
    "onnxruntime": {"camera", "evaluation", "export"},
    "matplotlib": {"report"},
    "jinja2": {"report"},
    "kornia": {"camera", "metrics"},
    "av": {"io"},
    "laspy": {"io"},
    "rosbags": {"io"},
    "pyarrow": {"io"},
    "pycocotools": {"metrics"},
    "torchvision": set(),
    "PIL": {"io", "report"},
    "tqdm": {"cli", "gap", "report"},
}
PHYSICS_NEEDS = {"torch", "numpy", "torchweather"}


# Old paths: each holds nothing but `moved`.
FACADES = frozenset({"augment", "distributions", "errors", "random", "robustness", "sweep", "weather"})


def files() -> list[Path]:
    found = [path for path in sorted(PACKAGE.rglob("*.py")) if "_recipes" not in path.parts]
    return [path for path in found if path.relative_to(PACKAGE).parts[0].removesuffix(".py") not in FACADES]


def part_of(path: Path) -> str:
    """``torchweather/pipeline/chain.py`` belongs to ``stages``, ``torchweather/core/random.py`` to ``random``."""
    relative = path.relative_to(PACKAGE)
    return relative.parts[0] if len(relative.parts) > 1 else relative.stem


@cache
def imports(path: Path) -> list[tuple[str, int]]:
    """Absolute names that a file imports, and the lines; imports for type checkers only are left out."""
    found = []
    for node, for_types in import_statements(path):
        if for_types:
            continue
        if isinstance(node, ast.Import):
            found += [(alias.name, node.lineno) for alias in node.names]
            continue
        if node.level:
            assert not path.is_relative_to(PACKAGE), f"{path}:{node.lineno}: a relative import"
            continue
        module = node.module or ""
        if module == "torchweather":
            found += [(f"torchweather.{alias.name}", node.lineno) for alias in node.names]
        else:
            found.append((module, node.lineno))
    return found


@cache
def all_imports() -> list[tuple[str, str, str]]:
    """(part, imported name, place) of the whole package."""
    return [
        (part_of(path), name, f"{path.relative_to(PACKAGE.parent)}:{line}")
        for path in files()
        for name, line in imports(path)
    ]


def test_every_part_has_a_layer() -> None:
    known = set(LAYER_OF) | {ONLY_ERRORS, "__init__", "__main__"}
    assert {part_of(path) for path in files()} <= known


def test_nobody_imports_upwards() -> None:
    wrong = []
    for part, name, place in all_imports():
        if not name.startswith("torchweather.") or part in ("__init__", "__main__"):
            continue
        other = name.split(".")[1]
        if other not in LAYER_OF and other != ONLY_ERRORS:
            continue  # a public name of the package itself, such as __version__
        if part == ONLY_ERRORS:
            allowed = other in ("core", "camera", ONLY_ERRORS)
        elif other == ONLY_ERRORS:
            allowed = LAYER_OF[part] >= LAYER_OF["gap"]
        else:
            allowed = LAYER_OF[other] <= LAYER_OF[part]
        if not allowed:
            wrong.append(f"{place}: {part} imports {name}")
    assert not wrong, "\n".join(wrong)


def imported_files(path: Path, modules: dict[str, Path]) -> set[Path]:
    """Files of the package that a file imports, in functions and for type checkers as well."""
    names = set()
    for node, _ in import_statements(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif node.module:
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= {name if name in modules else node.module for name in whole}
    return {modules[name] for name in names if name in modules} - {path}


def circles(graph: dict[Path, set[Path]]) -> list[list[str]]:
    """Groups of files that import each other, whatever the way round: strongly connected ones, by Kosaraju."""
    order: list[Path] = []
    seen: set[Path] = set()

    def visit(start: Path, edges: dict[Path, set[Path]], found: list[Path]) -> None:
        stack = [(start, iter(sorted(edges[start])))]
        seen.add(start)
        while stack:
            path, others = stack[-1]
            other = next((one for one in others if one not in seen), None)
            if other is None:
                found.append(path)
                stack.pop()
            else:
                seen.add(other)
                stack.append((other, iter(sorted(edges[other]))))

    for path in graph:
        if path not in seen:
            visit(path, graph, order)
    back: dict[Path, set[Path]] = {path: set() for path in graph}
    for path, others in graph.items():
        for other in others:
            back[other].add(path)
    seen.clear()
    groups = []
    for path in reversed(order):
        if path not in seen:
            group: list[Path] = []
            visit(path, back, group)
            groups.append(group)
    return [sorted(str(path) for path in group) for group in groups if len(group) > 1]


def test_no_files_import_in_a_circle() -> None:
    modules = {".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts): path for path in files()}
    modules = {name.removesuffix(".__init__"): path for name, path in modules.items()}
    found = circles({path: imported_files(path, modules) for path in files()})
    assert not found, "\n".join(", ".join(group) for group in found)


def test_a_circle_of_files_is_seen() -> None:
    a, b, c, d = (Path(name) for name in "abcd")
    assert circles({a: {b}, b: {c}, c: {a}, d: {a}}) == [["a", "b", "c"]]
    assert circles({a: {b}, b: {c}, c: set(), d: {a}}) == []


def test_physics_needs_torch_and_numpy_only() -> None:
    wrong = [
        f"{place}: {name}"
        for part, name, place in all_imports()
        if part == "physics" and name.split(".")[0] not in PHYSICS_NEEDS | sys.stdlib_module_names
    ]
    assert not wrong, "\n".join(wrong)


def test_physics_knows_nothing_of_weather_and_sensors() -> None:
    allowed = {"torchweather.core", "torchweather.physics"}
    wrong = [
        f"{place}: {name}"
        for part, name, place in all_imports()
        if part == "physics" and name.startswith("torchweather") and ".".join(name.split(".")[:2]) not in allowed
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("library", list(CONFINED))
def test_heavy_libraries_stay_where_they_belong(library: str) -> None:
    wrong = [
        f"{place}: {part} imports {name}"
        for part, name, place in all_imports()
        if name.split(".")[0] == library and part not in CONFINED[library]
    ]
    assert not wrong, "\n".join(wrong)


def test_torchvision_is_nowhere_in_the_repository() -> None:
    root = PACKAGE.parent
    for folder in ("torchweather", "tests", "examples", "benchmarks", "docs"):
        for path in (root / folder).rglob("*.py"):
            if "torchvision" in path.read_text(encoding="utf-8"):
                assert all(name.split(".")[0] != "torchvision" for name, _ in imports(path)), path


def loaded_by(statement: str) -> set[str]:
    """Top-level packages that a fresh interpreter has loaded after a statement."""
    code = f"{statement}\nimport sys\nprint(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=PACKAGE.parent)
    return set(done.stdout.split())


def test_importing_the_package_is_light() -> None:
    assert not loaded_by("import torchweather") & {
        "torch",
        "numpy",
        "kornia",
        "matplotlib",
        "onnx",
        "onnxruntime",
        "PIL",
    }
