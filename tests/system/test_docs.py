"""The documentation holds: every command and program on its pages runs and prints what the page shows."""

from __future__ import annotations

import importlib.util
import re
from typing import TYPE_CHECKING

import pytest
import typer
from tests.system.doc_page import PAGES, REPOSITORY, Fence, Place, differs, fences, is_run, pairs, provide, run_fence
from typer.main import get_command

from zsight.cli.application import COMMANDS, app

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import ModuleType


RUN = [(fence, following) for page in PAGES for fence, following in pairs(page) if is_run(fence)]


@pytest.fixture(scope="module")
def places() -> Iterator[dict[Path, Place]]:
    """A place for each page, made when its first fence is run."""
    made: dict[Path, Place] = {}
    yield made
    for place in made.values():
        place.close()


@pytest.mark.system
@pytest.mark.timeout(180)
@pytest.mark.parametrize(("fence", "following"), RUN, ids=[str(fence) for fence, _ in RUN])
def test_a_fence_does_what_the_page_shows(
    fence: Fence, following: Fence | None, places: dict[Path, Place], tmp_path_factory: pytest.TempPathFactory
) -> None:
    if fence.page not in places:
        places[fence.page] = Place(tmp_path_factory.mktemp(fence.page.stem))
    place = places[fence.page]
    if fence.needs and not provide(place, fence.needs):
        pytest.skip(f"needs {fence.needs}")
    done = run_fence(place, fence, following)
    for position, (command, shown, came, code) in enumerate(done):
        if position + 1 == len(done) or done[position + 1][0] != "echo $?":
            assert code == 0, f"$ {command}\n" + "\n".join(came)
        difference = differs(shown, came, numbers_vary=fence.numbers_vary)
        again = f"if that is right: python -m tests.system.doc_page {fence.page.relative_to(REPOSITORY)}"
        assert difference is None, f"$ {command}\n{difference}\n{again}"


def test_the_tutorial_is_run() -> None:
    kinds = [fence.kind for fence, _ in RUN if fence.page.name == "tutorial.md"]
    assert kinds.count("console") >= 12
    assert kinds.count("python") >= 2


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_every_link_leads_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    missing = [t for t in targets if not t.startswith("https://") and not (page.parent / t).exists()]
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_every_fence_with_prompts_is_found(page: Path) -> None:
    prompts = page.read_text(encoding="utf-8").count("\n$ ")
    assert prompts == sum(("\n" + fence.body).count("\n$ ") for fence in fences(page) if is_run(fence))


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    """docs/generate.py."""
    spec = importlib.util.spec_from_file_location("generate", REPOSITORY / "docs" / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_generated_parts_are_current(generate: ModuleType) -> None:
    for path, text in generate.pages().items():
        assert path.read_text(encoding="utf-8") == text, f"{path} is not current: run python docs/generate.py"


def test_a_part_that_a_page_lacks_is_an_error(generate: ModuleType) -> None:
    with pytest.raises(ValueError, match="no part channels"):
        generate.with_part("a page without marks", "channels", "")


def test_a_page_that_shows_something_else_is_noticed() -> None:
    assert differs(["9380 points"], ["9380 points"], numbers_vary=False) is None
    assert differs(["9380 points"], ["9381 points"], numbers_vary=False) is None
    assert differs(["9380 points"], ["8000 points"], numbers_vary=False)
    assert differs(["9380 points"], ["8000 points"], numbers_vary=True) is None
    assert differs(["9380 points"], ["9380 boxes"], numbers_vary=True)
    assert differs(["a", "...", "z"], ["a", "b", "c", "z"], numbers_vary=False) is None
    assert differs(["a", "...", "z"], ["a", "b", "c", "y"], numbers_vary=False)
    assert differs([], ["a"], numbers_vary=False)
    assert differs(["(0.1, -0.2)"], ["(0.1, 0.2)"], numbers_vary=False)


def command_names() -> list[list[str]]:
    """The words of every command."""
    names: list[list[str]] = []
    group = get_command(app)
    context = typer.Context(group)
    for name in COMMANDS:
        command = group.get_command(context, name)  # type: ignore[attr-defined]  # the application is a group
        names += [[name, sub] for sub in command.commands] if hasattr(command, "commands") else [[name]]
    return names


@pytest.mark.parametrize("words", command_names(), ids=" ".join)
def test_every_command_has_its_row(words: list[str]) -> None:
    rows = (REPOSITORY / "docs" / "reference" / "commands.md").read_text(encoding="utf-8").splitlines()
    assert any(
        row.startswith(f"| `zsight {words[0]}") and (f"`zsight {' '.join(words)}" in row or f"`{words[-1]}`" in row)
        for row in rows
    )
