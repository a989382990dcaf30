"""The pages a newcomer opens are true: links lead somewhere, commands exist, pins hold."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from typer.main import get_command

from deploy.cli import app
from deploy.cli_simulate import ENDPOINTS

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ +(.*)$", re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """Anchors as the usual renderers make them of headings."""
    titles = HEADING.findall(page.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_resolve(page: Path) -> None:
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        assert file.exists(), f"{page.name} links to {target}"
        if anchor and file.suffix == ".md":
            assert anchor in anchors(file), f"{page.name} links to {target}"


def test_every_page_is_in_the_index() -> None:
    index = ROOT / "docs" / "index.md"
    linked = {(index.parent / target).resolve() for target in LINK.findall(index.read_text(encoding="utf-8"))}
    missing = [str(page.relative_to(ROOT)) for page in PAGES if page.resolve() not in linked | {index.resolve()}]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_and_options_in_the_pages_exist(page: Path) -> None:
    commands = get_command(app).commands  # type: ignore[attr-defined]
    for line in re.findall(r"copcs-deploy ([a-z][^`\n]*)", page.read_text(encoding="utf-8")):
        words = line.split()
        assert words[0] in commands, f"{page.name}: copcs-deploy {line}"
        options = {name for p in commands[words[0]].params for name in (*p.opts, *p.secondary_opts)}
        if words[0] == "simulate":  # hands its options on to the endpoint
            module = f"sim_backends/wire/{ENDPOINTS[words[1]][0]}" if words[1:] and words[1] in ENDPOINTS else None
            source = (ROOT / f"{module or 'deploy/cli_simulate'}.py").read_text(encoding="utf-8")
            options |= set(re.findall(r'"(--[a-z-]+)"', source))
        if words[0] == "train":  # hands them on as well
            source = (ROOT / "planner/policy/train.py").read_text(encoding="utf-8")
            options |= set(re.findall(r'"(--[a-z0-9-]+)"', source))
        for option in re.findall(r"--[a-z-]+", line):
            assert option in options | {"--help"}, f"{page.name}: copcs-deploy {line}"


def test_make_targets_in_the_pages_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for page in PAGES:
        for target in re.findall(r"`make ([a-z]+)", page.read_text(encoding="utf-8")):
            assert target in targets, f"{page.name}: make {target}"


def test_missions_in_the_readme_exist() -> None:
    for mission in re.findall(r"mission_configs/\S+?\.yaml", (ROOT / "README.md").read_text(encoding="utf-8")):
        assert (ROOT / mission).is_file(), mission


def test_every_dependency_is_pinned() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *(d for extra in project["optional-dependencies"].values() for d in extra)]
    pins = {
        line.split("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
        if "==" in line
    }
    names = {re.split(r"[<>=~\[ ;]", d)[0].lower().replace("_", "-") for d in wanted}
    assert names <= pins


def test_the_covered_core_is_the_core_without_io() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    covered = re.search(r"^CORE := (.*)$", makefile, re.MULTILINE)
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    pure = next(c["source_modules"] for c in contracts if c["name"].startswith("the pure core imports no I/O"))
    assert covered is not None
    assert {f"deploy.{name}" for name in covered[1].split()} <= set(pure)
    assert all((ROOT / f"{module.replace('.', '/')}.py").is_file() for module in pure)


def test_shell_scripts_parse() -> None:
    subprocess.run(["bash", "-n", ROOT / ".ci" / "run"], check=True)
    subprocess.run(["sh", "-n", ROOT / ".ci" / "venv"], check=True)
