"""The layering rule and the one-place rules of the design, over every module of the package."""

import ast
from itertools import chain
from pathlib import Path

import pytest

import nnql_bullet

PACKAGE = Path(nnql_bullet.__file__).resolve().parent

# Low to high. A module imports from lower layers and, inside one folder, from its siblings. A new top-level module or
# folder has to be given its place here.
LAYERS = (
    ("paper", "errors", "files", "colours", "jit"),
    ("config", "assets", "geometry", "seeding", "executors"),
    ("worlds", "vehicle", "sensing"),
    ("sim",),
    ("task",),
    ("env",),
    ("mapping",),
    ("agents",),
    ("shield",),
    ("rollout",),
    ("training", "recording", "fidelity"),
    ("render",),
    ("experiment",),
    ("runs", "gym_env", "diagnosis"),
    ("evaluation",),
    ("reports",),
    ("cli",),
    ("__main__",),
)
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}

MODULES = {
    ".".join(("nnql_bullet", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
    if "_data" not in path.parts
}
TREES = {name: ast.parse(path.read_text(encoding="utf-8"), str(path)) for name, path in MODULES.items()}

modules = pytest.mark.parametrize("module", [name for name in MODULES if name != "nnql_bullet"])
modules_and_root = pytest.mark.parametrize("module", list(MODULES))


def top(module):
    """The top-level module or folder that a module belongs to."""
    return module.split(".")[1]


def imported(module):
    """Every module that is imported anywhere in a module, in functions too."""
    package = module if MODULES[module].name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, *filter(None, [node.module])])
            for alias in node.names:
                name = f"{base}.{alias.name}"
                yield name if name in MODULES else base


def called(module):
    """The dotted name of everything that is called in a module, and the call."""
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node


def test_every_top_level_module_and_folder_has_a_layer():
    there = {top(module) for module in MODULES if module != "nnql_bullet"}
    assert there == set(LEVEL)
    assert len(LEVEL) == len(list(chain.from_iterable(LAYERS)))


@modules
def test_module_imports_only_from_lower_layers(module):
    inside = [name for name in imported(module) if name.startswith("nnql_bullet.")]
    wrong = [name for name in inside if top(name) != top(module) and LEVEL[top(name)] >= LEVEL[top(module)]]
    assert not wrong, f"{module} ({top(module)}) imports {wrong}, which are not below it"


def test_importing_the_package_itself_imports_none_of_its_modules():
    assert not [name for name in imported("nnql_bullet") if name.startswith("nnql_bullet")]


def test_numbers_of_the_paper_import_nothing_of_the_package():
    for module in ("nnql_bullet.paper", "nnql_bullet.errors", "nnql_bullet.files"):
        assert not [name for name in imported(module) if name.startswith("nnql_bullet")]


def test_modules_do_not_import_one_another_in_circles():
    edges = {module: {name for name in imported(module) if name in MODULES and name != module} for module in MODULES}
    while leaves := [module for module, needs in edges.items() if not needs & edges.keys()]:
        for module in leaves:
            del edges[module]
    assert not edges, f"these import one another: {sorted(edges)}"


@modules_and_root
def test_only_the_bullet_simulator_imports_pybullet(module):
    uses = [name for name in imported(module) if name.split(".")[0] in ("pybullet", "pybullet_data", "pybullet_utils")]
    assert not uses or module == "nnql_bullet.sim.bullet"


@modules_and_root
def test_only_the_command_line_prints_or_exits(module):
    if module.startswith("nnql_bullet.cli") or module == "nnql_bullet.__main__":
        return
    loud = {"print", "exit", "quit", "sys.exit", "os._exit", "sys.stdout.write", "sys.stderr.write"}
    assert not [f"line {call.lineno}: {name}" for name, call in called(module) if name in loud]


@modules_and_root
def test_only_the_mujoco_simulator_imports_mujoco(module):
    assert "mujoco" not in {name.split(".")[0] for name in imported(module)} or module == "nnql_bullet.sim.mujoco"


@modules_and_root
def test_only_the_rrd_report_imports_rerun(module):
    assert "rerun" not in {name.split(".")[0] for name in imported(module)} or module == "nnql_bullet.reports.rrd"


@modules_and_root
def test_only_the_vtk_renderer_imports_vtk(module):
    libraries = {name.split(".")[0] for name in imported(module)}
    assert not libraries & {"pyvista", "vtk", "vtkmodules"} or module == "nnql_bullet.render.vtk"


@modules_and_root
@pytest.mark.parametrize(("library", "home"), [("stable_baselines3", "training.sb3"), ("deap", "training.evolution")])
def test_libraries_that_only_train_are_imported_in_one_module(module, library, home):
    assert library not in {name.split(".")[0] for name in imported(module)} or module == f"nnql_bullet.{home}"


@modules_and_root
def test_randomness_comes_from_generators_that_are_passed_in(module):
    if module == "nnql_bullet.seeding":  # makes them, and fences in libraries that take none
        return
    assert "random" not in {name.split(".")[0] for name in imported(module)}
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Attribute):
            name = ast.unparse(node)
            if name.startswith(("np.random.", "numpy.random.")):
                assert name.endswith(".Generator"), f"line {node.lineno}: {name} belongs in seeding.py"
            assert name not in ("torch.manual_seed", "torch.random.manual_seed", "torch.seed"), f"line {node.lineno}"


@modules_and_root
def test_nothing_runs_code_that_it_reads(module):
    assert not {name.split(".")[0] for name in imported(module)} & {"pickle", "dill", "cloudpickle", "joblib", "shelve"}
    for name, call in called(module):
        where = f"line {call.lineno}: {name}"
        assert name not in ("eval", "exec", "compile", "__import__", "os.system", "os.popen", "torch.load"), where
        keywords = {keyword.arg: keyword.value for keyword in call.keywords}
        for keyword in ("shell", "allow_pickle"):
            value = keywords.get(keyword)
            assert value is None or ast.unparse(value) == "False", f"{where}({keyword}=...)"


def numbers_bound_in(module):
    """Names that a module's top level binds to numbers written there."""
    for node in TREES[module].body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value:
            constants = [part.value for part in ast.walk(node.value) if isinstance(part, ast.Constant)]
            if constants and all(isinstance(constant, int | float) for constant in constants):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                yield from (part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name))


@modules_and_root
def test_numbers_of_the_paper_are_bound_nowhere_else(module):
    papers = set(numbers_bound_in("nnql_bullet.paper"))
    assert len(papers) > 15
    assert module == "nnql_bullet.paper" or not papers & set(numbers_bound_in(module))


@modules_and_root
def test_every_assertion_is_in_the_tests(module):
    """An assert is gone under `python -O`; what can go wrong is an exception."""
    assert not [node.lineno for node in ast.walk(TREES[module]) if isinstance(node, ast.Assert)]
