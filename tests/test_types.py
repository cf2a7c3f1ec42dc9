"""What type checkers know of the package: public names, and the fields of scenarios."""

import importlib.metadata
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from registries import BOXES

import drake_nonstop

ROOT = Path(__file__).parents[1]


def test_the_public_names_are_those_that_type_checkers_read():
    assert len({*drake_nonstop.__all__}) == len(drake_nonstop.__all__)
    for name in drake_nonstop.__all__:
        if name != "__version__":
            assert getattr(drake_nonstop, name) is getattr(drake_nonstop.public, name)


# What type checkers find out of expressions, and lines that they have to refuse.
REVEALED = {
    'load_scenario("quintic").system': "SystemParameters",
    "ConstantParameters": "ConstantParameters",
    "ConstantParametersConfig().frequency": "float",
    "make_nonstop": "LoopConfig",
}
SEEN = "".join(f'load_scenario("quintic").{box}\n' for box in BOXES)  # else: missing in BoxFields
REFUSED = (
    'load_scenario("quintic").sytem',
    'load_scenario("quintic").system.load_mass = "heavy"',
    'load_scenario("quintic", "simulation_duration=1").nothing',
    "ConstantParametersConfig(frequncy=1.0)",
    'ConstantParametersConfig(frequency="fast")',
    'simulate("quintic")',
    'simulate(load_scenario("quintic"), engine=1)',
    'simulate(load_scenario("quintic")).signal(3)',
    'compute_metrics(load_scenario("quintic"))',
    'make_nonstop(load_scenario("quintic")).GetOutputPorts()',
)
IMPORTS = (
    "from drake_nonstop import ConstantParameters, ConstantParametersConfig, compute_metrics\n"
    "from drake_nonstop import load_scenario, make_nonstop, simulate\n"
)
# Of Drake's stubs: the type of elements in place of an array's shape, and an object
# in place of the value of a port.
WRONG_IN_DRAKE = re.compile(
    r"ndarray\[float64, dtype\[Any\]\]|DeclareDiscreteState|num_state_vari|attribute \"round\"|"
    r"CubicWithContinuousSecondDerivatives"
)


@pytest.fixture(scope="module")
def typed_pages(tmp_path_factory):
    """Files with the code of each page, as a reader saves it, and with the lines above."""
    folder = tmp_path_factory.mktemp("pages")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        scripts = []
        for code in re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL):
            name = re.match(r"# (\w+\.py)\n", code)
            if name:
                (folder / name[1]).write_text(code, encoding="utf-8")
            else:
                scripts.append(code)
        if scripts:
            file = folder / f"page_{path.stem}.py"
            file.write_text("\n\n".join(scripts), encoding="utf-8")
    assert len([*folder.glob("page_*.py")]) > 10
    shown = "".join(f"reveal_type({expression})\n" for expression in REVEALED)
    (folder / "seen.py").write_text(IMPORTS + SEEN, encoding="utf-8")
    (folder / "revealed.py").write_text(IMPORTS + shown, encoding="utf-8")
    (folder / "refused.py").write_text("\n".join((IMPORTS, *REFUSED, "")), encoding="utf-8")
    place = importlib.metadata.distribution("drake-nonstop").read_text("direct_url.json") or "{}"
    is_own = json.loads(place).get("url") == ROOT.as_uri()
    paths = [] if is_own else [str(ROOT)]  # of the installed package where that is this one
    (folder / "pyrightconfig.json").write_text(json.dumps({"extraPaths": paths}))
    return folder, paths


def by_mypy(folder, paths):
    """The errors and what is revealed: file, line, text."""
    call = [sys.executable, "-m", "mypy", "--cache-dir", "cache", "--check-untyped-defs"]
    call += ["--output", "json", *sorted(file.name for file in folder.glob("*.py"))]
    environment = {**os.environ, "MYPYPATH": os.pathsep.join(paths)}
    shown = subprocess.run(call, cwd=folder, capture_output=True, text=True, env=environment)
    assert not shown.stderr, shown.stderr
    for line in shown.stdout.splitlines():
        note = json.loads(line)
        yield note["file"], note["line"], note["message"]


def by_pyright(folder, paths):
    call = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "--outputjson", "."]
    environment = {**os.environ, "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}
    shown = subprocess.run(call, cwd=folder, capture_output=True, text=True, env=environment)
    for note in json.loads(shown.stdout)["generalDiagnostics"]:
        if note["severity"] != "warning":
            yield Path(note["file"]).name, note["range"]["start"]["line"] + 1, note["message"]


@pytest.mark.nightly("examples")
@pytest.mark.parametrize("check", [by_mypy, by_pyright])
def test_types_of_the_pages(typed_pages, check):
    """Code of the pages is right for type checkers, and wrong lines are not."""
    found = [note for note in check(*typed_pages) if not WRONG_IN_DRAKE.search(note[2])]
    elsewhere = [note for note in found if note[0] not in ("refused.py", "revealed.py")]
    assert not elsewhere, "\n".join(map(str, elsewhere))
    first = IMPORTS.count("\n") + 1
    shown = [text for file, _, text in found if file == "revealed.py"]
    for text, expected in zip(shown, REVEALED.values(), strict=True):
        assert expected in text
        assert 'is "Any"' not in text
    lines = {line for file, line, _ in found if file == "refused.py"}
    assert [REFUSED[k] for k in range(len(REFUSED)) if k + first + 1 not in lines] == []
