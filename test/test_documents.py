"""Every command in README.md and docs/ is typed here, and does what its page says.

Shell blocks are the fenced ones marked `sh`, and indented ones that begin with a command. Those of
a page run in order, in a fresh folder that looks like the project's, on a ROS graph of its own;
each has to succeed. A comment before a block says where that is not so:

    <!-- shell: background /NODE ... -->  a shell of its own: it goes on until the end of its
                                          section (##), where it gets Ctrl-C; the nodes are awaited
    <!-- shell: fails -->                 it ends with an error
    <!-- not run: REASON -->              it is not executed
    <!-- drives may trip on this page -->     elsewhere on a page: a fault may switch the gates off

What a `text` block after a shell block shows is what that prints; `...` stands for anything. A
block of another language is the file that the paragraph before it names. What takes minutes is not
run again, but has to exist: see `STEPS_ASIDE`.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import rclpy
import yaml
from harness import PATIENCE, Process, until
from markdown_it import MarkdownIt
from markdown_it.token import Token
from rclpy.node import NodeNameNonExistentError

from mfpcc_controller.parameters import TABLE as CONTROLLER
from mfpcc_experiments import verbs
from mfpcc_experiments.graph.replayer import TABLE as REPLAYER
from pmsm_sim.parameters import TABLE as PLANT
from pwm_node.ros.node import EVERY_NODE

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/*.md")])
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]

#: Shell functions in place of what takes minutes, or a desktop: they only see that it is there.
STEPS_ASIDE = r"""
make() { command make --dry-run "$@" > /dev/null; }
pytest() { command pytest --collect-only -q "$1" > /dev/null; }
mfpcc() {
    case $1 in
        faults | reproduce | validate) command mfpcc "$1" --help > /dev/null ;;
        *) command mfpcc "$@" ;;
    esac
}
python() {
    case "$*" in
        "-m mfpcc_experiments.method "*) command python -c "import ${2}.__main__" ;;
        *) command python "$@" ;;
    esac
}
ros2() {  # a busy machine takes longer to find who is there
    case "$1 $2" in
        "param "*) command ros2 "$@" --timeout 60 ;;
        "topic echo") command ros2 "$@" --spin-time 60 ;;
        *) command ros2 "$@" ;;
    esac
}
xdg-open() { [[ $1 == *.html ]]; }
"""

#: What a drive says of a fault: it is to be seen only where a page speaks of that.
GATES_OFF = "gates off until"
#: What a page says of itself whose drives may do so.
TRIPS = "<!-- drives may trip on this page -->"

#: How an indented block begins that is no formula and no listing.
COMMANDS = ("export", "make", "mfpcc", "pip", "pytest", "python", "ros2", "source", "xdg-open")


@dataclass
class Block:
    """Something to do on a page.

    Attributes
    ----------
    line : int
        Where it stands.
    kind : str
        `sh`, `file`, or `section` where one ends.
    text : str
        What to execute, or the file's content.
    mark : str
        What the comment before it says, or the file's name.
    shows : list of str
        Lines that it prints.
    """

    line: int
    kind: str
    text: str = ""
    mark: str = ""
    shows: list[str] = field(default_factory=list)


def tokens(page: Path) -> list[Token]:
    return MarkdownIt("commonmark").enable("table").parse(page.read_text())


def blocks(page: Path) -> Iterator[Block]:
    """What there is to do on a page, in order."""
    mark, paragraph = "", ""
    last: Block | None = None
    for token in tokens(page):
        line = token.map[0] + 1 if token.map else 0
        if token.type == "heading_open" and token.tag in ("h1", "h2"):
            yield Block(line, "section")
        elif token.type == "html_block":
            found = re.fullmatch(r"<!-- (shell: .+|not run: .+) -->\n*", token.content)
            mark = found[1].removeprefix("shell: ") if found else ""
        elif token.type == "inline":
            paragraph, last = token.content, None
        elif token.type in ("fence", "code_block"):
            language = token.info.strip() if token.type == "fence" else ""
            if language == "text" and last is not None:
                last.shows = token.content.splitlines()
            elif language == "sh" or (
                token.type == "code_block" and token.content.split()[0] in COMMANDS
            ):
                last = Block(line, "sh", token.content, mark)
                yield last
            elif named := re.findall(r"(?<![\w./])((?:\w+/)?\w+\.(?:py|toml|yaml))\b", paragraph):
                yield Block(line, "file", token.content, named[-1])
            mark = ""


def commands(page: Path) -> int:
    """Number of shell blocks of a page."""
    return sum(block.kind == "sh" for block in blocks(page))


# --- Commands -------------------------------------------------------------------------------------


class Desk:
    """A folder like the project's, shells in it, and a look at the graph."""

    def __init__(self, folder: Path, domain: int, *, trips: bool) -> None:
        self.folder = folder
        self.trips = trips
        for path in ROOT.iterdir():
            if path.name not in ("bags", "build", "out", ".git", "setup.bash"):
                (folder / path.name).symlink_to(path)
        # that one knows the folder that it is in, and refuses what was built in another
        (folder / "setup.bash").write_text(f"source {shlex.quote(str(ROOT / 'setup.bash'))}\n")
        (folder / "bags").mkdir()
        (folder / "bags/reference").symlink_to(ROOT / "bags/reference")
        site = folder / ".site"
        # what a page installs goes here, not into the environment of the project
        self.environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "PIP_TARGET": str(site),
            "PIP_DISABLE_PIP_VERSION_CHECK": "1",
            "PYTHONPATH": os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")]),
            "COLUMNS": "100",
        }
        self.running: list[Process] = []
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self._node = rclpy.create_node("reader", context=self._context)

    def shell(self, block: Block) -> Process:
        script = f"set -eo pipefail\n{STEPS_ASIDE}\n{block.text}"
        return Process(["bash", "-c", script], cwd=self.folder, env=self.environment)

    def do(self, block: Block) -> None:
        """Do what a block says, and see that it does what its page says."""
        if block.kind == "file":
            file = self.folder / block.mark
            file.unlink(missing_ok=True)  # it may be a link to the project's own
            file.write_text(block.text)
        elif block.kind == "section":
            self.tidy_up()
        elif block.mark.startswith("background"):
            process = self.shell(block)
            self.running.append(process)
            for node in block.mark.split()[1:]:
                until(
                    lambda node=node: self.sees(node) or process.ended, f"{node} is there", PATIENCE
                )
            for line in block.shows:
                until(
                    lambda line=line: shown(line, process) or process.ended,
                    f"it prints '{line}'",
                    PATIENCE,
                )
            assert not process.ended, f"it ended: {block.text}\n{process.output}"
        elif not block.mark.startswith("not run"):
            assert block.mark in ("", "fails"), f"unknown mark '{block.mark}'"
            with self.shell(block) as process:
                code = process.wait(PATIENCE)
            fails = block.mark == "fails"
            assert (code != 0) == fails, f"exit code {code} of\n{block.text}\n{process.output}"
            assert "Traceback" not in process.output, process.output
            for line in block.shows:
                assert shown(line, process), f"no '{line}' in\n{process.output}"

    def sees(self, node: str) -> bool:
        """Whether a node is on the graph and has its topics, which it makes when it is ready."""
        namespace, _, name = node.rpartition("/")
        with contextlib.suppress(NodeNameNonExistentError):
            ends = (
                *self._node.get_publisher_names_and_types_by_node(name, namespace or "/"),
                *self._node.get_subscriber_names_and_types_by_node(name, namespace or "/"),
            )
            return any(kind.startswith("mfpcc_msgs/") for _, kinds in ends for kind in kinds)
        return False

    def tidy_up(self) -> None:
        """End what runs, as Ctrl-C does, the last first."""
        while self.running:
            with self.running.pop() as process:
                process.interrupt()
                code = process.wait(PATIENCE)
                assert code in (0, 130, -signal.SIGINT), process.output
                assert "Traceback" not in process.output, process.output
                assert self.trips or GATES_OFF not in process.output, process.output

    def close(self) -> None:
        for process in reversed(self.running):
            with process:
                process.interrupt()
                process.wait()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)


