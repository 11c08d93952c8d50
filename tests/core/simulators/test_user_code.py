"""What is loaded from the folder of custom code, and what its digest covers."""

import os
import py_compile
import shutil
import subprocess
import sys
import sysconfig
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from patience import PATIENCE

from activefail.errors import InputError
from activefail.simulators.user_code import digest_without_running, load_function

SUFFIX = sysconfig.get_config_var("EXT_SUFFIX")

EXTENSION = """
#include <Python.h>
static PyObject *run(PyObject *self, PyObject *design) { return PyLong_FromLong(%d); }
static PyMethodDef methods[] = {{"run", run, METH_O, ""}, {0}};
static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "%s", "", -1, methods};
PyMODINIT_FUNC PyInit_%s(void) { return PyModule_Create(&definition); }
"""


def compiled(folder: Path, name: str, answer: int) -> Path:
    """A compiled module whose function `run` returns the answer."""
    source, module = folder / f"{name}.c", folder / f"{name}{SUFFIX}"
    source.write_text(EXTENSION % (answer, name, name))
    include = sysconfig.get_paths()["include"]
    if not (shutil.which("cc") and Path(include, "Python.h").exists()):
        pytest.skip("no C compiler, or no headers of Python")
    subprocess.run(["cc", "-shared", "-fPIC", f"-I{include}", source, "-o", module], check=True)
    source.unlink()
    return module


def digests(reference: str, code: Path) -> str:
    """The digest of a function's code, the same whether the code runs or not."""
    _, loaded = load_function(reference, code, "simulator.python")
    assert loaded == digest_without_running(reference, code)
    return loaded


LINES = "import sys, helper\n\ndef run(design):\n    return helper.limit(1.0) < 2.0\n"

SAME = {
    "a comment": LINES + "# other\n",
    "formatting": LINES.replace("(1.0) <", "( 1.0 )  \\\n <").replace(", helper", ",helper"),
    "a docstring": LINES.replace("return", '"""Whether it fails."""\n    return'),
    "a module docstring": f'"""A model."""\n{LINES}',
    "an encoding": f"# -*- coding: latin-1 -*-\n{LINES}",
}
OTHER = {
    "a constant": LINES.replace("1.0", "1.5"),
    "another type": LINES.replace("1.0", "1"),
    "a text that is no docstring": LINES.replace("return", "x = 'a'\n    return"),
    "an operator": LINES.replace("<", "<="),
    "a name": LINES.replace("limit(1.0)", "other(1.0)"),
}


@pytest.mark.parametrize("words", [*SAME, *OTHER])
def test_the_digest_covers_what_code_does_and_not_its_words(tmp_path: Path, words: str) -> None:
    (tmp_path / "helper.py").write_text("def limit(x):\n    return x\n\n\nother = limit\n")
    (tmp_path / "model.py").write_text(LINES)
    before = digests("model:run", tmp_path)
    (tmp_path / "model.py").write_text((SAME | OTHER)[words])
    assert (digests("model:run", tmp_path) == before) is (words in SAME)


IMPORTS = {
    "import helper": "helper",
    "from helper import limit": "helper",
    "from parts import helper": "parts/helper",
    "import parts.helper": "parts/helper",
    "import importlib\nimportlib.import_module('helper')": "helper",
    "from importlib import import_module as load, import_module\nimport_module('parts.helper')": "parts/helper",
    "__import__('helper')": "helper",
    "from parts import *": "parts/helper",
    "import importlib\nnames = [f'parts.{name}' for name in 'ab']": "parts/helper",
    "from importlib import import_module as load\nload(name='helper')": "helper",
    "import importlib\nimportlib.import_module('hel' + 'per')": "helper",
    "from importlib import import_module as load\ndef run(x):\n    load(x['model'])": "helper",
    "import runpy\nrunpy.run_path('./parts/helper.py')": "parts/helper",
    "def late():\n    import helper": "helper",
}


