"""That a process which starts with an empty cache compiles everything once, and that stale kernels are not used."""

from __future__ import annotations

import ast
import inspect
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import zsight_core
from zsight_core import kernel_cache
from zsight_core.warm import is_warm, kernel_modules

PACKAGE = Path(inspect.getfile(zsight_core)).parent


def run(code: str, **environment: str) -> str:
    """What the code prints in a fresh process."""
    kept = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    answer = subprocess.run(
        [sys.executable, "-c", code], env=kept | environment, capture_output=True, text=True, check=True, timeout=100
    )
    return answer.stdout.strip()


def sources() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def test_every_module_with_kernels_has_a_warm_up() -> None:
    with_kernels = {path for path in sources() if "@njit" in path.read_text() or "@guvectorize" in path.read_text()}
    named = {PACKAGE.joinpath(*name.split(".")[1:]).with_suffix(".py") for name in kernel_modules()}
    assert with_kernels - named == set(), "these files define kernels and no warm_up()"


def test_every_kernel_is_made_by_our_own_decorator() -> None:
    own = {PACKAGE / "jit.py", PACKAGE / "kernel_loading.py"}
    assert [path for path in sources() if path not in own and "from numba import" in path.read_text()] == []


def test_kernels_compiled_into_other_files_are_part_of_the_cache_key() -> None:
    shared = {path.relative_to(PACKAGE).as_posix() for path in sources() for path in _compiled_in(path)}
    assert shared - set(kernel_cache.SHARED) == set(), "add these to kernel_cache.SHARED"


def _compiled_in(path: Path) -> set[Path]:
    """Files whose names (kernels, or constants frozen at compile time) the kernels of this file use."""
    tree = ast.parse(path.read_text())
    origin: dict[str, Path] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("zsight_core"):
            for alias in node.names:
                base = PACKAGE.joinpath(*(node.module or "").split(".")[1:])
                inner = (base / alias.name).with_suffix(".py")
                origin[alias.asname or alias.name] = inner if inner.exists() else base.with_suffix(".py")
    kernels = [
        node
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and any("njit" in ast.unparse(mark) for mark in node.decorator_list)
    ]
    for node in [node for kernel in kernels for node in ast.walk(kernel) if isinstance(node, ast.AnnAssign)]:
        node.annotation = ast.Constant(None)  # what is only named in an annotation is not compiled in
    used = {
        name.id for kernel in kernels for line in kernel.body for name in ast.walk(line) if isinstance(name, ast.Name)
    }
    return {origin[name] for name in used & set(origin)}


def test_cache_folder_is_chosen_before_numba_is_imported(tmp_path: Path) -> None:
    code = "import zsight_core, sys; assert 'numba' not in sys.modules; import numba; print(numba.config.CACHE_DIR)"
    chosen = Path(run(code, XDG_CACHE_HOME=str(tmp_path)))
    assert chosen.parent == tmp_path / "zsight"
    assert chosen.name.startswith(f"kernels-{sys.implementation.cache_tag}")
    assert run(code, NUMBA_CACHE_DIR=str(tmp_path / "own")) == str(tmp_path / "own")


def test_cache_folder_where_home_is_not_writable(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way of a folder")
    code = "from zsight_core import kernel_cache; print(kernel_cache.folder())"
    chosen = Path(run(code, XDG_CACHE_HOME=str(blocked / "cache"), TMPDIR=str(tmp_path)))
    assert tmp_path in chosen.parents


def test_importing_numba_first_still_uses_the_folder(tmp_path: Path) -> None:
    code = "import numba; import zsight_core; print(numba.config.CACHE_DIR)"
    assert str(tmp_path) in run(code, XDG_CACHE_HOME=str(tmp_path))


def test_kernels_are_kept_and_a_changed_source_is_noticed(tmp_path: Path) -> None:
    package = tmp_path / "code" / "zsight_core"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    code = (
        f"import sys; sys.path.insert(0, {str(package.parent)!r})\n"
        "import numpy as np, zsight_core.rigid as rigid, zsight_core.kernel_cache as cache, zsight_core.warm as warm\n"
        f"assert rigid.__file__.startswith({str(tmp_path)!r})\n"
        "before = warm.is_warm(); rigid.warm_up(); stats = rigid._transform_words.stats; cache.stamp()\n"
        "print(before, sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), warm.is_warm())"
    )
    cache = str(tmp_path / "cache")
    assert run(code, XDG_CACHE_HOME=cache) == "False 0 1 True"
    assert run(code, XDG_CACHE_HOME=cache) == "True 1 0 True"
    with (package / "rigid.py").open("a") as source:
        source.write("\n# changed\n")
    assert run(code, XDG_CACHE_HOME=cache) == "False 0 1 True"
    with (package / "moments.py").open("a") as source:  # not used by rigid.py, but by some kernels elsewhere
        source.write("\n# changed\n")
    assert run(code, XDG_CACHE_HOME=cache) == "False 0 1 True"


FIRST_CALLS = """
import sys
from pathlib import Path
from numba.core import event
from tests.core.clouds import random_cloud
from tests.core.test_kernel_laws import EXACT, KERNELS, LARGE
from zsight_core.files import pcd, ply

class Compiled(event.Listener):
    def on_start(self, event):
        names.add(event.data["dispatcher"].py_func.__qualname__)
    def on_end(self, event):
        pass

names, cloud = set(), random_cloud()
with event.install_listener("numba:compile", Compiled()):
    for kernel in KERNELS.values():
        kernel(cloud)
    for kernel in (LARGE | EXACT).values():
        kernel(cloud, None)
    for name in ("ascii.pcd", "binary.pcd", "binary_compressed.pcd", "ascii.ply", "binary_little_endian.ply"):
        file, module = Path(sys.argv[1]) / name, ply if name.endswith("ply") else pcd
        module.write(file, cloud, encoding=file.stem)
        module.read(file)
print(sorted(names), "numba.np.linalg" in sys.modules)
"""


@pytest.mark.usefixtures("warm_kernels")
def test_first_calls_compile_nothing_and_load_no_compiler(tmp_path: Path) -> None:
    answer = subprocess.run(
        [sys.executable, "-c", FIRST_CALLS, str(tmp_path)], capture_output=True, text=True, check=True, timeout=100
    )
    assert answer.stdout.strip() == "[] False"


def test_a_kernel_that_was_loaded_is_compiled_into_another(tmp_path: Path) -> None:
    code = (
        "import sys, numpy as np\n"
        "from zsight_core.disjoint_sets import unite, warm_up\n"
        "import numba\n"
        "warm_up(); print(sum(unite.stats.cache_hits.values()), 'numba.np.linalg' in sys.modules)\n"
        "@numba.njit\n"
        "def joined(parent):\n"
        "    unite(parent, 2, 1)\n"
        "    return parent[2]\n"
        "print(joined(np.arange(3)))"
    )
    assert run(code, XDG_CACHE_HOME=str(tmp_path)).split() == ["0", "True", "1"]
    assert run(code, XDG_CACHE_HOME=str(tmp_path)).split() == ["1", "False", "1"]


def test_is_warm_is_cheap(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert not is_warm()
    kernel_cache.stamp()
    assert is_warm()