def shown(line: str, process: Process) -> bool:
    """Whether a program has printed what a page shows."""
    pattern = ".*".join(re.escape(part) for part in line.strip().split("..."))
    return re.search(pattern, process.output, re.MULTILINE) is not None


@pytest.mark.timeout(1200)
@pytest.mark.skipif(shutil.which("ros2") is None, reason="needs `source setup.bash`")
@pytest.mark.parametrize("name", [name for name in NAMES if commands(ROOT / name)])
def test_commands_do_what_the_page_says(name: str, tmp_path: Path, domain: int) -> None:
    trips = TRIPS in (ROOT / name).read_text()
    with contextlib.closing(Desk(tmp_path, domain, trips=trips)) as desk:
        for block in blocks(ROOT / name):
            try:
                desk.do(block)
            except AssertionError as error:
                raise AssertionError(f"{name}, line {block.line}: {error}") from None
        desk.tidy_up()


# --- Links ----------------------------------------------------------------------------------------


def inline(page: Path) -> Iterator[Token]:
    for token in tokens(page):
        yield from token.children or ()


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub makes them."""
    titles = [b.content for a, b in itertools.pairwise(tokens(page)) if a.type == "heading_open"]
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("name", NAMES)
def test_links_lead_somewhere(name: str) -> None:
    page = ROOT / name
    for token in inline(page):
        target = str(token.attrs.get("href") or token.attrs.get("src") or "")
        if not target or "://" in target:
            continue
        path, _, anchor = target.partition("#")
        goal = page.parent / path if path else page
        assert goal.exists(), target
        if anchor:
            assert anchor in anchors(goal), target


def test_the_index_has_every_page() -> None:
    index = (ROOT / "docs/README.md").read_text()
    for page in (ROOT / "docs").glob("*.md"):
        assert page.name == "README.md" or f"({page.name})" in index, page.name


# --- Names ----------------------------------------------------------------------------------------

TABLES = (PLANT, CONTROLLER, REPLAYER)
GROUPS = {name.partition(".")[0] for table in TABLES for name in table if "." in name}


def documented(page: Path) -> Iterator[str]:
    """All that stands in code on a page, but for what is meant to fail."""
    for block in blocks(page):
        if block.mark != "fails":
            yield from block.text.splitlines()
    for token in inline(page):
        if token.type == "code_inline":
            yield token.content


@pytest.mark.parametrize("name", NAMES)
def test_what_is_named_is_there(name: str) -> None:
    reference = (ROOT / "docs/reference.md").read_text()
    there = {
        "parameter": {
            *(parameter.name for parameter in EVERY_NODE),
            "black_box",
            *(parameter for table in TABLES for parameter in table),
        },
        "topic": set(re.findall(r"^\| `(\w+)` \| \[?`\w+/msg/", reference, re.MULTILINE)),
        "verb": {part.stem for part in Path(verbs.__path__[0]).glob("[a-z]*.py")},
        "target": set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE)),
    }
    named = {
        "parameter": r"(?:-p |ros2 param \w+ \S+ )([a-z_][\w.]*)(?=:=| |$)",
        "topic": r"ros2 topic \w+ (?:-\S+ )*/(\w+)",
        "verb": r"^mfpcc ([a-z]\w*)",
        "target": r"^make ([a-z]\w*)",
    }
    for code in documented(ROOT / name):
        for kind, pattern in named.items():
            for one in re.findall(pattern, code):
                assert one in there[kind], f"there is no {kind} '{one}': {code}"
        for one in re.findall(r"(?<![\w./])[a-z_]\w*\.[a-z]\w*\b(?![./(])", code):
            if one.split(".")[0] in GROUPS and one.split(".")[1] not in ("md", "py", "yaml"):
                assert one in there["parameter"], f"there is no parameter '{one}': {code}"


def test_analyzers_are_of_nodes_that_there_are() -> None:
    file = ROOT / "config/parameters/diagnostic_aggregator.yaml"
    settings = yaml.safe_load(file.read_text())["analyzers"]["ros__parameters"]
    reference = (ROOT / "docs/reference.md").read_text()
    for analyzer in (each for each in settings.values() if isinstance(each, dict)):
        assert analyzer["type"] == "diagnostic_aggregator/GenericAnalyzer"
        for text in analyzer["contains"]:
            node = text.removesuffix(": ")
            assert f"| `/{node}` |" in reference, f"there is no node {node}"


def test_the_reference_is_what_the_code_gives(tmp_path: Path) -> None:
    fresh = tmp_path / "reference.md"
    script = ROOT / "tools/reference.py"
    subprocess.run([sys.executable, str(script), str(fresh)], check=True, timeout=PATIENCE)
    assert fresh.read_text() == (ROOT / "docs/reference.md").read_text(), "run 'make docs'"