@pytest.mark.parametrize("imported", IMPORTS)
@pytest.mark.parametrize("suffix", [".py", SUFFIX, ".abi3.so", ".so"])
def test_the_digest_covers_what_an_import_would_load(tmp_path: Path, imported: str, suffix: str) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "__init__.py").touch()
    (tmp_path / "model.py").write_text(f"{imported}\n")
    helper = tmp_path / IMPORTS[imported]
    helper.with_suffix(".py").write_text("limit = 1\n")
    before = digest_without_running("model:run", tmp_path)
    helper.with_name(helper.name + suffix).write_bytes(b"limit = 2\n")
    beside = digest_without_running("model:run", tmp_path)
    assert beside != before
    helper.with_name(helper.name + suffix).write_bytes(b"limit = 3\n")
    assert digest_without_running("model:run", tmp_path) not in (before, beside)


def test_what_a_compiled_module_may_import_is_in_the_digest(tmp_path: Path) -> None:
    (tmp_path / f"model{SUFFIX}").write_bytes(b"machine code")
    (tmp_path / "helper.py").write_text("limit = 1\n")
    before = digest_without_running("model:run", tmp_path)
    (tmp_path / "helper.py").write_text("limit = 2\n")
    assert digest_without_running("model:run", tmp_path) != before


def test_a_compiled_module_is_a_simulator_with_a_digest_and_is_loaded_once(tmp_path: Path) -> None:
    compiled(tmp_path, "fast_model", 1)
    function, digest = load_function("fast_model:run", tmp_path, "simulator.python")
    assert (function({}), digest) == (1, digest_without_running("fast_model:run", tmp_path))
    compiled(tmp_path, "fast_model", 2)
    assert digest_without_running("fast_model:run", tmp_path) != digest
    with pytest.raises(InputError, match=r"fast_model.*has changed since this process loaded it; start Python again"):
        load_function("fast_model:run", tmp_path, "simulator.python")


def test_as_python_does_a_compiled_module_precedes_the_source_beside_it(tmp_path: Path) -> None:
    compiled(tmp_path, "both_model", 1)
    (tmp_path / "both_model.py").write_text("def run(design):\n    return 2\n")
    (tmp_path / "main.py").write_text("import both_model\n\ndef run(design):\n    return both_model.run(design)\n")
    for reference in ("main:run", "both_model:run"):
        function, digest = load_function(reference, tmp_path, "simulator.python")
        assert (function({}), digest) == (1, digest_without_running(reference, tmp_path))


FORGED: dict[str, Callable[[Path], object]] = {
    "checked by time": lambda file: py_compile.compile(str(file)),
    "never checked": lambda file: py_compile.compile(
        str(file), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH
    ),
}


@pytest.mark.parametrize("kind", FORGED)
@pytest.mark.parametrize("module", ["helper", "parts/helper", "parts/__init__"])
def test_no_bytecode_runs_instead_of_its_source(tmp_path: Path, kind: str, module: str) -> None:
    (tmp_path / "parts").mkdir()
    name = module.replace("/", ".").removesuffix(".__init__")
    (tmp_path / "model.py").write_text(f"from {name} import limit\n\ndef run(design):\n    return limit\n")
    file = tmp_path / f"{module}.py"
    (tmp_path / "parts" / "__init__.py").touch()
    file.write_text("limit = 1\n")
    FORGED[kind](file)
    status = file.stat()
    file.write_text("limit = 2\n")
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))
    cache = file.parent / "__pycache__"
    cache.chmod(0o555)
    before = {path: path.read_bytes() for path in cache.iterdir()}
    code = (
        "import pathlib, sys; from activefail.simulators.user_code import load_function; "
        "print(load_function('model:run', pathlib.Path(sys.argv[1]), 'simulator.python')[0]({}))"
    )
    done = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=True)
    assert done.stdout == "2\n"
    assert {path: path.read_bytes() for path in cache.iterdir()} == before


def test_a_module_of_a_package_has_its_relative_imports(tmp_path: Path) -> None:
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "helper.py").write_text("limit = 3\n")
    lines = "from . import helper\nfrom .helper import limit\n\ndef run(design):\n    return helper.limit + limit\n"
    (tmp_path / "package" / "model.py").write_text(lines)
    for _ in range(2):  # with and without a file for the package
        function, _ = load_function("package.model:run", tmp_path, "simulator.python")
        assert function({}) == 6
        digests("package.model:run", tmp_path)
        (tmp_path / "package" / "__init__.py").touch()


def test_the_digest_of_deep_code_does_not_depend_on_where_it_is_taken(tmp_path: Path) -> None:
    (tmp_path / "model.py").write_text(f"total = {' + '.join(map(str, range(400)))}\n")

    def deeper(depth: int) -> str:
        return deeper(depth - 1) if depth else digest_without_running("model:run", tmp_path)

    assert deeper(0) == deeper(300)
    before = deeper(0)
    (tmp_path / "model.py").write_text(f"total = {' + '.join(map(str, range(401)))}\n")
    assert deeper(0) != before


def test_code_that_two_threads_load_at_once_has_its_own_helpers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, other_loaded = threading.Event(), threading.Event()
    monkeypatch.setitem(sys.modules, "gate", SimpleNamespace(began=began, other_loaded=other_loaded))
    for name, first in (("slow", "import gate\ngate.began.set()\ngate.other_loaded.wait(0.5)\n"), ("other", "")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "helper.py").write_text(f"NAME = {name!r}\n")
        (tmp_path / name / "model.py").write_text(f"{first}import helper\n\ndef run(design):\n    return helper.NAME\n")
    found = []
    slow = threading.Thread(target=lambda: found.append(load_function("model:run", tmp_path / "slow", "key")[0]({})))
    slow.start()
    assert began.wait(PATIENCE)
    assert load_function("model:run", tmp_path / "other", "key")[0]({}) == "other"
    other_loaded.set()
    slow.join()
    assert found == ["slow"]


def test_a_function_that_runs_code_of_another_folder_imports_from_its_own_afterwards(tmp_path: Path) -> None:
    for name, number in (("one", 1), ("other", 2)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "late.py").write_text(f"number = {number}\n")
        (tmp_path / name / "later.py").write_text(f"number = {10 * number}\n")
    (tmp_path / "other" / "model.py").write_text("def run(design):\n    import late\n    return late.number\n")
    (tmp_path / "one" / "model.py").write_text(
        "from pathlib import Path\n"
        "from activefail.simulators.user_code import load_function\n"
        "def run(design):\n"
        "    other, _ = load_function('model:run', Path(design), 'key')\n"
        "    import late\n"
        "    found = [late.number, other({})]\n"
        "    import later\n"
        "    return [*found, later.number]\n"
    )
    run, _ = load_function("model:run", tmp_path / "one", "key")
    assert [run(str(tmp_path / "other")) for _ in range(2)] == [[1, 2, 10]] * 2


def test_functions_of_two_folders_import_at_run_time_each_from_its_own_whatever_was_loaded_last(tmp_path: Path) -> None:
    functions = []
    for number in (1, 2):
        code = tmp_path / str(number)
        code.mkdir()
        (code / "model.py").write_text("def run(design):\n    import helper\n    return helper.count()\n")
        (code / "helper.py").write_text(
            f"calls = {1000 * number}\ndef count():\n    global calls\n    calls += 1\n    return calls\n"
        )
        functions.append(load_function("model:run", code, "classifier.features.python")[0])
    one, other = functions
    # A module is executed once, as everywhere in Python.
    assert [one({}), other({}), one({}), one({}), other({})] == [1001, 2001, 1002, 1003, 2002]
    answers: dict[int, list[int]] = {}

    def call(number: int) -> None:
        answers[number] = [functions[number]({}) for _ in range(50)]

    threads = [threading.Thread(target=call, args=(number,)) for number in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert answers == {0: [*range(1004, 1054)], 1: [*range(2003, 2053)]}
